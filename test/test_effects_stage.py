"""Stages as a table, and what stands in an effect's own file: the rest of the code reads both."""

from contextlib import nullcontext
from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest
from source_tree import ROOT

from tendon_robot_ros.common.errors import EffectError
from tendon_robot_ros.effects import (
    STAGES,
    Catalogue,
    Effect,
    Parameter,
    catalogue,
    load_catalogue,
    per_axis,
)
from tendon_robot_ros.model.compile import kernel_key, stages_source
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Built, Damage
from tendon_robot_ros.simulation.plant import parts_per_cell, real_robot


def softening(moment, total_tension, loss):
    """Return M (1 - loss S)."""
    return moment * (1.0 - loss * total_tension)


SOFTENING = Effect(
    name='softening',
    title='a joint that gives way under tension',
    stage='joint_friction',
    parameters=(Parameter('loss', '1/N', 0.0, 0.2, 0.0, typical=0.05, parts_power=2),),
    law=softening,
    divisible=True,
)


def with_softening():
    return Catalogue([*load_catalogue(), SOFTENING])


def robot():
    return load_robot(ROOT / 'config' / 'robots' / 'kato_2_1.yaml')


@pytest.mark.parametrize('stage', STAGES.values(), ids=STAGES)
def test_every_quantity_of_a_stage_has_a_name_a_unit_and_a_meaning(stage):
    assert stage.outputs
    assert all(q.name.isidentifier() and q.unit and q.meaning for q in stage.inputs)
    assert len({q.name for q in stage.inputs}) == len(stage.inputs)


def test_compiled_kernels_of_other_stages_are_not_taken_for_these(monkeypatch):
    before = kernel_key(load_catalogue())
    assert kernel_key(load_catalogue()) == before
    monkeypatch.setitem(STAGES, 'tip_load', replace(STAGES['tip_load'], name='load_at_the_tip'))
    assert kernel_key(load_catalogue()) != before


def test_every_stage_is_composed_with_what_its_table_says():
    source = stages_source(load_catalogue())
    for stage in STAGES.values():
        takes = ', '.join(quantity.name for quantity in stage.inputs)
        assert f'def {stage.name}({takes}, chain, column):' in source
        assert f'def {stage.name}_acts(chain):' in source


def test_one_more_effect_is_composed_after_those_of_its_stage():
    source = stages_source(with_softening())
    number = len(list(load_catalogue()))
    body = source.split('def joint_friction(')[1].split('@compiled')[0]
    assert f'moment = law_{number}(moment, total_tension, values[' in body
    assert body.index('moment = law_6(') < body.index(f'moment = law_{number}(')


def test_a_plant_divides_cells_only_where_every_effect_says_how():
    known = {'softening': {'loss': 0.1}}
    assert parts_per_cell(robot(), known, with_softening(), 3) == 3
    unknown = Catalogue([*load_catalogue(), replace(SOFTENING, divisible=False)])
    assert parts_per_cell(robot(), known, unknown, 3) == 1
    assert parts_per_cell(robot(), {'straight_tendon': {}}, load_catalogue(), 3) == 1


def test_finer_cells_have_the_parameters_that_the_effect_asks_for():

    owner, catalogue = robot(), with_softening()
    effects = {
        'softening': {'loss': 0.1},
        'tendon_stiffness': {'per_tendon': 1e-3},
        'pre_curvature': {'angle_x': 0.03, 'angle_y': 0.0},
        'nonlinear_stiffness': {'cubic': 2.0},
    }
    n = owner.cells
    none = Damage(owner, 0)
    real = real_robot(owner, effects, catalogue, 3, none, True, Built.exact(owner))
    assert real.cells == 3 * n
    assert real.effects['softening']['loss'] == pytest.approx(0.9)
    # three springs in a row: each three times as stiff, a third of the bend, nine times the cube
    assert real.effects['tendon_stiffness']['per_tendon'] == pytest.approx(3e-3)
    assert real.effects['pre_curvature']['angle_x'] == pytest.approx(0.01)
    assert real.effects['nonlinear_stiffness']['cubic'] == pytest.approx(18.0)


def test_every_declared_tolerance_of_an_effect_has_its_twin():
    catalogue = load_catalogue()
    assert catalogue.twin('bending_stiffness') == ('backbone_stiffness', ('relative_change',))
    assert catalogue.twin('rotation') == (
        'base_misalignment',
        ('rotation_x', 'rotation_y', 'rotation_z'),
    )
    assert catalogue.twin('cell_stiffness') is None


def test_what_an_effect_contains_is_in_the_catalogue():
    catalogue = load_catalogue()
    for effect in catalogue:
        assert set(effect.contains) <= set(catalogue.names)
    assert catalogue['section_stiffness'].contains == ('backbone_stiffness',)


def harder(moment, total_tension, loss):
    """Return M (1 + loss S)."""
    return moment * (1.0 + loss * total_tension)


def test_compiled_kernels_of_another_law_in_the_same_file_are_not_taken_for_this():
    other = Catalogue([*load_catalogue(), replace(SOFTENING, law=harder)])
    assert kernel_key(other) != kernel_key(with_softening())


def test_values_per_section_or_tendon_are_refused_where_the_stage_has_none():
    (loss,) = SOFTENING.parameters
    per_tendon, per_section = replace(loss, per_tendon=True), replace(loss, per_section=True)
    expected = 'loss: expected one value, or one per section at the stage joint_friction, got one'
    with pytest.raises(EffectError, match=f'{expected} per tendon'):
        replace(SOFTENING, parameters=(per_tendon,))
    assert replace(SOFTENING, parameters=(per_section,)).parameters == (per_section,)
    scale = load_catalogue()['moment_arm']
    per_section = replace(scale.parameters[0], per_section=True)
    with pytest.raises(EffectError, match='one value at the stage offset_scale, got one per sect'):
        replace(scale, parameters=(per_section,))


def test_an_effect_that_needs_something_unknown_is_refused():
    with pytest.raises(EffectError, match=r"softening: needs: expected one of gravity, .*'luck'"):
        replace(SOFTENING, needs='luck')


def misspelt(moment, total_tension, loss):
    return moment * (1.0 - los * total_tension)  # noqa: F821


def nothing(moment, total_tension, loss):
    moment * (1.0 - loss * total_tension)


def a_factor(moment, total_tension, loss):
    return moment * loss


def one_number(force, moment, friction, place, frame, along, before, behind, moved, loss):
    return force[0], moment, friction


@pytest.mark.parametrize(
    ('law', 'said'),
    [
        (misspelt, "its law cannot be called: NameError: name 'los' is not defined"),
        (nothing, 'its law gives back None, expected moment'),
        (a_factor, 'changes something where all parameters are neutral: loss = 0'),
    ],
)
def test_a_law_that_cannot_be_right_is_refused_before_it_is_compiled(law, said):
    with pytest.raises(EffectError, match=f'softening: .*{said}'):
        replace(SOFTENING, law=law)


def test_a_law_gives_back_vectors_where_its_stage_does():
    words = r'expected force \(3 numbers\), moment \(3 numbers\), friction \(3 numbers\)'
    with pytest.raises(EffectError, match=words):
        replace(SOFTENING, stage='push', law=one_number)


@pytest.mark.parametrize(
    ('value', 'said'),
    [
        ('no_such_module:EFFECT', "ModuleNotFoundError: No module named 'no_such_module'"),
        ('math:EFFECT', 'AttributeError: '),
        ('math', r'math: expected EFFECT = Effect\(...\), got <module'),
    ],
)
def test_an_installed_effect_that_cannot_be_loaded_is_named_in_one_line(monkeypatch, value, said):
    point = EntryPoint('mine', value, catalogue.ENTRY_POINT_GROUP)
    monkeypatch.setattr(catalogue, 'entry_points', lambda group: [point])
    catalogue._installed.cache_clear()
    try:
        with pytest.raises(EffectError, match=said):
            load_catalogue()
    finally:
        catalogue._installed.cache_clear()


@pytest.mark.parametrize(
    ('unit', 'finding', 'said'),
    [
        ('N', 'a load of {size}, {direction}', ''),
        ('N/m', 'a drag of {size}', 'loss_z, postures, place, got size'),
        ('N/m', 'a drag of {los_x}', 'expected fields of loss_x, .*, got los_x'),
    ],
)
def test_the_words_of_a_verdict_name_what_the_effect_has(unit, finding, said):
    (loss,) = SOFTENING.parameters

    def law(moment, total_tension, loss_x, loss_y, loss_z):
        return moment

    parameters = per_axis(replace(loss, unit=unit))
    refused = pytest.raises(EffectError, match=f'finding: .*{said}') if said else nullcontext()
    with refused:
        replace(SOFTENING, parameters=parameters, law=law, finding=finding)


def test_names_that_no_command_could_take_are_refused():
    (loss,) = SOFTENING.parameters
    words = "expected a name of letters, digits and underscores, got 'loss of it'"
    with pytest.raises(EffectError, match=words):
        replace(SOFTENING, parameters=(replace(loss, name='loss of it'),))
    with pytest.raises(EffectError, match="got 'soft:joint'"):
        replace(SOFTENING, name='soft:joint')


def test_a_size_that_robots_do_not_have_is_refused_with_its_place():
    (loss,) = SOFTENING.parameters
    effect = replace(SOFTENING, parameters=(replace(loss, of='lenght'),))
    words = "effect softening: loss: of: expected one of radius, length, .*, got 'lenght'"
    with pytest.raises(EffectError, match=words):
        effect.sized(natural_sizes(robot()))
