"""The spools wind more, or less, wire than commanded: another radius than described."""

from .effect import Effect, Parameter


def law(pull, tension, relative_change):
    """Pull that is commanded for what is wound, pull (1 + change) = wound."""
    return pull / (1.0 + relative_change)


EFFECT = Effect(
    name='spool_gain',
    title='the spools wind more or less wire than commanded',
    stage='winding',
    law=law,
    parameters=(Parameter('relative_change', '1', -0.8, 4.0, 0.0, typical=0.05, per_tendon=True),),
    needs='pulls',
    divisible=True,
)
