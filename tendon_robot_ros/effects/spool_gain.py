"""The spools wind more, or less, wire than commanded: another radius than described."""

from .effect import Effect, relative_change


def law(pull, tension, relative_change):
    """Pull that is commanded for what is wound, pull (1 + change) = wound."""
    return pull / (1.0 + relative_change)


EFFECT = Effect(
    name='spool_gain',
    title='the spools wind more or less wire than commanded',
    finding='the spools wind {relative_change:more/less} wire than commanded',
    stage='winding',
    law=law,
    # half as large as usual, because a radius is easily measured to a few percent
    parameters=(relative_change(typical=0.05, per_tendon=True),),
    needs='pulls',
    divisible=True,
)
