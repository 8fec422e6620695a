"""An investigation: information by closed forms; it finds, keeps limits, stops, resumes."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arms import coarse
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import InputError, TendonRobotError
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.data.dataset import LOADINGS
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.intervals import LoadVector, Value
from tendon_robot_ros.inference.noise import Noise
from tendon_robot_ros.inference.predict import frees_of
from tendon_robot_ros.investigation.choice import (
    LinearDesign,
    OpenQuestion,
    Room,
    allowed,
    choose,
    information,
    pool,
)
from tendon_robot_ros.investigation.goal import (
    Goal,
    InvestigationEnd,
    Round,
    only_wide,
    possible,
    settled,
    widest,
)
from tendon_robot_ros.investigation.loop import Investigation
from tendon_robot_ros.investigation.measuring import BETTER, PostureMeasured, Record, empty_dataset
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.robot.keep_out import KeepOut, Region, Sphere
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.studies.rehearse import SimulatedArm
from tendon_robot_ros.workspace.postures import default_postures

KATO = ROOT / 'config' / 'robots' / 'kato_10_1.yaml'
COARSE = coarse('kato_10_1')
NOISE = Noise(1e-4, 0.0, 0.0, np.inf, 'declared')


def arm(hidden, seed=3, robot=COARSE, **options):
    plant = make_plant(robot, hidden, seed=seed, work=Workmanship())
    return SimulatedArm(plant, seed=seed, **options)


def exact_arm(hidden):
    """Return an arm that is as its description says but for what it hides: judged at once."""
    return SimulatedArm(make_plant(replace(COARSE, exact=True), hidden, scatter=0.0), seed=5)


def test_the_information_of_one_reading_of_one_parameter_is_that_of_a_gaussian_channel():
    signal, noise = 3.0, 0.5
    added = 0.5 * information(np.eye(1), np.array([[signal / noise]]))
    assert added == pytest.approx(0.5 * np.log(1.0 + (signal / noise) ** 2))


def test_what_an_imperfection_does_as_well_tells_less_and_a_second_reading_tells_less():
    alone = information(np.eye(1), np.array([[2.0]]))
    both = np.array([[2.0, 5.0]])  # the second column is a nuisance
    beside = information(np.eye(2), both) - information(np.eye(1), both[:, 1:])
    assert 0.0 < beside < 0.2 * alone
    again = information(np.eye(1) + 4.0, np.array([[2.0]]))
    assert again < alone


def test_a_load_and_a_curvature_are_told_apart_where_they_differ_not_where_they_are_large():
    """A tip load bends an arm the less the stiffer it is pulled; a curvature stays as it is."""
    robot = replace(load_robot(KATO), effects={}, tolerances={}, exact=True)
    plant = make_plant(robot, {}, scatter=0.0)
    empty = empty_dataset(SimulatedArm(plant), 'none', 1)
    low = robot.tension_limits[0]
    rows = np.array([[low] * 4, [low, 0.8, low, 0.8], [0.8, low, 0.8, low]])
    catalogue = load_catalogue()
    first = choose(OpenQuestion(('tip_load',), {}, NOISE), empty, rows, catalogue, 3)
    gains = [gain for _, gain in first]
    assert gains == sorted(gains, reverse=True)
    both = OpenQuestion(('tip_load', 'pre_curvature'), {}, NOISE)
    chosen = choose(both, empty, rows, catalogue, 2)
    same = choose(both, empty, np.repeat(rows[:1], 2, axis=0), catalogue, 2)
    assert sum(gain for _, gain in chosen) > sum(gain for _, gain in same) + 1.0


@pytest.mark.parametrize('path', LOADINGS)
def test_postures_in_which_the_present_estimate_has_no_equilibrium_are_not_chosen(path):
    """An arm that is believed to be soft against twist buckles where two wires pull hard."""
    robot = replace(load_robot(KATO), effects={}, tolerances={}, exact=True)
    low, catalogue = robot.tension_limits[0], load_catalogue()
    gentle, other = np.array([[low, 0.8, low, 0.8], [0.8, low, 0.8, low]])
    hard = np.array([5.0, 0.0, 5.0, 0.0])
    measured = simulate(make_plant(robot, {}, scatter=0.0), gentle[None], seed=1)
    measured = replace(measured, robot=robot, path=path)
    twist = frees_of(('torsion',), catalogue.sized(natural_sizes(robot)), robot)
    believed = OpenQuestion(('torsion',), dict.fromkeys(twist, 1.0), NOISE)
    chosen = choose(believed, measured, np.array([other, hard]), catalogue, 2)
    assert [inputs.tolist() for inputs, _ in chosen] == [other.tolist()]
    assert choose(believed, measured, hard[None], catalogue) == []


def test_of_a_sequence_of_wire_pulls_there_is_a_posture_after_one_with_slack_wires():
    rows = default_postures(COARSE, 4, 1, 'displacement')
    pulls = simulate(make_plant(COARSE), rows[:2], seed=1, trials=1, input='displacement')
    measured = replace(pulls, robot=COARSE, path='sequence')
    assert np.isnan(measured.inputs[-1]).any()
    question = OpenQuestion(('hinge_friction',), {}, NOISE)
    ((chosen, gain),) = choose(question, measured, rows[2:], load_catalogue())
    assert gain > 0.0
    assert (np.isnan(chosen) == np.isnan(rows[2:])).all(axis=1).any()


@pytest.mark.parametrize(('path', 'left'), [('from_straight', [2, 3]), ('sequence', [0, 2, 3])])
def test_what_could_not_be_measured_is_not_asked_for_again(path, left):
    investigation = Investigation(arm({}, path=path), Goal())
    rows, record = default_postures(COARSE, 4), investigation.record
    record.take(rows[0], investigation.arm.measure(rows[0], 1), None)
    record.skip(rows[1], 'slipped')
    assert np.array_equal(investigation.measurer.untried(rows), rows[left])


def test_once_only_an_interval_is_too_wide_the_posture_that_narrows_it_is_chosen():
    """The second posture tells more in all, of a parameter that is known well already."""
    robot = replace(load_robot(KATO), effects={}, tolerances={}, exact=True)
    empty = empty_dataset(SimulatedArm(make_plant(robot, {}, scatter=0.0)), 'none', 1)
    low = robot.tension_limits[0]
    rows = np.array([[low] * 4, [low, 0.8, low, 0.8], [0.8, low, 0.8, low], [0.8, low, low, 0.8]])
    question, catalogue = OpenQuestion(('tip_load',), {}, NOISE), load_catalogue()
    narrows = replace(question, narrows=True)

    def width(choice):
        design = LinearDesign(question, empty, catalogue)
        shown = dict(zip(map(tuple, rows.tolist()), design.offered(rows)[1], strict=True))
        precision = np.eye(shown[tuple(rows[0].tolist())].shape[1])
        for inputs, _ in choice:
            own = shown[tuple(inputs.tolist())]
            precision += own.T @ own
        return np.linalg.inv(precision)[:3, :3].diagonal().max()

    for count in (1, 2, 3):
        by_volume, by_width = (
            width(choose(asked, empty, rows, catalogue, count)) for asked in (question, narrows)
        )
        assert by_width <= by_volume * (1.0 + 1e-9)
    first = choose(narrows, empty, rows, catalogue, 1)[0]
    assert first[1] == pytest.approx(-0.5 * np.log(width([first])), rel=1e-6)


@pytest.mark.parametrize('turn', [0.0, 0.3, np.pi / 4])
def test_an_interval_of_a_force_is_a_part_of_it_wherever_the_axes_point(turn):
    catalogue = load_catalogue().sized(natural_sizes(load_robot(KATO)))
    force = 10.0 * catalogue['tip_load'].parameters[0].typical
    parts = {'force_x': force * np.cos(turn), 'force_z': force * np.sin(turn)}
    within = {key: Value(f, f - 0.2 * force, f + 0.2 * force, 'N') for key, f in parts.items()}
    load = LoadVector(Value(force, 0.8 * force, 1.2 * force, 'N'), None, 0.0)
    found = SimpleNamespace(name='tip_load', parameters=within, load=load)
    assert widest(SimpleNamespace(effects=[found]), catalogue) == pytest.approx(0.2)


def test_a_class_counts_only_when_its_interval_is_as_narrow_as_asked():
    held = SimpleNamespace(
        verdict=Verdict.AMBIGUOUS, cannot_tell_apart=['a', 'b'], next_measurement=None
    )
    wide = Round(5, str(Verdict.AMBIGUOUS), ['a', 'b'], ['a', 'b'], 0.3, '')
    narrow = replace(wide, postures=6, widest=0.2)
    assert settled(held, [wide, wide], Goal()) is None
    assert only_wide(held, [wide, wide], Goal())
    assert settled(held, [wide, narrow], Goal()) is InvestigationEnd.INSEPARABLE
    assert not only_wide(held, [wide, narrow], Goal())


@pytest.fixture(scope='module')
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp('investigation') / 'found'
    said = []
    subject = arm({'hinge_friction': {}}, lost=0.25)

    def report(kind, text, content):
        said.append(text)

    made = Investigation(subject, Goal(tension_max=0.8), folder, report=report).run()
    return subject, made, folder, said


@pytest.mark.long
def test_it_names_what_is_hidden_with_half_of_the_twelve_postures(found):
    _, made, _, _ = found
    assert made.outcome is InvestigationEnd.NAMED
    assert [e.name for e in made.diagnosis.effects] == ['hinge_friction']
    assert len(made.dataset.postures) <= 6


@pytest.mark.long
def test_what_it_adds_lowers_the_error_on_fresh_postures_and_is_written_whole(found):
    _, made, folder, _ = found
    assert made.check is not None and len(made.check.postures) == 3
    assert made.addition.check.after < 0.3 * made.addition.check.before
    written = load_dataset(folder / 'data')
    assert np.array_equal(written.positions, made.dataset.positions, equal_nan=True)
    log = json.loads((folder / 'investigation.json').read_text())
    assert log['outcome']['names'] == ['hinge_friction']


@pytest.mark.long
def test_it_never_leaves_the_limits_and_lets_the_arm_go_at_the_end(found):
    subject, *_ = found
    visited = np.array(subject.visited)
    low, _ = subject.robot.tension_limits
    assert visited.min() >= low - 1e-9
    assert visited.max() <= 0.8 + 1e-9
    assert subject.released >= 1


@pytest.mark.long
def test_a_broken_measurement_is_said_and_repeated(found):
    subject, made, _, said = found
    broken = [line for line in said if 'once more' in line or 'skipped' in line]
    assert broken and all('the tracker lost the arm' in line for line in broken)
    whole = len(made.dataset.postures) + len(made.check.postures)
    assert len(subject.visited) == whole + len(broken)


def test_an_arm_that_is_never_seen_ends_with_one_line(tmp_path):
    subject = arm({}, lost=1.0)
    with pytest.raises(TendonRobotError, match=r'postures could not be measured.*--resume'):
        Investigation(subject, Goal(), tmp_path / 'none').run()
    assert subject.released == 1


def test_interrupted_it_lets_go_and_goes_on_where_it_was(tmp_path):
    folder, subject = tmp_path / 'broken_off', exact_arm({'hinge_friction': {}})
    usual, count = subject.measure, [0]

    def interrupted(inputs, trials):
        count[0] += 1
        if count[0] == 4:
            raise KeyboardInterrupt
        return usual(inputs, trials)

    subject.measure = interrupted
    with pytest.raises(KeyboardInterrupt):
        Investigation(subject, Goal(), folder).run()
    assert subject.released == 1
    assert len(load_dataset(folder / 'data').postures) == 3
    with pytest.raises(InputError, match='--resume'):
        Investigation(subject, Goal(), folder)
    again = Investigation(subject, Goal(postures=4), folder, resume=True)
    before = again.record.dataset.positions[:3].copy()
    made = again.run()
    assert np.array_equal(made.dataset.positions[:3], before)
    assert made.outcome is InvestigationEnd.BUDGET
    assert len(made.dataset.postures) == 4
    other = replace(load_robot(KATO), effects={})
    stranger = SimulatedArm(make_plant(other, {}), seed=1)
    with pytest.raises(InputError, match='another description'):
        Investigation(stranger, Goal(), folder, resume=True)


def test_a_diagnosis_of_the_same_postures_confirms_nothing():
    investigation = Investigation(exact_arm({'hinge_friction': {}}), Goal(postures=4))
    assert investigation.run().outcome is InvestigationEnd.BUDGET
    assert investigation.judge() is None
    assert [one.names for one in investigation.record.rounds] == [['hinge_friction']]


@pytest.mark.parametrize('trials', [3, 4])
def test_resumed_it_takes_more_trials_than_were_seen_before(tmp_path, trials):
    subject, inputs = exact_arm({}), np.full(4, 0.3)
    record = Record.begin(subject, tmp_path / 'few', 3)
    positions = subject.measure(inputs, 3).positions
    positions[2] = np.nan
    record.changed = [{'name': 'tip_load'}]
    record.take(inputs, PostureMeasured(positions, np.tile(inputs, (3, 1))), 1e-4)
    again = Record.resume(subject, tmp_path / 'few', trials)
    assert again.changed == record.changed
    more = subject.measure(inputs, trials)
    again.take(inputs, more, 1e-4)
    assert again.dataset.trials.tolist() == [2, trials]
    assert np.array_equal(again.dataset.positions[1], more.positions)
    assert np.array_equal(again.dataset.positions[0, :2], positions[:2])
    assert len(load_dataset(tmp_path / 'few' / 'data').postures) == 2


def test_what_was_named_before_is_not_what_a_resumed_investigation_found(tmp_path):
    investigation = Investigation(exact_arm({}), Goal(), tmp_path / 'again')
    better = tmp_path / 'again' / BETTER
    better.write_text('of an earlier run\n')
    investigation.write_results()
    assert not better.exists()


def test_a_request_to_stop_ends_it_during_a_diagnosis_and_the_arm_is_released(tmp_path):
    folder, subject = tmp_path / 'stopped', exact_arm({'hinge_friction': {}})

    def stop():
        raise TendonRobotError('it was stopped')

    subject.attend = stop
    with pytest.raises(TendonRobotError, match='it was stopped'):
        Investigation(subject, Goal(start=3), folder).run()
    assert subject.released == 1
    assert len(load_dataset(folder / 'data').postures) == 3


def test_of_an_arm_without_a_hidden_effect_it_says_that_the_model_is_adequate():
    made = Investigation(exact_arm({}), Goal(start=7)).run()
    assert made.outcome is InvestigationEnd.ADEQUATE
    assert made.addition is None


@pytest.mark.long
def test_adequate_is_not_said_while_an_effect_may_move_the_tip_unseen():
    """Kinks of one sign hide among kinks at random: four miss nothing, six may name it."""
    # at the edge: a smaller one is named by six postures of fewer arms, or of none
    subject = arm({'pre_curvature': {'angle_x': 0.004}}, seed=102)
    said = []
    goal = Goal(postures=6, checks=0)
    made = Investigation(subject, goal, report=lambda kind, text, _: said.append(text)).run()
    first, last = made.record.rounds[0], made.record.rounds[-1]
    assert first.verdict == 'adequate' and 'pre_curvature' in first.possible
    assert any('adequate, but not excluded: ' in text for text in said)
    assert made.outcome is not InvestigationEnd.ADEQUATE
    assert 'pre_curvature' in last.names


def test_a_visible_effect_that_is_left_possible_keeps_the_question_open():
    made = Investigation(exact_arm({}), Goal(postures=4, start=4)).run()
    found, dataset = made.diagnosis, made.dataset
    catalogue = load_catalogue().sized(natural_sizes(dataset.robot))
    everything = possible(found, dataset, catalogue, 0.0)
    assert list(everything.values()) == sorted(everything.values(), reverse=True)
    middle = list(everything.values())[3]
    assert possible(found, dataset, catalogue, middle) == dict(list(everything.items())[:3])
    again = replace(made.record.rounds[-1], postures=6, possible={})
    assert settled(found, [again, again], Goal()) is InvestigationEnd.ADEQUATE
    open_still = replace(again, possible={'gravity': 0.01})
    assert settled(found, [again, open_still], Goal()) is None


def test_postures_keep_out_of_a_region_on_their_whole_way():
    robot = load_robot(KATO)
    model, goal = Model(robot), Goal()
    empty = empty_dataset(SimulatedArm(make_plant(robot, {}, scatter=0.0)), 'none', 1)
    everywhere = pool(model, goal, Room(), empty)
    tips = model.shapes(everywhere).tip_position
    away = KeepOut((Region('lamp', Sphere(tuple(tips[10].tolist()), 0.03)),))
    kept = pool(model, goal, Room(away, 0.005), empty)
    assert 0 < len(kept) < len(everywhere)
    low = robot.tension_limits[0]
    for share in np.linspace(0.0, 1.0, 37):
        shapes = model.shapes(low + share * (kept - low)).positions
        assert away.clearance(shapes.reshape(-1, 3)).distance > 0.0


def test_a_wire_that_was_slack_before_pulls_the_arm_into_no_region():
    robot = load_robot(KATO)
    model = Model(robot)
    left, right = (np.full((1, 4), np.nan) for _ in range(2))
    left[0, 0], right[0, 1] = (model.shape(row).pulls.max() for row in np.eye(4)[:2])
    inside = Sphere(tuple(model.pull_shape(left[0]).tip_position.tolist()), 0.005)
    room = Room(KeepOut((Region('lamp', inside),)))
    for start in (None, right[0]):
        assert not len(allowed(left, Goal(), 'displacement', model, room, start))
        assert len(allowed(right, Goal(), 'displacement', model, room, start))


@pytest.mark.parametrize(
    ('option', 'says'),
    [
        (['--start', '2'], '--start: expected 3'),
        (['--interval', '-1'], '--interval: expected'),
        (['--lost', '2'], '--lost: expected a number from 0 to 1 [1], got 2'),
        (['--postures', '3'], '--start: expected 3 to 3, got 4'),
    ],
)
def test_a_goal_that_cannot_be_is_refused_in_one_line(option, says, tmp_path, capsys):
    code = main(['study', 'rehearse', str(KATO), '--output', str(tmp_path / 'x'), *option])
    assert code == 1
    error = capsys.readouterr().err
    assert says in error and error.count('\n') == 1
    assert not (tmp_path / 'x').exists()
