"""The monitor without ROS: alignment in time, stillness, means, recording, what it may add."""

import json
import sys
from itertools import pairwise

import numpy as np
import pytest
from processes import until

from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.data import load_dataset, save_dataset
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.monitoring import History, Monitor, StillWindow
from tendon_robot_ros.monitoring.job import DiagnosisProgress, Work, guide_of
from tendon_robot_ros.monitoring.monitor import FrameMean
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.rehearsal import (
    Hidden,
    Story,
    choices,
    draw,
    refined,
    reveal,
    tour,
)
from tendon_robot_ros.workspace.postures import default_postures

NAN = np.full(4, np.nan)


@pytest.fixture(scope='module')
def model():
    return Model(load_robot('kato_10_1'))


def test_a_moment_between_two_samples_has_the_value_between():
    history = History()
    history.put(1.0, np.array([0.0]))
    history.put(1.1, np.array([1.0]))
    assert history.at(1.025) == pytest.approx([0.25])
    assert history.at(1.15) == pytest.approx([1.0])
    assert history.at(0.9) is None
    assert history.at(1.3) is None, 'nobody knows after the patience'


def test_where_no_effect_is_the_cause_the_recording_offers_to_improve(tmp_path):
    said = guide_of(Verdict.OUTSIDE_CATALOGUE, tmp_path)
    assert f'improve {tmp_path} --output {tmp_path / "improved.yaml"}' in said
    assert guide_of(Verdict.MISSING_EFFECT, tmp_path) == Verdict.MISSING_EFFECT.guide


def test_late_samples_are_dropped_and_a_gap_is_not_bridged():
    history = History()
    for time in (1.0, 1.05, 1.02, 3.0):
        history.put(time, np.array([time]))
    assert history.at(1.04) == pytest.approx([1.04])
    assert history.at(2.0) is None


def test_a_clock_that_was_set_back_begins_anew():
    history = History()
    history.put(100.0, np.array([1.0]))
    history.put(1.0, np.array([2.0]))
    assert history.at(1.0) == pytest.approx([2.0])


def frames(window, speed=0.0, count=30, noise=2e-4, seed=0):
    random = np.random.default_rng(seed)
    for index in range(count):
        at = index / 30.0
        points = np.array([[speed * at, 0.0, 0.1]]) + random.normal(0.0, noise, (1, 3))
        window.put(at, np.array([1.0]), points)
    return window.settled()


def test_the_noise_of_a_tracker_is_no_motion_and_slow_motion_is():
    window = StillWindow(0.6, 0.002, 0.05)
    still = frames(window)
    assert still.spread == pytest.approx(2e-4, rel=0.3)
    assert frames(StillWindow(0.6, 0.002, 0.05), speed=0.006) is None


def test_markers_that_are_never_seen_add_nothing_to_the_noise_of_the_others():
    seen, windows = np.random.default_rng(0).normal(0.0, 1e-4, (30, 1, 3)), []
    for markers in (1, 20):
        windows.append(StillWindow(2.0, 0.002, 0.05))
        for index, points in enumerate(seen):
            unseen = np.full((markers - 1, 3), np.nan)
            windows[-1].put(index / 15.0, np.array([1.0]), np.concatenate([points, unseen]))
    one, many = (window.settled() for window in windows)
    assert many.spread == one.spread


@pytest.mark.parametrize('other', [[], [np.nan]], ids=['alone', 'beside one that is unknown'])
def test_a_changing_input_is_not_still(other):
    window = StillWindow(0.6, 0.002, 0.05)
    for index in range(30):
        window.put(index / 30.0, np.array([index / 30.0, *other]), np.zeros((1, 3)))
    assert window.settled() is None


def watched(model, arm, postures, missing=()):
    """Let a monitor see an arm in postures, 30 frames each."""
    monitor = Monitor(model)
    monitor.start_recording()
    random, now, compared = np.random.default_rng(0), 0.0, None
    arcs = np.array([marker.arc_length for marker in monitor.markers])
    for tensions in postures:
        points = arm.shape(tensions).markers(arcs, np.zeros((len(arcs), 3)))
        points[list(missing)] = np.nan
        for _ in range(30):
            now += 1.0 / 30.0
            monitor.put_states(now, np.asarray(tensions, dtype=float), NAN)
            seen = points + random.normal(0.0, 1e-4, points.shape)
            compared = monitor.put_frame(now, seen)
    return monitor, compared


POSTURES = [[0.3, 0.1, 0.1, 0.4], [0.1, 0.6, 0.3, 0.1], [0.1, 0.1, 0.5, 0.2]]


def test_every_settled_posture_is_recorded_once(model, tmp_path):
    monitor, compared = watched(model, model, POSTURES)
    assert len(monitor.recorded) == 3
    assert compared.rolling < 4e-4
    dataset = monitor.dataset('x')
    assert dataset.inputs == pytest.approx(np.array(POSTURES))
    assert dataset.position_noise == pytest.approx(1e-4 / np.sqrt(18), rel=0.3)
    again = load_dataset(save_dataset(dataset, tmp_path / 'x'))
    assert again.positions == pytest.approx(dataset.positions)


def test_a_posture_with_a_wire_whose_pull_is_unknown_is_recorded_once(model):
    monitor, shape = Monitor(model), model.shape(POSTURES[0])
    monitor.start_recording()
    arcs, pulls = np.array([m.arc_length for m in monitor.markers]), np.array(shape.pulls)
    points, pulls[0] = shape.markers(arcs, np.zeros((30, 3))), np.nan
    for now in np.arange(60) / 30.0:
        monitor.put_states(now, NAN, pulls)
        monitor.put_frame(now, points)
    (recorded,) = monitor.recorded
    assert recorded.inputs == pytest.approx(pulls, nan_ok=True)


def test_a_recording_that_was_stopped_goes_on_until_it_lies_in_a_folder(model):
    monitor, _ = watched(model, model, POSTURES)
    monitor.recording = False
    monitor.start_recording()
    assert monitor.recording and len(monitor.recorded) == 3
    monitor.kept = True  # diagnosed: the data set is written
    monitor.start_recording()
    assert monitor.recorded == []


def test_a_marker_that_is_never_seen_is_left_out(model):
    monitor, compared = watched(model, model, POSTURES, missing=[4])
    assert np.isnan(compared.errors[4]).all()
    assert np.isfinite(np.delete(compared.errors, 4, axis=0)).all()
    assert np.isnan(monitor.dataset('x').positions[:, :, 4]).all()


def test_the_error_is_that_of_the_arm_and_falls_with_its_model(model):
    arm = Model(model.robot.with_effect('backbone_stiffness', {'relative_change': -0.1}))
    monitor, compared = watched(model, arm, POSTURES)
    assert compared.rolling > 2e-3
    monitor.set_model(arm)
    monitor.put_states(100.0, np.array(POSTURES[-1]), NAN)
    assert np.linalg.norm(monitor.put_frame(100.0, compared.measured).errors[-1]) < 4e-4


def test_the_rolling_error_holds_nothing_of_before_the_clock_was_set_back(model):
    monitor, compared = Monitor(model), []
    straight = model.shape(POSTURES[0]).markers(np.array([m.arc_length for m in monitor.markers]),
                                                np.zeros((30, 3)))  # fmt: skip
    for begin, off in ((100.0, 0.01), (0.0, 0.0)):
        for now in begin + np.arange(30) / 30.0:
            monitor.put_states(now, np.array(POSTURES[0]), NAN)
            compared.append(monitor.put_frame(now, straight + [off, 0.0, 0.0]))
    assert compared[29].rolling == pytest.approx(0.01)
    assert compared[-1].rolling < 1e-6


def test_two_postures_are_needed(model):
    monitor, _ = watched(model, model, POSTURES[:1])
    with pytest.raises(DataSetError, match='record two or more'):
        monitor.dataset('x')


def test_add_needs_a_diagnosis_first():
    with pytest.raises(InputError, match='call record, then diagnose'):
        Work().add(False)


def test_a_diagnosis_that_complains_a_lot_is_read_to_its_end(tmp_path, monkeypatch):
    command = tmp_path / 'python'
    command.write_text(
        '#!/bin/sh\nyes warning | head -n 20000 >&2\necho "at last" >&2\n'
        """echo '{"kind": "progress", "text": "on"}'\nexit 1\n"""
    )
    command.chmod(0o755)
    monkeypatch.setattr(sys, 'executable', str(command))
    work, told = Work(), []
    work.diagnose(tmp_path, [])
    until(lambda: told.extend(work.news()) or not work.running, 'its end')
    work.cancel()
    assert [one['text'] for one in told] == ['on', 'the diagnosis failed: at last']


def test_an_addition_that_was_asked_for_twice_is_answered_twice():
    work, sums = Work(), {'text': '', 'before': 2e-3, 'after': 1e-3}
    work._lines.put({'kind': 'verdict', 'content': {'verdict': 'missing_effect', 'sentence': ''}})
    work._lines.put({'kind': 'addition', 'effects': ['gravity'], 'file': 'better.yaml',
                     'partial': False, **sums})  # fmt: skip
    work.news()
    for _ in range(2):  # before the controller has answered
        work.add(False)
        assert [one['kind'] for one in work.news()] == ['add']
    for _ in range(2):
        assert work.answered(True, '').startswith('added gravity: 2.00 mm -> 1.00 mm')
    with pytest.raises(InputError, match='call record, then diagnose'):
        work.add(False)


@pytest.mark.parametrize('name', ['hinge_friction', 'tip_load', 'soft_cell', 'none'])
def test_what_is_hidden_moves_the_tip_by_millimetres(name):
    robot, catalogue = refined(load_robot('kato_10_1')), load_catalogue()
    assert name in choices(robot, catalogue)
    hidden = draw(robot, catalogue, name, 1)
    assert hidden.outside == (name == 'soft_cell')
    if not hidden.values:
        return
    shown = Model(robot.with_effect(name, hidden.values), catalogue)
    tensions = np.array(POSTURES)
    moved = shown.shapes(tensions).tip_position - Model(robot).shapes(tensions).tip_position
    assert 1e-3 < np.linalg.norm(moved, axis=1).max() < 4e-2


@pytest.mark.parametrize(('name', 'seeds'), [('kato_10_1', (110,)), ('spatial_3', (103, 106))])
def test_what_is_drawn_shows_on_the_arm_that_it_is_drawn_for(name, seeds):
    """A planar arm does not twist, and one that knows no gravity has no weight."""
    robot, catalogue = load_robot(name), load_catalogue()
    tensions = np.clip(default_postures(robot, 6), *robot.tension_limits)
    for seed in seeds:
        hidden = draw(robot, catalogue, '', seed)
        model = Model(robot.with_effect(hidden.name, hidden.values), catalogue)
        seen = model.measured(model.shapes(tensions).positions)[:, -1]
        moved = seen - Model(robot).shapes(tensions).tip_position
        assert np.linalg.norm(moved, axis=1).max() > 1e-3


def test_the_tour_stays_where_the_tip_can_go(model):
    for position, direction in tour(model, 8, 0):
        found = model.reach(position=position, direction=direction)
        assert found.status == 'reached'


def story(name, verdict, **values):
    robot, catalogue = refined(load_robot('kato_10_1')), load_catalogue()
    return Story(draw(robot, catalogue, name, 0), verdict, **values)


def test_a_story_comes_true_only_with_the_right_name_and_a_fallen_error():
    right = {'verdict': 'missing_effect', 'effects': [{'name': 'tip_load'}]}
    assert story('tip_load', right, before=5e-3, after=5e-4, added=True).problem == ''
    assert 'only 60 %' in story('tip_load', right, before=5e-3, after=2e-3, added=True).problem
    assert 'was hidden' in story('hinge_friction', right, before=5e-3, after=1e-4).problem
    assert story('none', {'verdict': 'adequate'}).problem == ''
    assert 'nothing was hidden' in story('none', right).problem
    assert story('soft_cell', {'verdict': 'outside_catalogue'}).problem == ''
    assert 'outside the catalogue' in story('soft_cell', right).problem


def test_a_late_frame_is_compared_with_the_tensions_of_its_own_time(model):
    """Frames 80 ms late, one in ten lost, while the arm moves."""
    monitor, random = Monitor(model), np.random.default_rng(1)
    arcs = np.array([marker.arc_length for marker in monitor.markers])

    def tensions(at):
        return np.array([0.3 + 0.4 * at, 0.1, 0.1, 0.4])

    aligned, newest, frames = [], [], []
    for step in range(300):
        now = step / 200.0
        monitor.put_states(now, tensions(now), NAN)
        if step % 7 == 0 and random.random() > 0.1:
            points = model.shape(tensions(now)).markers(arcs, np.zeros((len(arcs), 3)))
            frames.append((now, points))
        while frames and frames[0][0] < now - 0.08:
            at, points = frames.pop(0)
            if compared := monitor.put_frame(at, points):
                aligned.append(np.abs(compared.errors[-1]).max())
                here = model.shape(tensions(now)).tip_position
                newest.append(np.abs(points[-1] - here).max())
    assert len(aligned) > 20
    assert max(aligned) < 1e-6
    assert np.median(newest) > 1e-3, 'the test would not see it'


def test_how_far_a_diagnosis_is_never_goes_back_and_says_how_long_it_takes(capsys):
    now = iter([0.0, 30.0, 60.0, 90.0, 95.0])
    tell = DiagnosisProgress(lambda: next(now))
    tell('effects', 18, 18)
    tell('effects again', 1, 1)
    tell('effects again', 1, 2)
    tell('2 effects', 3, 4)
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [one['part'] for one in told] == [0.42, 0.6, 0.6, 0.6]
    assert told[1]['text'] == 'effects again 1/1 (60 %, about 40 s to go)'


FRAME_NOISE, J = 2e-4, 20
SHAPE = np.random.default_rng(0).normal(0.0, 0.1, (J, 3))
TENSIONS = np.array([0.5, 0.5])
SLOPES = np.random.default_rng(1).normal(0.0, 1.0, (3 * J, 3))


def fed_frames(
    made, random, count, shape=SHAPE, tensions=TENSIONS, begin=0.0, batch=6, slopes=SLOPES
):
    """Take so many batches at five a second; return what each was averaged with."""
    taken = []
    for number in range(count):
        for k in range(batch):
            at = begin + 0.2 * number + 0.2 * k / batch
            made.put(at, tensions, shape + random.normal(0.0, FRAME_NOISE, shape.shape))
        taken.append(made.take(slopes))
    return taken


def test_an_arm_that_stands_is_averaged_over_all_its_frames_and_seldom_begun_anew():
    random, made = np.random.default_rng(2), FrameMean(FRAME_NOISE, 0.01, 1e9)
    taken = fed_frames(made, random, 400)
    counts = [frames for _, _, frames in taken]
    restarts = sum(after < before for before, after in pairwise(counts))
    assert restarts <= 4, 'two tests of 0.1 % each: 0.8 are expected'
    _, mean, frames = taken[-1]
    off = (mean - SHAPE).ravel()
    assert np.sqrt(np.mean(off**2)) == pytest.approx(FRAME_NOISE / np.sqrt(frames), rel=0.3)


def test_it_forgets_what_is_older_than_it_may_be():
    made = FrameMean(FRAME_NOISE, 0.01, 1.05)  # 31.5 frames
    taken = fed_frames(made, np.random.default_rng(3), 30)
    assert max(frames for _, _, frames in taken) == 32
    assert taken[-1][2] == 32


def test_tensions_are_averaged_over_the_same_frames():
    made = FrameMean(FRAME_NOISE, 0.01, 1e9)
    for number, read in enumerate((-0.004, 0.0, 0.001)):  # [N] off, less than another tension
        made.put(0.1 * number, TENSIONS + read, SHAPE)
    tensions, _, frames = made.take(SLOPES)
    assert (tensions - TENSIONS) == pytest.approx(-0.001, abs=1e-12) and frames == 3
    made.put(0.4, TENSIONS + 0.003, SHAPE)
    tensions, _, frames = made.take(SLOPES)
    assert (tensions - TENSIONS) == pytest.approx(0.0, abs=1e-12) and frames == 4


def test_a_small_force_that_hides_in_the_noise_of_a_frame_is_a_change():
    """Five batches' deviations along what a force does: 0.6 of the noise of a coordinate."""
    random, made = np.random.default_rng(4), FrameMean(FRAME_NOISE, 0.01, 1e9)
    fed_frames(made, random, 5)
    along = np.linalg.qr(SLOPES)[0][:, 0].reshape(J, 3)
    pushed = SHAPE + 6.0 * FRAME_NOISE / np.sqrt(6.0) * along
    assert np.abs(pushed - SHAPE).max() < 1.5 * FRAME_NOISE
    ((_, mean, frames),) = fed_frames(made, random, 1, pushed, begin=1.0)
    assert frames == 6
    assert abs(np.sum((mean - pushed) * along)) < 4.0 * FRAME_NOISE / np.sqrt(6.0)


def test_other_tensions_and_frames_without_the_arm_begin_anew():
    random, made = np.random.default_rng(5), FrameMean(FRAME_NOISE, 0.01, 1e9)
    assert fed_frames(made, random, 3)[-1][2] == 18
    assert fed_frames(made, random, 1, tensions=TENSIONS + 0.02, begin=1.0)[-1][2] == 6
    lost = np.full((J, 3), np.nan)
    lost[0] = SHAPE[0]
    _, mean, frames = fed_frames(made, random, 1, lost, tensions=TENSIONS + 0.02, begin=2.0)[-1]
    assert frames == 12
    assert np.isfinite(mean).all(), 'what was seen before counts'
    made.put(3.0, TENSIONS, np.full((J, 3), np.nan))
    _, mean, _ = made.take(None)
    assert np.isnan(mean).all()


def test_what_was_hidden_is_revealed_in_the_units_of_a_verdict():
    lever = Hidden('hinge_friction', {'lever': 8.09e-5})
    change = Hidden('section_stiffness', {'relative_change': (0.05, -0.1)})
    assert reveal(lever, load_catalogue()) == 'hidden: hinge_friction lever 80.9 µm'
    said = 'hidden: section_stiffness relative_change 5.00/-10.0 %'
    assert reveal(change, load_catalogue()) == said
    assert reveal(Hidden('soft_cell', {}), load_catalogue()) == 'hidden: soft_cell'
