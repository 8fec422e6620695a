"""What has changed since an earlier recording of an arm that its description does not fit."""

from dataclasses import replace

import arms
import numpy as np
import pytest
import simulated
from simulated import CATALOGUE, NOISE

from tendon_robot_ros import diagnose
from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.data import save_dataset
from tendon_robot_ros.inference.discrepancy import DeviationProcess, since
from tendon_robot_ros.inference.imperfections import BuiltPredictor, imperfections
from tendon_robot_ros.inference.marginal import SIZE_MAX
from tendon_robot_ros.inference.predict import Predictor, frees_of
from tendon_robot_ros.robot import dump_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

QUIET = replace(NOISE, position=1e-6, trial=0.0, setting=0.0)
LACKS = {'nonlinear_stiffness': {'cubic': 4.0}}  # in both recordings
LOAD = {'tip_load': {'force_x': 0.03, 'force_y': 0.0, 'force_z': 0.0}}


def uneven(robot):
    """Return the robot with cells that get softer from base to tip by more than a third."""
    sections = []
    for section in robot.sections:
        factors = np.linspace(1.25, 0.8, section.cells)
        stiffness = tuple((np.array(section.bending_stiffness) * factors).tolist())
        sections.append(replace(section, bending_stiffness=stiffness))
    return replace(robot, sections=tuple(sections))


def recorded(robot, inputs, hidden=None, noise=NOISE, seed=0, **fields):
    """Return a recording of an uneven robot, with the description of an even one."""
    blank = simulated.postures(uneven(robot), inputs, noise=noise, **fields)
    return replace(simulated.measure(blank, hidden, noise, seed), robot=robot)


def off(dataset):
    """Return how far the markers are off the description (P, J, 3) [m]."""
    return dataset.mean - Predictor(dataset, dataset.robot, CATALOGUE).markers({})


ARMS = {
    'planar': replace(arms.planar(cells=6), gravity=(0.0, 0.0, 0.0)),
    'spatial': replace(arms.spatial(cells=3), gravity=(0.0, 0.0, 0.0)),
}


@pytest.mark.parametrize('exact', [True, False], ids=['exact', 'as built'])
@pytest.mark.parametrize('arm', ARMS)
def test_deviations_of_equal_inputs_cancel(arm, exact):
    robot = replace(ARMS[arm], exact=exact)
    inputs = default_postures(robot, 8)
    old, new = (recorded(robot, inputs, noise=QUIET, seed=seed) for seed in (1, 2))
    left = since(new, old)
    assert np.abs(off(left)).max() < 0.02 * np.abs(off(new)).max()
    if exact:  # else the arm is found as it is built
        assert left.reference.doubt.max() < 0.05 * left.reference.error
        tip = np.sqrt(np.mean(np.sum(off(old)[:, -1] ** 2, axis=1)))
        assert left.reference.error == pytest.approx(tip, rel=0.5)


def test_deviations_of_near_inputs_cancel_in_part_and_those_of_far_ones_stay():
    robot = replace(ARMS['planar'], exact=True)
    many = np.array([[pull, 0.0] for pull in np.linspace(0.5, 3.0, 12)])
    old = recorded(robot, many, noise=QUIET)
    new = recorded(robot, [[1.6, 0.0], [0.0, 3.0]], noise=QUIET)
    near = since(new, old)
    before, after = (np.linalg.norm(off(one), axis=2).max(axis=1) for one in (new, near))
    assert after[0] < 0.1 * before[0]
    assert after[1] == pytest.approx(before[1], rel=0.1)
    assert near.reference.doubt[0] < 0.1 * near.reference.error < 0.2 * near.reference.doubt[1]


@pytest.mark.parametrize('arm', ARMS)
def test_what_an_arm_deviated_is_as_measured_however_many_markers_it_has(arm):
    """Closed form: of noise alone its root mean square at the tip, which is that of a mean."""
    robot = replace(ARMS[arm], exact=True)
    noise = SimulatedNoise(position=3e-4, setting=0.0, trial=0.0)
    for count in (3, 30):
        places = robot.length * (np.arange(count) + 1) / count
        old, new = (
            simulate(robot, default_postures(robot, 40), noise=noise, seed=seed, markers=places)
            for seed in (1, 2)
        )
        expected = 3e-4 * np.sqrt(3.0 / old.trials.mean())
        assert since(new, old).reference.error == pytest.approx(expected, rel=0.3)


@pytest.mark.parametrize('size', [1e-3, 1.0])
def test_the_size_of_deviations_is_found_beside_larger_noise_whatever_the_unit(size):
    random, inputs = np.random.default_rng(3), np.linspace(0.0, 1.0, 100)[:, None]
    alike = np.exp(-0.5 * (inputs - inputs.T) ** 2 / 0.1**2) + 1e-9 * np.eye(100)
    off = size / np.sqrt(3.0) * np.linalg.cholesky(alike) @ random.normal(size=(100, 3))
    noise = 2.0 * size * random.normal(size=(100, 3))
    tracker = np.full(100, (2.0 * size) ** 2)
    found = DeviationProcess(inputs, (off + noise)[:, None], np.ones(1), 0.0 * tracker, tracker)
    assert found.size == pytest.approx(size, rel=0.4)


@pytest.mark.parametrize('kind', ['tension', 'displacement'])
@pytest.mark.parametrize('arm', ARMS)
def test_what_a_reference_leaves_open_of_an_arm_moves_the_new_postures(arm, kind):
    """Under a load as well; it is less than what is plausible of an arm that nobody has seen."""
    robot, inputs = ARMS[arm], default_postures(ARMS[arm], 8, 0, kind)
    old, new = (
        simulate(make_plant(robot, hidden, seed=1), inputs, input=kind, seed=seed)
        for seed, hidden in enumerate(({}, LOAD))
    )
    left = since(new, old)
    alone = BuiltPredictor(Predictor(replace(left, reference=None), left.robot, CATALOGUE))
    arm_now = BuiltPredictor(Predictor(left, left.robot, CATALOGUE))
    names = frees_of(['tip_load'], CATALOGUE, robot)
    point = {free: LOAD['tip_load'].get(free.key, 0.0) for free in names}
    each, both = imperfections(alone, point), imperfections(arm_now, point)
    root = np.concatenate([left.reference.spread[kind.name] for kind in each.kinds[:-1]])
    own = np.tensordot(root.T, each.moves[: len(root)], 1)
    assert both.kinds[0].plausible == 1.0
    np.testing.assert_allclose(both.moves[: len(own)], own, atol=1e-6 * np.abs(own).max())
    usual = [kind.plausible for kind in each.kinds[:-1] for _ in range(len(kind))]
    assert (np.linalg.norm(root, axis=1) < SIZE_MAX * np.array(usual)).all()


@pytest.mark.parametrize('arm', ARMS)
@pytest.mark.long
def test_a_load_that_is_new_is_named_alone_on_an_arm_that_lacks_an_effect(arm):
    robot = ARMS[arm]
    inputs = default_postures(robot, 8)
    old = recorded(robot, inputs, LACKS, seed=1)
    new = recorded(robot, inputs, LACKS | LOAD, seed=2)
    assert [effect.name for effect in diagnose(new).effects] != ['tip_load']
    found = diagnose(new, reference=old)
    assert (found.verdict, [e.name for e in found.effects]) == ('missing_effect', ['tip_load'])
    for key, value in LOAD['tip_load'].items():
        own = found.effects[0].parameters[key]
        assert own.low <= value <= own.high
        assert own.high - own.low < 0.5 * LOAD['tip_load']['force_x']
    assert found.details['reference']['data'] == old.name
    assert found.details['reference']['lacked'] == ('nonlinear_stiffness',)
    assert 'missing there already, and counted as described: nonlinear_stiffness' in found.text()


@pytest.mark.parametrize(('arm', 'seed'), [('planar', 3), ('spatial', 5)])
@pytest.mark.parametrize(
    ('kind', 'moved'),
    [('tension', {}), ('displacement', {}), ('tension', {'base_misalignment': {'shift_x': 3e-3}})],
)
@pytest.mark.long
def test_a_second_effect_is_named_if_it_is_more_than_what_may_have_changed(arm, seed, kind, moved):
    robot, inputs = ARMS[arm], default_postures(ARMS[arm], 10, seed, kind)
    old, new = (
        simulate(make_plant(robot, LACKS | change, seed=seed, work=Workmanship()), inputs,
                 input=kind, seed=trial)
        for trial, change in enumerate(({}, LOAD | moved))
    )  # fmt: skip
    found = diagnose(new, reference=old)
    named = {effect.name: effect.parameters for effect in found.effects}
    assert set(named) == {'tip_load', *moved}
    told = [text for text in found.details['caveats'] if text.startswith('values in newtons dep')]
    assert len(told) == (kind == 'displacement')
    if kind == 'tension':  # under wire lengths, a load is in shares of an unknown stiffness
        force = named['tip_load']['force_x']
        assert force.low <= LOAD['tip_load']['force_x'] <= force.high


@pytest.mark.parametrize('arm', ARMS)
@pytest.mark.long
def test_nothing_has_changed_between_two_recordings_of_one_arm(arm):
    robot = ARMS[arm]
    inputs = default_postures(robot, 8)
    old, new = (recorded(robot, inputs, LACKS, seed=seed) for seed in (1, 2))
    assert diagnose(new).verdict != 'adequate'
    assert diagnose(new, reference=old).verdict == 'adequate'


def test_a_sequence_is_a_reference_where_a_posture_lost_a_marker():
    robot = replace(ARMS['planar'], exact=True)
    inputs = default_postures(robot, 8)
    old, new = (recorded(robot, inputs, noise=QUIET, seed=k, path='sequence') for k in (1, 2))
    positions = old.positions.copy()
    positions[3, :, 2] = np.nan
    left = since(new, replace(old, positions=positions))
    assert np.abs(off(left)).max() < 0.05 * np.abs(off(new)).max()


def test_postures_that_are_selected_keep_what_is_open():
    robot = ARMS['planar']
    inputs = default_postures(robot, 6)
    left = since(recorded(robot, inputs), recorded(robot, inputs[:3]))
    assert (
        left.select(['4', '1']).reference.doubt.tolist() == left.reference.doubt[[1, 4]].tolist()
    )


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        (lambda old: replace(old, markers=old.markers[::-1]), 'markers'),
        (lambda old: replace(old, input='displacement'), 'input'),
        (lambda old: replace(old, positions=np.where(
            np.arange(len(old.markers))[:, None] == 2, np.nan, old.positions)), 'all markers'),
    ],
    ids=['markers', 'input', 'unseen'],
)  # fmt: skip
def test_a_reference_of_something_else_is_refused(change, said):
    old = recorded(ARMS['planar'], default_postures(ARMS['planar'], 4))
    with pytest.raises(DataSetError, match=said):
        since(old, change(old))


def test_the_command_says_since_when(tmp_path, capsys):
    from tendon_robot_ros.cli.main import main

    robot = ARMS['planar']
    inputs = default_postures(robot, 6)
    for name, hidden, seed in (('old', None, 1), ('new', LOAD, 2)):
        save_dataset(recorded(robot, inputs, hidden, seed=seed), tmp_path / name)
        (tmp_path / name / 'robot.yaml').write_text(dump_robot(robot), encoding='utf-8')
    old, new = tmp_path / 'old', tmp_path / 'new'
    page = tmp_path / 'page.html'
    assert main(['diagnose', str(new), '--reference', str(old), '--report', str(page)]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f'Changed since {old}: a load of ')
    assert f'--reference {old}' in page.read_text(encoding='utf-8')
