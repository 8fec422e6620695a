"""Forward model: from tensions to shapes, one, many, or one after the other."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import NoEquilibriumError, refusal
from ..effects import STAGES, CatalogueLike, load_catalogue
from ..robot import RobotLike, load_robot
from ..robot.estimates import natural_sizes
from ..robot.inputs import TensionsLike, are_tensions, input_rows, tensions_of
from .compile import BEND_TOLERANCE, KernelArrays
from .shape import ResultLayout, Shape, ShapeBatch, named_values

# [1] by which tensions are raised where a search stalls at a kink of friction, so that they are
# beside it. Measured: 611 of 390,002 equilibria of a co-contraction of spatial_6, all found by one
# of them; without, the tip is off by 0.8 instead of 0.2 mm in one of eight
RETRY_RAISES = (1e-6, 1e-5, 1e-4, 1e-3)
THREADS = 2  # [1] for a batch: so that other programs of a robot's computer keep a core
# [rad] of one section by one input alone: a curl beyond three quarters of a turn would meet itself
USEFUL_BEND_RAD = 1.5 * np.pi


class ForwardModel:
    """
    A frictionless chain of cells plus the physical effects that a robot description lists.

    PCCA is the chain alone; with `tendon_friction` it is the FKM of Kato et al. 2015.
    """

    def __init__(self, robot: RobotLike, catalogue: CatalogueLike | None = None) -> None:
        """
        Compile (or load from the cache) the kernel and read the robot.

        Parameters
        ----------
        robot : Robot, name, path, text or dict
            As `load_robot` takes it.
        catalogue : Catalogue or paths, optional
            With your own effects, as `load_catalogue` takes them.

        Raises
        ------
        EffectError, RobotDescriptionError
            An effect is not known, or a parameter is out of its bounds.

        """
        self.robot = robot = load_robot(robot)
        self.catalogue = load_catalogue(catalogue).sized(natural_sizes(robot))
        self.arrays = KernelArrays(robot, self.catalogue)
        self.inputs = robot.inputs
        self.limits: Floats = np.array([robot.tension_limits] * len(robot.inputs))
        self._own = threading.local()

    def __repr__(self) -> str:
        """Name the robot and the effects that act."""
        acting = [effect.name for effect in self.catalogue if self.acts(effect.name)]
        return f'<Model of {self.robot.name}: {", ".join(acting) or "no effect (PCCA)"}>'

    @property
    def implicit(self) -> bool:
        """Whether an effect acts that needs the shape itself."""
        return bool(self.implicit_effects)

    @property
    def implicit_effects(self) -> tuple[str, ...]:
        """Effects that act and need the shape."""
        friction = self.acts_at('eyelet')
        return tuple(
            e.name
            for e in self.catalogue
            if STAGES[e.stage].implicit and self.acts(e.name) and (friction or e.acts_on is None)
        )

    def acts(self, effect: str) -> bool:
        """Tell whether an effect is listed with a parameter off its neutral value."""
        return bool(self.arrays.on[self.arrays.layout.index[effect]])

    def acts_at(self, stage: str) -> bool:
        """Tell whether an effect of a stage acts."""
        return self.arrays.acts_at(stage)

    @cached_property
    def remembering(self) -> list[int]:
        """Rows in `arrays.values` of parameters by which the arm remembers."""
        rows = self.arrays.layout.rows
        return [rows[e.name, p.name] for e in self.catalogue for p in e.parameters if p.remembers]

    @property
    def remembers(self) -> bool:
        """Whether the arm remembers the loading history, by its friction or its bends."""
        return self.friction_remembers or self.bends_remember

    @property
    def bends_remember(self) -> bool:
        """Whether the backbone keeps part of its bend, or what it touches holds it by friction."""
        values = self.arrays.values
        return self.acts_at('hysteresis') or any(values[row, 0] for row in self.remembering)

    @property
    def friction_remembers(self) -> bool:
        """Whether friction follows the tensions between a posture and the one before."""
        return self.acts_at('memory')

    @property
    def transmission_remembers(self) -> bool:
        """Whether motors that turn back move the wires later; matters by wire pulls only."""
        return self.acts_at('transmission')

    @property
    def rubs(self) -> bool:
        """Whether tendons or joints have friction, which reverses with their motion."""
        return self.acts_at('eyelet') or self.acts_at('joint_friction')

    @property
    def sticks(self) -> bool:
        """Whether tendons stick by the travel beyond an eyelet, without friction memory."""
        slides = self.acts_at('eyelet') and self.acts_at('friction_travel')
        return slides and not self.friction_remembers

    def tensions(self, tensions: TensionsLike) -> Floats:
        """
        Return input tensions (m,) [N] from names or numbers; names that are missing are slack (0).

        Raises
        ------
        InputError
            Unknown names, or values that are negative or not finite.

        """
        return tensions_of(self.robot, tensions)

    def shape(
        self, tensions: TensionsLike, guess: Floats | None = None, memory: Floats | None = None
    ) -> Shape:
        """
        Return the shape under input tensions.

        Parameters
        ----------
        tensions : mapping or (m,) [N]
        guess : (3n,) or (n, 2) [rad], optional
            State (`Shape.state`) or bends to start an implicit model from.
        memory : optional
            Friction memory of the posture before (`Shape.memory`); default: from straight.

        Raises
        ------
        InputError, NoEquilibriumError

        """
        form = self.form
        block = np.zeros(form.size + form.memory)
        if are_tensions(tensions, self.robot):
            block[: form.m] = tensions
        else:
            block[: form.m] = self.tensions(tensions)
        if guess is not None:
            flat = np.asarray(guess, float).reshape(-1)
            if len(flat) not in (2 * form.n, 3 * form.n):
                raise refusal('guess', f'the bends or the state of {form.n} cells', guess)
            block[form.m : form.m + len(flat)] = flat  # the state follows the inputs
        if memory is not None:
            block[form.size :] = memory
        change = self._postures(self.arrays.address, block, 1, 0, 1, 0, self.scratch, 1, 1)
        if not change < BEND_TOLERANCE:
            self._refuse(block[None, : form.m], np.array([change]))
        return Shape(form, block)

    def follow(self, last: Shape | None, tensions: TensionsLike) -> Shape:
        """
        Return the shape under input tensions that follow those of the last shape.

        The search starts from the last one, which is also that of the friction memory.

        Parameters
        ----------
        last : Shape or None
            None: the arm was straight and free of tension.
        tensions : mapping or (m,) [N]

        Raises
        ------
        InputError, NoEquilibriumError

        """
        if last is None:
            return self.shape(tensions)
        past = self.own_shape('last', last).memory
        try:
            return self.shape(tensions, last.state, past)
        except NoEquilibriumError as error:
            stalled = error
        for raised in RETRY_RAISES:
            try:
                return self.shape((1.0 + raised) * self.tensions(tensions), last.state, past)
            except NoEquilibriumError:
                continue
        raise stalled

    def own_shape(self, name: str, given: object) -> Shape:
        """Return a shape of this robot that a caller gives; refuse all else."""
        if not (isinstance(given, Shape) and given.form.fields == self.form.fields):
            raise refusal(name, 'a Shape of this robot', given)
        return given

    def shapes(self, tensions: npt.ArrayLike, guesses: Floats | None = None) -> ShapeBatch:
        """
        Return the shapes under input tensions (b, m) [N], each loaded from straight.

        Raises
        ------
        InputError, NoEquilibriumError

        """
        inputs = input_rows(self.robot, tensions)
        batch, changes = self.solve(inputs, guesses)
        self._refuse(inputs, changes)
        return batch

    def sequence(
        self, tensions: npt.ArrayLike, memory: Floats | None = None, guesses: Floats | None = None
    ) -> ShapeBatch:
        """Return the shapes (b) of postures one after the other; friction remembers."""
        inputs = input_rows(self.robot, tensions)
        batch, changes = self.solve(inputs, guesses, memory, carry=True)
        self._refuse(inputs, changes)
        return batch

    def solve(
        self,
        inputs: Floats,
        guesses: Floats | None = None,
        memory: Floats | None = None,
        carry: bool = False,
    ) -> tuple[ShapeBatch, Floats]:
        """
        Return the shapes under inputs (b, m) [N] and the last changes (b,) [rad].

        A change above `BEND_TOLERANCE` marks a posture without equilibrium. With `carry` each
        posture follows the one before and updates `memory`; other large batches use two threads.
        """
        b, states = len(inputs), np.zeros((len(inputs), 3 * self.robot.cells))
        if guesses is not None:
            flat = guesses.reshape(b, -1)
            states[:, : flat.shape[1]] = flat
        block, batch, changes = self.form.filled(inputs, states)
        past = self.arrays.fresh_memory() if memory is None else memory
        where, remembered = self.arrays.address, past.ctypes.data

        def part(begin: int, end: int) -> None:
            self._postures(where, block, b, begin, end, remembered, self.scratch, int(carry), 1)

        if carry or b < 64:
            part(0, b)
        else:
            edges = np.linspace(0, b, THREADS + 1).astype(int).tolist()
            with ThreadPoolExecutor(THREADS) as pool:
                list(pool.map(part, edges[:-1], edges[1:]))
        return batch, changes

    @cached_property
    def form(self) -> ResultLayout:
        """Layout of the results of a posture."""
        chain, cells = self.arrays.chain, self.arrays.cells
        lengths = np.ascontiguousarray(cells[:, 0])
        memory = len(self.arrays.fresh_memory())
        return ResultLayout(chain.n, chain.k, chain.m, memory, lengths, cells[:, 3] > 0.5)

    @cached_property
    def _postures(self) -> Callable[..., float]:
        run: Callable[..., float] = self.arrays.part('shape').postures
        return run

    @cached_property
    def library(self) -> ShapeBatch:
        """
        Return shapes under random tensions within the limits; the seed is fixed.

        A cold search starts from them. Tensions concentrate where a section bends by less than
        three quarters of a turn, and half of the postures leave one of two opposing tendons at
        its lower limit.
        """
        arrays, random = self.arrays, np.random.default_rng(1)
        per_newton = np.linalg.norm(arrays.offset, axis=2) / arrays.cells[:, 1:2]  # (n, k) [rad/N]
        by_section = [per_newton[span] for span in arrays.spans]
        useful = [
            USEFUL_BEND_RAD / max(rates[:, members].sum() for rates in by_section)
            for members in map(list, self.robot.input_tendons)
        ]  # (m,) [N] at which an input alone bends its section so (PCCA)
        count = 1024 if self.implicit else 4096
        low, high = self.limits.T
        scale = np.minimum(high, low + useful)
        spread = random.random((count, len(low)))
        spread *= random.random((count, len(low))) < 0.6
        top = np.where(random.random((count, 1)) < 0.25, high, scale)
        inputs = low + spread * (top - low)
        batch, changes = self.solve(inputs)
        return batch.of(changes < BEND_TOLERANCE)

    @property
    def scratch(self) -> int:
        """Address of this thread's scratch memory."""
        own = self._own
        if not hasattr(own, 'address'):
            own.memory = self.arrays.scratch()
            own.address = own.memory.ctypes.data
        address: int = own.address
        return address

    def measured(self, points: Floats) -> Floats:
        """Move points (..., 3) [m] from the robot's base frame to the tracker's."""
        moved = np.array(points, dtype=float, order='C')
        if self.acts_at('measurement'):
            self.arrays.part('shape').measured(self.arrays.address, moved.reshape(-1, 3))
        return moved

    def _refuse(self, inputs: Floats, changes: Floats) -> None:
        bad = np.flatnonzero(~(changes < BEND_TOLERANCE))
        if len(bad):
            named = named_values(self.inputs, inputs[bad[0]], 'N')
            where = f'posture {bad[0]} ({named})' if len(inputs) > 1 else named
            raise NoEquilibriumError(where, self.implicit_effects, float(changes[bad[0]]))
