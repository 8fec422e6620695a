"""A data set to a ROS 2 recording, as if it had been recorded while measuring."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...common.errors import DataSetError
from ...common.files import new_file, new_folder
from ...robot import dump_robot
from ..dataset import DataSet, FloatArray
from ..folder.description import dump_description
from .writer import (
    DESCRIPTION,
    JOINT_STATE,
    LABEL,
    POSE_ARRAY,
    ROBOT,
    STRING,
    BagWriter,
    Builder,
    need_rosbags,
)

STATES, SHAPE = '/tendon_states', '/measured_shape'
START = 1_000_000_000  # [ns] of the first message: 0 would mean that there is no time
OTHER_FILES = ('.bag', '.db3')  # endings that no folder may have: readers go by them
NO_TURN = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Timing:
    """How long an exported recording shows what."""

    hold: float = 2.0  # [s] each measurement
    move: float = 1.0  # [s] from one measurement to the next
    rate: float = 20.0  # [1/s] messages


def export_bag(
    dataset: DataSet,
    path: str | Path,
    storage: str = 'mcap',
    timing: Timing = Timing(),
) -> Path:
    """
    Write a data set as a recording; `import_bag` gives it back.

    The arm holds still at every measurement and moves in straight lines between them, by way of
    the straight arm where every trial was loaded `from_straight`.

    Parameters
    ----------
    dataset : DataSet
        What to write.
    path : str or Path
        A new folder, or a new file that ends in .mcap.
    storage : str
        'mcap' or 'sqlite3', for a folder.
    timing : Timing
        Seconds per measurement and move, messages per second.

    Raises
    ------
    DataSetError
        There is something at `path` already, or nothing can be written there.
    MissingExtraError
        The package rosbags is not installed.

    """
    need_rosbags()
    if dataset.visits is not None:
        problem = 'a recording does not hold in which order postures were visited'
        raise DataSetError(dataset.name, problem, 'keep it as a folder')
    path = Path(path)
    if path.suffix in OTHER_FILES:
        problem = f'ends with {path.suffix}, and a folder or an .mcap file is written'
        raise DataSetError(str(path), problem, f'leave out {path.suffix}')
    if path.suffix != '.mcap':
        with new_folder(path) as new:
            new.rmdir()  # the writer makes it
            _write(dataset, BagWriter(new, storage), timing)
        return path
    if path.exists():
        raise DataSetError(str(path), 'is there already', 'name a new file')
    with new_file(path) as draft:
        _write(dataset, BagWriter(draft.parent / 'bag', 'mcap'), timing)
        next((draft.parent / 'bag').glob('*.mcap')).rename(draft)
    return path


def _write(dataset: DataSet, writer: BagWriter, timing: Timing) -> None:
    build = Builder(writer.types)
    with writer:
        for topic in (DESCRIPTION, ROBOT, LABEL):
            writer.add_topic(topic, STRING, latched=True)
        writer.add_topic(STATES, JOINT_STATE)
        writer.add_topic(SHAPE, POSE_ARRAY)
        description = dump_description(dataset)
        writer.write(DESCRIPTION, START, build.string(description))
        writer.write(ROBOT, START, build.string(dump_robot(dataset.robot)))
        time, step = START, round(1e9 / timing.rate)
        for label, states in _stages(dataset, timing):
            writer.write(LABEL, time, build.string(label))
            for state in states:
                pull, tension = state.inputs, np.full(len(state.inputs), np.nan)
                if dataset.input == 'tension':
                    pull, tension = tension, pull
                names = dataset.input_names
                writer.write(STATES, time, build.joint_state(time, names, pull, tension))
                shape = build.pose_array(time, state.positions, state.turned)
                writer.write(SHAPE, time, shape)
                time += step


@dataclass(frozen=True)
class _State:
    """One instant: inputs (m,), positions (J, 3), quaternions (J, 4)."""

    inputs: FloatArray
    positions: FloatArray
    turned: FloatArray


def _stages(dataset: DataSet, timing: Timing) -> Iterator[tuple[str, list[_State]]]:
    """Yield the label and the instants of every hold and of every move between two."""
    count = max(round(timing.hold * timing.rate), 2)
    P, Q, J = dataset.positions.shape[:3]
    lying = dataset.offsets + np.outer(dataset.arc_lengths, [0.0, 0.0, 1.0])
    straight = _State(np.zeros(dataset.inputs.shape[1]), lying, np.tile(NO_TURN, (J, 1)))
    order = [(p, q) for p in range(P) for q in range(Q) if dataset.trial_mask[p, q]]
    if dataset.path == 'sequence':
        order = [(p, q) for q in range(Q) for p in range(P)]
    turned, last = dataset.orientations, straight
    for p, q in order:
        looks = np.full((J, 4), np.nan) if turned is None else turned[p, q]
        state = _State(dataset.inputs_by_trial[p, q], dataset.positions[p, q], looks)
        way = [last, straight, state] if dataset.path == 'from_straight' else [last, state]
        yield '', _move(way, max(round(timing.move * timing.rate), 2))
        label = {'posture': dataset.postures[p], 'trial': dataset.trial_names[q]}
        yield json.dumps(label, ensure_ascii=False), [state] * count
        last = state
    yield '', [last]


def _move(way: list[_State], count: int) -> list[_State]:
    """Return instants on straight lines, without the ends."""
    states = []
    for share in np.linspace(0.0, len(way) - 1, count + 2)[1:-1]:
        leg = min(int(share), len(way) - 2)
        a, b, t = way[leg], way[leg + 1], share - leg
        states.append(
            _State(
                (1 - t) * a.inputs + t * b.inputs,
                (1 - t) * a.positions + t * b.positions,
                (1 - t) * a.turned + t * b.turned,
            )
        )
    return states
