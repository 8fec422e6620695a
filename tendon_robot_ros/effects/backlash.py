"""Lost motion between motor and wire: a motor that turns back first takes up a play."""

from .effect import Effect, Parameter


def law(pull, before, width):
    """
    Pull that passes the transmission: x = min(max(x', u - w / 2), u + w / 2).

    The play operator (Brokate & Sprekels 1996, Hysteresis and Phase Transitions, section 2.1);
    backlash of gears in Tao & Kokotovic 1996, Adaptive Control of Systems with Actuator and Sensor
    Nonlinearities. A wire that stretches against friction in its sheath loses motion alike.
    """
    return min(max(before, pull - 0.5 * width), pull + 0.5 * width)


EFFECT = Effect(
    name='backlash',
    title='the motors turn back by a play before the wires follow',
    stage='transmission',
    law=law,
    # at most the wire of a bend of a radian, because more would be a wire that is not tied
    parameters=(
        Parameter('width', 'm', 0.0, 1.0, 0.0, typical=0.05, of='radius', per_tendon=True),
    ),
    needs='pulls history',
    divisible=True,
)
