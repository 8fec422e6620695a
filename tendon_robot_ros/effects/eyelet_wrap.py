"""The tendon wraps each eyelet by the mean of both neighbouring bends."""

from .effect import Effect, fraction


def law(turning, mean, fraction):
    """
    Blend sin(|theta_i| / 2) with sin(|theta_i + theta_i+1| / 4).

    The paper replaces theta_i+1 by theta_i between eq. (8) and (9); this takes that step back.
    """
    return (1.0 - fraction) * turning + fraction * mean


EFFECT = Effect(
    name='eyelet_wrap',
    title='eyelets turn the tendon by the mean of both bends',
    stage='wrap',
    parameters=(fraction(),),
    law=law,
    acts_on='tendon_friction',
    divisible=True,
)
