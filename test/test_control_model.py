"""The controller and its model: wire pulls, another model, and none that works."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from control_rig import CYCLE, Rig, aimed, model, reachable, standing

from tendon_robot_ros.common.errors import InputError, NoEquilibriumError
from tendon_robot_ros.control import ControllerCore, Settings
from tendon_robot_ros.control.inputs import Target, Trajectory
from tendon_robot_ros.control.loading import load
from tendon_robot_ros.control.status import controller_status
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot.keep_out import KeepOut, Region, Sphere


def test_in_pull_mode_commands_are_the_pulls_of_an_equilibrium():
    rig = standing(pull_mode=True)
    rig.core.aim(reachable())
    output = rig.run(1.0)
    assert output.pulls == pytest.approx(model().shape(output.tensions).pulls, abs=1e-9)


def test_in_pull_mode_the_tip_goes_where_the_lengths_alone_take_it():
    """Lengths keep up no tension of one wire against another: none is counted on."""
    target = Target(model().shape(np.array([1.5, 0.5, 0.1, 0.9])).tip_position)
    rig = standing(pull_mode=True)
    rig.core.aim(target)
    output = rig.run(1.0)
    arm = model().pull_shape(output.pulls)
    assert rig.core.solution.status == 'reached'
    assert arm.tip_position == pytest.approx(target.position, abs=1e-4)
    assert arm.inputs == pytest.approx(output.tensions, abs=1e-3)


def test_unobserved_tensions_are_taken_from_the_wire_pulls():
    core = ControllerCore(model())
    shape = model().shape(np.array([0.5, 0.1, 0.1, 0.9]))
    core.measured(0.0, np.full(4, np.nan), shape.pulls)
    pulls = model().shape(core.step(0.0).tensions).pulls
    assert pulls == pytest.approx(shape.pulls, abs=1e-5)


def test_another_model_moves_tensions_to_its_solution_at_the_rate_limit():
    rig = aimed(1.0, rate_limit=2.0)
    before = rig.tensions
    stiffer = model().robot.with_effect('backbone_stiffness', {'relative_change': 0.2})
    rig.core.set_model(Model(stiffer))
    assert np.abs(rig.run(CYCLE).tensions - before).max() <= 2.0 * CYCLE + 1e-12
    rig.run(1.0)
    tip = rig.core.model.shape(rig.tensions).tip_position
    assert tip == pytest.approx(reachable().position, abs=1e-4)


def test_no_tendon_is_slacker_than_the_lowest_tension_raised_while_the_arm_stands():
    rig = standing()
    target = Target(model().shape(np.array([0.5, 0.1, 0.1, 0.9])).tip_position)
    rig.core.aim(target)
    rig.run(1.0)
    assert rig.tensions.min() < 0.2
    rig.core.set_model(Model(replace(model().robot, tension_limits=(0.4, 5.0))))
    rig.run(1.0)
    tip = rig.core.model.shape(rig.tensions).tip_position
    assert rig.tensions.min() >= 0.4 and tip == pytest.approx(target.position, abs=1e-4)
    rig.core.aim(reachable())
    least = [rig.run(CYCLE).tensions.min() for _ in range(100)]
    assert min(least) >= 0.4


def test_a_model_with_other_inputs_or_without_equilibrium_is_refused(monkeypatch):
    rig = standing()
    with pytest.raises(InputError, match='expected prox_left, prox_right, dist_left, dist_right'):
        rig.core.set_model(model('spatial_3'))
    other = Model(model().robot)

    def fail(*args, **kwargs):
        raise NoEquilibriumError('here', (), 1.0)

    monkeypatch.setattr(other, 'shape', fail)
    with pytest.raises(NoEquilibriumError):
        rig.core.set_model(other)
    assert rig.core.model is model()


def test_without_equilibrium_it_halts_and_then_releases(monkeypatch):
    rig = aimed(0.02, pull_mode=True)
    count = len(rig.outputs)

    def fail(*args, **kwargs):
        raise NoEquilibriumError('here', (), 1.0)

    with monkeypatch.context() as patch:
        patch.setattr(model(), 'shape', fail)
        rig.run(0.4)
        held = rig.outputs[count:]
        settled = held[10:]  # the pieces of the way that were looked at before
        assert all(np.array_equal(settled[0].pulls, output.pulls) for output in settled)
        assert len(held) == 80
        assert rig.run(0.3) is None
        assert rig.code() == 'no_equilibrium'
    assert rig.run(0.1) is not None
    assert rig.code() == 'refused_no_equilibrium'


def test_a_trajectory_ends_within_the_limits_of_a_model_that_came_meanwhile():
    rig = standing(rate_limit=10.0)
    rig.core.play(rig.now, Trajectory(np.array([1.0]), np.array([[1.1, 0.1, 0.1, 0.6]])))
    rig.run(0.5)
    rig.core.set_model(Model(replace(model().robot, tension_limits=(0.1, 0.4))))
    rig.run(1.0)
    assert rig.tensions == pytest.approx([0.4, 0.1, 0.1, 0.4])
    assert rig.code() == 'played'


def posted(rig, act):
    """Return the work and what takes its result that an act posts to a solver that waits."""
    jobs, in_place = [], rig.core.solver
    rig.core.solver = SimpleNamespace(post=lambda kind, *job, **more: jobs.append(job))
    act()
    rig.core.solver = in_place
    (job,) = jobs
    return job


def test_one_that_is_checked_while_the_model_changes_is_checked_again_and_ends_there_too():
    softer = model().robot.with_effect('backbone_stiffness', {'relative_change': -0.3})
    new, end = Model(replace(softer, tension_limits=(0.1, 0.4))), np.array([0.5, 0.1, 0.1, 0.6])
    for place, code, tensions in (
        ([1.0, 0.0, 0.0], 'played', [0.4, 0.1, 0.1, 0.4]),
        (new.shape(end).tip_position, 'refused_keep_out', [0.1, 0.1, 0.1, 0.1]),
    ):
        room = KeepOut((Region('lamp', Sphere(tuple(place), 0.005)),))
        rig = standing(rate_limit=10.0, keep_out=room)
        trajectory = Trajectory(np.array([0.5]), end[None])
        work, done = posted(rig, lambda rig=rig, one=trajectory: rig.core.play(rig.now, one))
        rig.core.set_model(new)
        assert work(lambda: False) is None  # the model of before keeps out
        done(None, None)
        rig.run(1.0)
        assert rig.code() == code
        assert rig.tensions == pytest.approx(tensions)


def test_a_target_that_comes_while_a_model_is_looked_at_is_met_with_it():
    rig = aimed(1.0)
    stiffer = Model(model().robot.with_effect('backbone_stiffness', {'relative_change': 0.2}))
    work, done = posted(rig, lambda: rig.core.set_model(stiffer))
    new = reachable((0.1, 0.8, 0.3, 0.1))
    rig.core.aim(new)
    done(work(lambda: False), None)
    rig.run(1.0)
    assert stiffer.shape(rig.tensions).tip_position == pytest.approx(new.position, abs=1e-4)


@pytest.mark.parametrize('target', [False, True])
def test_friction_stays_as_it_was_when_the_model_changes(target):
    """Let go from much tension: from straight the tip would be elsewhere by 23 mm."""
    old = model().robot.with_effect('friction_memory', {'presliding_length': 1e-4})
    new = Model(old.with_effect('backbone_stiffness', {'relative_change': 0.02}))
    rig = Rig()
    rig.core.set_model(Model(old))
    way = np.array([[0.1, 0.1, 0.1, 0.1], [1.4, 0.1, 0.1, 1.0], [0.5, 0.1, 0.1, 0.9]])
    rig.run(0.1, see)
    rig.core.play(rig.now, Trajectory(np.array([0.4, 0.8]), way[1:]))
    rig.run(1.2, see)
    place = rig.core.track.last.tip_position
    if target:
        rig.core.aim(Target(place))
        rig.run(0.5, see)
    assert rig.tensions == pytest.approx(way[-1], abs=1e-2)
    rig.core.set_model(new)
    rig.run(CYCLE, see)
    followed, anew = new.sequence(way).tip_position[-1], new.shape(way[-1]).tip_position
    assert np.linalg.norm(anew - followed) > 2e-2
    if target:
        rig.run(1.0, see)
        arrived = new.sequence([*way, rig.tensions]).tip_position[-1]
        assert arrived == pytest.approx(place, abs=1e-3)
    else:
        assert rig.core.track.last.tip_position == pytest.approx(followed, abs=1e-3)


def see(rig):
    rig.core.predict(rig.now, lambda shape: None)


def test_a_loaded_model_has_its_library_no_search_waits_for_it():
    assert 'library' in vars(load(model().robot, load_catalogue()))


def longer(robot):
    sections = tuple(replace(one, cell_length=1.05 * one.cell_length) for one in robot.sections)
    return replace(robot, sections=sections)


OTHERS = {
    'name': lambda robot: replace(robot, name='another'),
    'length': longer,
}


@pytest.mark.parametrize('resume', [False, True])
@pytest.mark.parametrize('pull', [False, True])
@pytest.mark.parametrize('other', OTHERS)
def test_another_robot_takes_no_target_over(other, pull, resume):
    """Its base is elsewhere: the same numbers would be another place."""
    core = ControllerCore(model(), Settings(pull_mode=pull, resume=resume))
    place, nothing, now = np.zeros(4) if pull else np.full(4, 0.1), np.full(4, np.nan), 0.0

    def run(seconds):
        nonlocal now, place
        for _ in range(round(seconds / CYCLE)):
            now += CYCLE
            core.measured(now, *((nothing, place) if pull else (place, nothing)))
            if (output := core.step(now)) is not None:
                place = output.pulls if pull else output.tensions

    run(0.1)
    core.aim(reachable())
    run(1.0)
    before = place
    core.set_model(Model(OTHERS[other](model().robot)))
    run(1.0)
    assert core.target is core.search is core.solution is None
    assert place == pytest.approx(before, abs=1e-9)
    assert controller_status(core, now).code == 'holding'
    core.aim(reachable((0.3, 0.1, 0.1, 0.5)))
    run(1.0)
    assert place != pytest.approx(before, abs=1e-4)
