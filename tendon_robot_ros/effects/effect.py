"""What a physical effect is: a name, its parameters, and one scalar law for one stage."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from string import Formatter
from typing import Any

import numpy as np

from ..common.errors import EffectError
from .stage import STAGES

# what the measurements of some effects need, words of `Effect.needs`
NEEDS = ('gravity', 'history', 'pulls')
# whose values the kernel takes at these stages; at all others those of a section
VALUES_OF = dict.fromkeys(('actuation', 'transmission', 'winding'), 'tendon')
VALUES_OF |= dict.fromkeys(('offset_scale', 'tip_load', 'push', 'measurement'), '')


@dataclass(frozen=True)
class Parameter:
    """
    A parameter of an effect.

    Attributes
    ----------
    name, unit : str
    low, high : float
        Bounds [unit].
    neutral : float
        Where the effect changes nothing.
    typical : float
        A size that matters, used to scale and start fits.
    of : str
        The size of the robot that these four count in, a key of
        `robot.estimates.natural_sizes`; '' where they are the same for every robot.
    per_section : bool
        Whether every section has a value of its own.
    per_tendon : bool
        Whether tendons may have values of their own; where a description lists one number, they
        share it, and a fit frees that one.
    tolerance : str
        The quantity under `tolerances` of a description whose deviation this parameter is.
    parts_power : int
        Power of the number of parts by which the value grows where a cell is divided.
    has_default : bool
        Whether it only shapes what the others do: a description may leave it out, also of an
        effect that is always on; it is then neutral.
    only_described : bool
        Whether a fit leaves it alone where the description gives no value, or the neutral one.
    remembers : bool
        Whether the arm depends on the posture before where it is not neutral.

    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    typical: float
    of: str = ''
    per_section: bool = False
    per_tendon: bool = False
    tolerance: str = ''
    parts_power: int = 0
    has_default: bool = False
    only_described: bool = False
    remembers: bool = False

    @property
    def per(self) -> str:
        """Whose value it is: that of a 'section', of a 'tendon', or of the robot ('')."""
        return 'section' if self.per_section else 'tendon' if self.per_tendon else ''

    @property
    def described_bounds(self) -> tuple[float, float]:
        """
        Bounds of a value in a description [unit].

        Wider than those of a fit where they follow the robot: a fit may change it a little, and
        smaller sizes than a fit can tell may be known.
        """
        if not self.of:
            return self.low, self.high
        return (0.02 if self.low > 0.0 else 2.0) * self.low, 2.0 * self.high

    def expected(self, value: float, described: bool = True) -> str:
        """Return what a value out of bounds should be, '' where it is within."""
        low, high = self.described_bounds if described else (self.low, self.high)
        return '' if low <= value <= high else f'a number from {low:g} to {high:g} [{self.unit}]'

    def step(self, value: float, share: float) -> float:
        """Return a share of the typical size as a step from a value to where there is room."""
        size, below = share * self.typical, value - self.low
        if value + size > self.high and below > 0.0:
            return -min(size, below)
        return min(size, self.high - value)

    def sized(self, sizes: Mapping[str, float]) -> Parameter:
        """Return the parameter with bounds, neutral and typical value in its unit for a robot."""
        if not self.of:
            return self
        one = sizes[self.of]
        scaled = {key: one * getattr(self, key) for key in ('low', 'high', 'neutral', 'typical')}
        return replace(self, **scaled)


def relative_change(typical: float = 0.1, **more: Any) -> Parameter:
    """Return the parameter of a factor 1 + change: a fifth to five times of what is described."""
    return Parameter('relative_change', '1', -0.8, 4.0, 0.0, typical, **more)


def per_axis(*vectors: Parameter) -> tuple[Parameter, ...]:
    """Return the components of vectors, a parameter each: `force` becomes `force_x` and so on."""
    return tuple(replace(p, name=f'{p.name}_{axis}') for p in vectors for axis in 'xyz')


def wrench() -> tuple[Parameter, ...]:
    """Return the parameters of a force and of a moment, which a fit frees where it is known."""
    return per_axis(
        Parameter('force', 'N', -1e3, 1e3, 0.0, typical=0.2, of='force'),
        Parameter('moment', 'N·m', -1e3, 1e3, 0.0, 0.2, of='moment', only_described=True),
    )


def fraction() -> Parameter:
    """Return the parameter that blends a simplification of the paper (0) with geometry (1)."""
    return Parameter('fraction', '1', 0.0, 1.0, 0.0, typical=1.0)


@dataclass(frozen=True)
class Effect:
    """
    A physical effect.

    Attributes
    ----------
    name : str
        As in a robot description.
    title : str
        The physics in a few words.
    stage : str
        A key of `STAGES`.
    parameters : tuple of Parameter
    law : callable
        Scalars in (the stage's, then the parameters), scalars out; uses `math` only.
    acts_on : str, optional
        The effect that this one shapes, and without which it does nothing.
    always_on : bool
        Whether it acts even at its neutral value once it is listed.
    contains : tuple of str
        Effects that are special cases of this one.
    needs : str
        What the measurements must have for it to show, in words: a known direction of `gravity`,
        the `history` of postures, commanded `pulls`.
    divisible : bool
        Whether its law also holds for a cell divided into finer ones, with the parameters
        scaled as they say; else a plant leaves the cells whole.
    takes_force : bool
        Whether it takes tension or moment away from the arm, as friction does.
    scales_bends : bool
        Whether it makes all bends larger or smaller alike: postures hardly tell it from the others
        that do.
    placed : bool
        Whether it acts at a place that is to be found first: a fit frees it only where the
        description has it.
    finding : str
        How a verdict says that a model lacks it; by default the title and every parameter.
        `{lever}` stands for the value with its interval, `{relative_change:stiffer/softer}` for
        its size and one of two words by its sign, `{size}` and `{direction}` for those of a force
        (parameters `..._x`, `..._y` and `..._z` in N), `{postures}` and `{place}` for where it
        pushes the arm.

    """

    name: str
    title: str
    stage: str
    parameters: tuple[Parameter, ...]
    law: Callable[..., Any]
    acts_on: str | None = None
    always_on: bool = False
    contains: tuple[str, ...] = ()
    needs: str = ''
    divisible: bool = False
    takes_force: bool = False
    scales_bends: bool = False
    placed: bool = False
    finding: str = ''
    digest: str = field(default='', compare=False)

    def __post_init__(self) -> None:
        """
        Refuse what the kernel could not call.

        Raises
        ------
        EffectError
            Unknown stage, wrong number of arguments, bounds that exclude the neutral value, values
            of sections or tendons where its stage has none, or a law that fails, gives back
            something else, or changes something at the neutral values.

        """
        for problem in self._problems():
            raise EffectError(f'effect {self.name}: {problem}')
        source = inspect.getsourcefile(self.law)
        with open(source or '', 'rb') as file:  # which may hold several laws
            text = file.read() + self.law.__qualname__.encode()
        object.__setattr__(self, 'digest', hashlib.sha256(text).hexdigest()[:16])

    def _problems(self) -> Iterator[str]:
        """Yield what the kernel could not call."""
        if self.stage not in STAGES:
            yield f'expected a stage of {", ".join(STAGES)}, got {self.stage!r}'
        if not set(self.needs.split()) <= set(NEEDS):
            yield f'needs: expected one of {", ".join(NEEDS)}, got {self.needs!r}'
        takes = len(inspect.signature(self.law).parameters)
        fields = [p.name for p in self.parameters]
        for name in (self.name, *fields):
            if not name.isidentifier():
                yield f'expected a name of letters, digits and underscores, got {name!r}'
        inputs = [quantity.name for quantity in STAGES[self.stage].inputs]
        wanted = len(inputs) + len(fields)
        if takes != wanted:
            yield (
                f'its law takes {takes} arguments, expected {wanted}: '
                f'{", ".join(inputs)}, then {", ".join(fields)}'
            )
        named = {field for _, field, _, _ in Formatter().parse(self.finding) if field}
        is_force = any(p.name.endswith('_x') and p.unit == 'N' for p in self.parameters)
        known = [*fields, *(('size', 'direction') if is_force else ()), 'postures', 'place']
        if unknown := named - {*known}:
            yield (
                f'finding: expected fields of {", ".join(known)}, got {", ".join(sorted(unknown))}'
            )
        for parameter in self.parameters:
            if not parameter.low <= parameter.neutral <= parameter.high:
                yield f'{parameter.name}: expected low <= neutral <= high, got {parameter}'
            if parameter.per not in ('', self.values_of):
                more = f', or one per {self.values_of}' if self.values_of else ''
                yield (
                    f'{parameter.name}: expected one value{more} at the stage {self.stage}, '
                    f'got one per {parameter.per}'
                )
        yield from self._trial()

    def _trial(self) -> Iterator[str]:
        """Yield what the law does wrong where it is called once, before it is compiled."""
        stage = STAGES[self.stage]
        given = [quantity.example for quantity in stage.inputs]
        before, several = given[: len(stage.outputs)], len(stage.outputs) > 1
        try:
            off, _ = (
                self.law(*given, *(getattr(p, at) for p in self.parameters))
                for at in ('neutral', 'typical')
            )
        except Exception as error:  # whatever the law raises
            yield f'its law cannot be called: {type(error).__name__}: {error}'
            return
        after = list(off) if several and isinstance(off, tuple) else [off]
        if [np.shape(one) for one in after] != [np.shape(one) for one in before] or None in after:
            wanted = ', '.join(
                f'{q.name} ({q.count} numbers)' if q.count > 1 else q.name for q in stage.outputs
            )
            yield f'its law gives back {off}, expected {wanted}'
        elif not (self.always_on or self.holds_a_state) and any(
            not np.allclose(*pair) for pair in zip(after, before, strict=True)
        ):
            yield (
                'its law changes something where all parameters are neutral: '
                f'{", ".join(f"{p.name} = {p.neutral:g}" for p in self.parameters)}'
            )

    @property
    def holds_a_state(self) -> bool:
        """Whether its law takes what it gave back in the posture before."""
        return 'history' in self.needs or any(p.remembers for p in self.parameters)

    @property
    def values_of(self) -> str:
        """Whose values its law takes: of a 'section', of a 'tendon', or of the robot ('')."""
        return VALUES_OF.get(self.stage, 'section')

    def sized(self, sizes: Mapping[str, float]) -> Effect:
        """
        Return the effect with its parameters as they are for a robot of these sizes.

        Raises
        ------
        EffectError
            A parameter counts in a size that robots do not have.

        """
        for p in self.parameters:
            if p.of not in ('', *sizes):
                expected = f'expected one of {", ".join(sizes)}, got {p.of!r}'
                raise EffectError(f'effect {self.name}: {p.name}: of: {expected}')
        made = copy(self)
        sized = tuple(parameter.sized(sizes) for parameter in self.parameters)
        object.__setattr__(made, 'parameters', sized)
        return made
