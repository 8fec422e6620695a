"""What a sweep takes from its guess: moment arms, travel, load moments."""

from .flat import lies_flat
from .geometry import tendon_travel, travel_beyond
from .layout import (
    STEP,
    YES,
    entry,
    flat_moments_at,
    load_moments_at,
    residual_at,
)
from .loads import loaded
from .stages import length_acts, offset_scale
from .sweep import active_stages
from .turning import chain_frames, half_turns


@entry(STEP)
def prepare(chain, inputs, guess, work, past, out):
    """Fill moment arms, travel, travel beyond and load moments at a guess; `out` is scratch."""
    if loaded(chain) and length_acts(chain):  # lengths follow the tensions there
        residual_at(chain.residual)(chain, inputs, guess, work, past, out)
        return
    friction, straight, wraps, slides, _ = active_stages(chain, YES)
    slides = friction and slides
    if straight or wraps or loaded(chain):
        half_turns(chain, guess, work)
    if straight or slides:
        tendon_travel(chain, guess, offset_scale(1.0, chain, 0), work)
    if slides:
        travel_beyond(chain, work)
    if loaded(chain):
        if lies_flat(chain, guess, work):
            flat_moments_at(chain.flat_moments)(chain, guess, work)
        else:
            chain_frames(chain, guess, work)
            load_moments_at(chain.load_moments)(chain, guess, work)
