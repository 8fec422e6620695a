"""
What to simulate and diagnose: robots x effects x sizes x designs x chance.

A plan is read from YAML, and run in a folder that belongs to it and to the versions of it.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..common.errors import InputError, Progress
from ..common.files import write_text
from ..common.workers import Workers
from ..common.yaml_reading import Reader, read_yaml
from ..data import load_dataset
from ..data.dataset import INPUTS, LIMITS
from ..effects import Catalogue
from ..model.versions import UserEffect, catalogue_of, differences, refuse_difference, versions
from ..robot import dump_robot, load_robot
from ..simulation.hidden import CAUSES, SCATTER_MAX
from ..simulation.measurements import SimulatedNoise
from .cases import NOTHING, Case, Design, PlannedRobot
from .judge import DIAGNOSIS, INTERVALS, QUESTIONS, CaseRow, Setup
from .running import TABLE, GrowingTable, judge_all

# [1] times the typical size of an effect; others would be in another unit
SIZES = (1e-3, 10.0)
# [1] size of a cause outside the catalogue; smaller ones would be nothing
CAUSE_SIZE_MIN = 0.5
# [1] of anything that is counted; more would run for years, and is a mistake
COUNT_MAX = 1_000_000
ALL, ALL_CAUSES = 'all', 'causes'
KEYS = (
    *('question', 'seed', 'seeds', 'clean', 'robots', 'hidden', 'sizes', 'drawn', 'full_size'),
    *('designs', 'noise', 'imperfections', 'exact', 'scatter', 'declared'),
)
CONTENT = 'campaign.json'  # in the folder: what its table was made with


class PlanReader(Reader):
    """Checked reading of a plan."""

    refusal = InputError

    def numbers_in(self, key: str, low: float, high: float, usual: Sequence[float]) -> list[float]:
        """Return a list of numbers within bounds."""
        value = self.content.get(key, list(usual))
        if not isinstance(value, list) or not value:
            raise self.error(key, 'a list of numbers', value)
        return [self._number(f'{key}[{i}]', one, low, high, '1') for i, one in enumerate(value)]

    def words(self, key: str, known: Sequence[str], default: Sequence[str]) -> list[str]:
        """Return a list of known words."""
        value = self.content.get(key, list(default))
        value = [value] if isinstance(value, str) else value
        if not isinstance(value, list):
            raise self.error(key, 'a list of names', value)
        for word in value:
            if word not in known:
                raise self.error(key, 'names of ' + ', '.join(known), word)
        return value

    def entries(self, key: str) -> Iterator[Self]:
        """Open each entry of a list; none where there is no such key."""
        return self.items(key) if self.has(key) else iter(())


@dataclass(frozen=True)
class CampaignPlan:
    """What to simulate and diagnose."""

    setup: Setup
    cases: tuple[Case, ...]

    @property
    def contents(self) -> dict[str, str]:
        """Digests of what cases are made of, by name: a table is one of the same things."""
        setup = self.setup
        digests = {'question': setup.question, 'seed': str(setup.seed)}
        for arm in setup.arms:
            digests[f'robot {arm.robot.name}'] = _digest(dump_robot(arm.robot), arm.down)
        for i, one in enumerate(setup.designs):
            parts: list[object] = [one.name, one.postures, one.trials, one.markers, one.input]
            if (data := one.data) is not None:
                parts += [data.inputs.tobytes(), data.trials.tobytes()]
                parts += [data.markers, data.input, data.path]
            digests[f'design {i + 1}'] = _digest(*parts)
        for i, (name, noise) in enumerate(setup.noises):
            digests[f'noise {i + 1}'] = _digest(name, noise)
        return digests


def read_plan(path: str | Path, effect_files: Sequence[str] = ()) -> CampaignPlan:
    """
    Read a plan; files that it names are sought beside it.

    Raises
    ------
    TendonRobotError
        One line: file, key, what was expected and what came.

    """
    content = read_yaml(Path(path), lambda why: InputError(f'{path}: no plan (YAML): {why}'))
    return plan_of(content, str(path), Path(path).parent, effect_files)


def plan_of(
    content: Any, source: str, folder: Path = Path(), effect_files: Sequence[str] = ()
) -> CampaignPlan:
    """Check the content of a plan; as `read_plan`."""
    top = PlanReader(source, '', content)
    top.only(*KEYS)
    effects = UserEffect.read(effect_files)
    catalogue = catalogue_of(effects)
    setup = Setup(
        arms=tuple(arms_of(top, folder, catalogue)),
        designs=tuple(designs_of(top, folder)) or (Design('12 postures'),),
        noises=tuple(noises_of(top)) or (('0.2 mm', SimulatedNoise()),),
        seed=top.whole('seed', 0, 2**32 - 1, 0),
        question=top.choice('question', QUESTIONS, DIAGNOSIS),
        effects=effects,
    )
    top.unique('robots', [arm.robot.name for arm in setup.arms])
    top.unique('designs', [design.name for design in setup.designs])
    top.unique('noise', [name for name, _ in setup.noises])
    measured = {f'designs[{i}].data': one.data for i, one in enumerate(setup.designs) if one.data}
    for (key, data), arm in itertools.product(measured.items(), setup.arms):
        if data.robot.inputs != arm.robot.inputs:
            own, given = (', '.join(robot.inputs) for robot in (arm.robot, data.robot))
            raise top.error(key, f'measurements of the inputs of {arm.robot.name}, {own}', given)
    cases = tuple(cases_of(top, setup, catalogue))
    if not cases:
        raise top.error('seeds', 'at least one case: seeds of effects, or clean sets', 0)
    return CampaignPlan(setup, cases)


def arms_of(top: PlanReader, folder: Path, catalogue: Catalogue) -> Iterator[PlannedRobot]:
    """Yield the robots of a plan."""
    value = top.content.get('robots')
    if not isinstance(value, list) or not value:
        raise top.error('robots', 'a list of robot descriptions', value)
    for i, item in enumerate(value):
        keys = {'file': item} if isinstance(item, str) else item
        entry = PlanReader(top.source, f'robots[{i}]', keys)
        entry.only('file', 'but', 'down')
        path = entry.content.get('file')
        if not isinstance(path, str):
            raise entry.error('file', 'a robot description (YAML)', path)
        robot = load_robot(folder / path)
        down = entry.vector('down', 3) if entry.has('down') else None
        skips = entry.words('but', [*catalogue.names, *CAUSES], ())
        yield PlannedRobot(robot, down, tuple(skips))


def designs_of(top: PlanReader, folder: Path) -> Iterator[Design]:
    """Yield the designs of a plan."""
    for entry in top.entries('designs'):
        entry.only('name', 'postures', 'trials', 'markers', 'input', 'data')
        data = entry.content.get('data')
        if data is not None and not isinstance(data, str):
            raise entry.error('data', 'the folder of a data set', data)
        postures = entry.whole('postures', 3, COUNT_MAX, 12)
        trials = entry.whole('trials', 1, COUNT_MAX, 5)
        markers = entry.whole('markers', 0, COUNT_MAX, 0)
        placed = f'{markers} markers' if markers else 'a marker per cell'
        title = f'as {Path(data).name}' if data else f'{postures} postures x {trials} x {placed}'
        name = entry.name('name') if entry.has('name') else title
        measured = load_dataset(folder / data) if data else None
        kind = entry.choice('input', INPUTS, 'tension')
        yield Design(name, postures, trials, markers, kind, measured)


def noises_of(top: PlanReader) -> Iterator[tuple[str, SimulatedNoise]]:
    """Yield the noises of a plan, by name."""
    known = tuple(field.name for field in fields(SimulatedNoise))
    for entry in top.entries('noise'):
        entry.only('name', *known)
        values = {
            key: entry.number(key, 0.0, *LIMITS[f'{key}_noise']) for key in known if entry.has(key)
        }
        one = SimulatedNoise(**values)
        title = f'{1e3 * one.position:.3g} mm, {100 * one.setting:.3g} %, {100 * one.trial:.3g} %'
        yield entry.name('name') if entry.has('name') else title, one


def cases_of(top: PlanReader, setup: Setup, catalogue: Catalogue) -> Iterator[Case]:
    """List the cases, seeds outermost, so that early results cover all robots."""
    known = (ALL, ALL_CAUSES, *catalogue.names, *CAUSES)
    everywhere = tuple(effect.name for effect in catalogue if not effect.placed)
    groups = {ALL: everywhere, ALL_CAUSES: tuple(CAUSES)}
    words = top.words('hidden', known, (ALL,))
    hidden = list(dict.fromkeys(name for word in words for name in groups.get(word, (word,))))
    if setup.question == INTERVALS:  # of effects only
        hidden = [name for name in hidden if name in catalogue]
    full = set(top.words('full_size', [*catalogue.names, *CAUSES], ()))
    usual = 0.0 if setup.question == INTERVALS else 1.0  # that arm is the model's own
    levels = top.numbers_in('imperfections', 0.0, 5.0, (usual,))
    scatter = top.number('scatter', 0.0, SCATTER_MAX, default=0.0)
    seeds, clean = top.whole('seeds', 0, COUNT_MAX, 20), top.whole('clean', 0, COUNT_MAX, 0)
    sizes = sizes_of(top)
    shared: dict[str, Any] = {'scatter': scatter}
    shared |= {key: top.flag(key) for key in ('exact', 'declared')}
    methods = list(itertools.product(range(len(setup.designs)), range(len(setup.noises)), levels))
    shown = {
        arm.robot.name: [name for name in hidden if can_show(name, arm, setup, catalogue)]
        for arm in setup.arms
    }
    for number in range(max(seeds, clean)):
        for robot, names in shown.items():
            what = [(NOTHING, 0.0)] if number < clean else []
            for name in names if number < seeds else ():
                drawn = [1.0] if name in full else sizes(setup.seed, number, name)
                what += [(name, size) for size in drawn]
            for (name, size), method in itertools.product(what, methods):
                yield Case(robot, name, size, number, *method, **shared)


def sizes_of(top: PlanReader) -> Callable[[int, int, str], list[float]]:
    """Return a function of (seed, number, name) that gives the hidden sizes."""
    if top.has('sizes') and top.has('drawn'):
        raise top.error('drawn', 'either sizes or drawn', top.content['drawn'])
    if not top.has('drawn'):
        listed = top.numbers_in('sizes', *SIZES, (0.1, 0.3, 1.0))
        return lambda *_: listed
    bounds = top.numbers_in('drawn', *SIZES, ())
    if len(bounds) != 2 or bounds[0] >= bounds[1]:
        raise top.error('drawn', '[smallest, largest] size', bounds)
    low, high = np.log(bounds)

    def drawn(seed: int, number: int, name: str) -> list[float]:
        own = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()), number))
        size = float(np.exp(low + (high - low) * np.random.default_rng(own).random()))
        return [max(size, CAUSE_SIZE_MIN) if name in CAUSES else size]

    return drawn


def can_show(name: str, arm: PlannedRobot, setup: Setup, catalogue: Catalogue) -> bool:
    """Return whether an effect is hidden in an arm, and influences its measurements."""
    if name in arm.skips or name not in catalogue:
        return name not in arm.skips
    robot, effect = arm.robot, catalogue[name]
    if effect.acts_on is not None and effect.acts_on not in robot.effects:
        return False
    if any(p.per_section for p in effect.parameters) and len(robot.sections) == 1:
        return not any(p.low < 0.0 for p in effect.parameters)  # the same as one of all sections
    down = arm.down or robot.gravity
    if effect.needs == 'gravity':
        return down is not None and any(down)
    measured = [d.data for d in setup.designs if d.data is not None]
    kinds = {'pulls': 'displacement', 'history': 'sequence'}
    return all(kinds[one] in (d.input, d.path) for one in effect.needs.split() for d in measured)


def _digest(*parts: object) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:12]


def run_plan(
    plan: CampaignPlan,
    folder: Path,
    workers: Workers,
    progress: Progress | None = None,
    accept_change: bool = False,
) -> list[CaseRow]:
    """
    Judge the cases of a plan that are not in the table yet.

    Parameters
    ----------
    plan : CampaignPlan
    folder : Path
        Of the table; what is there already counts.
    workers : Workers
    progress : callable, optional
        Called with (what, done, total) of the cases that were left.
    accept_change : bool
        Go on where other versions began; `earlier_rows` then says so.

    Returns
    -------
    list of CaseRow
        Of all cases of the plan, in its order.

    Raises
    ------
    InputError
        The folder belongs to something else, or to other versions.
    ClusterLostError
        The scheduler is gone; what was finished is in the table.

    """
    claim(folder, plan, accept_change)
    return judge_all(plan.setup, plan.cases, table_of(folder), workers, progress)


def table_of(folder: Path) -> GrowingTable[CaseRow]:
    """Open the table of a campaign."""
    return GrowingTable(folder / TABLE, CaseRow)


def claim(folder: Path, plan: CampaignPlan, accept_change: bool = False) -> None:
    """Make the folder that of a plan, or refuse it."""
    path, contents = folder / CONTENT, plan.contents
    ours = versions(plan.setup.effects)
    earlier: list[dict[str, Any]] = []
    if path.is_file():
        theirs = _content(folder)
        earlier, before = theirs['earlier'], theirs['contents']
        if changed := [key for key in contents if before.get(key, contents[key]) != contents[key]]:
            raise InputError(
                f'{folder}: was run with another {", ".join(changed)}; use another --output'
            )
        if not accept_change:
            refuse_difference(
                f'{folder}: was run with other versions',
                theirs['versions'],
                ours,
                'use another --output, or --accept-change, which keeps the rows that are there',
            )
        elif differences(theirs['versions'], ours):
            rows = len(table_of(folder).keys())
            earlier = [*earlier, {'rows': rows, 'versions': theirs['versions']}]
        contents = before | contents
    elif folder.exists() and any(folder.iterdir()):
        raise InputError(f'{folder}: is not empty and no campaign; use another --output')
    folder.mkdir(parents=True, exist_ok=True)
    content = {'versions': ours, 'contents': contents, 'earlier': earlier}
    write_text(path, json.dumps(content, indent=1) + '\n')


def _content(folder: Path) -> dict[str, Any]:
    """Return what a folder was run with: versions, contents, and earlier versions."""
    try:
        content = json.loads((folder / CONTENT).read_text())
        plain = {key: dict(content[key]) for key in ('versions', 'contents')}
        return {**plain, 'earlier': list(content.get('earlier', ()))}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f'{folder / CONTENT}: cannot be read ({error}); use another --output'
        ) from None


def earlier_rows(folder: Path) -> list[str]:
    """Say which rows of a table come from other versions than the last, a line per change."""
    content = _content(folder)
    return [
        f'the first {one["rows"]:,} rows were judged by other versions: '
        + '; '.join(differences(one['versions'], content['versions']))
        for one in content['earlier']
    ]
