"""A pulley that gives way: part of the tension is lost, more the harder one pulls."""

from tendon_robot_ros.effects import Effect, Parameter


def law(tension, loss):
    """Return T (1 - loss T)."""
    return tension * (1.0 - loss * tension)


EFFECT = Effect(
    name='soft_pulley',
    title='a pulley that gives way',
    stage='actuation',
    parameters=(Parameter('loss', '1/N', 0.0, 0.15, 0.0, typical=0.05),),
    law=law,
    divisible=True,
)
