"""Every verdict in words: numbers in units that a person reads, reasons, and what to do."""

from dataclasses import replace

import numpy as np
import pytest

from tendon_robot_ros.diagnosis.report_rows import FittedErrors
from tendon_robot_ros.diagnosis.result import (
    CandidateRow,
    Diagnosis,
    EffectFinding,
    NextMeasurement,
    Value,
)
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.intervals import load_of
from tendon_robot_ros.report.diagnosis_text import (
    alike,
    lines,
    next_measurement,
    trust_lines,
    untested,
    verdict,
)
from tendon_robot_ros.report.sentences import (
    finding_words,
    load_words,
    quantities,
    quantity,
)

LEVER = Value(1.584e-4, 1.517e-4, 1.652e-4, 'm')
HINGE = EffectFinding('hinge_friction', {'lever': LEVER}, 0.984)
STIFFER = EffectFinding('backbone_stiffness', {
    'relative_change': Value(0.1082, 0.1062, 0.1103, '1')}, 0.5)  # fmt: skip
LOAD = EffectFinding('tip_load', {
    'force_x': Value(2.455e-3, 2.385e-3, 2.525e-3, 'N'),
    'force_y': Value(-2e-5, -1.2e-4, 8e-5, 'N')}, 0.984)  # fmt: skip
WORDS = {'effects_in_words': {
    e.name: {'title': e.title, 'finding': e.finding} for e in load_catalogue()}}  # fmt: skip
FOUND = Diagnosis(
    'missing_effect', (HINGE,), (), (), (), 2e-3, 3e-4, 2.5e-4, None, 'What is left (...).', (),
    {'next_best': {'name': 'tip_load', 'log10_likelihood_ratio': 31.4}} | WORDS,
)  # fmt: skip


@pytest.mark.parametrize(('value', 'text'), [
    (LEVER, 'x = 0.158 ± 0.007 mm'),
    (Value(0.108, 0.106, 0.110, '1'), 'x = 0.108 ± 0.002'),
    (Value(0.02, 0.017, 0.023, 'rad'), 'x = 1.15 ± 0.17°'),
    (Value(2.27e-4, 2.14e-4, 2.40e-4, 'N·m/rad'), 'x = 0.227 ± 0.013 mN·m/rad'),
    (Value(0.05, 0.0488, 0.0512, 'kg/m'), 'x = 50.0 ± 1.2 g/m'),
    (Value(3.6, 3.5, 3.7, '1/rad²'), 'x = 3.60 ± 0.10 1/rad²'),
    (Value(1.0, 0.92, 1.0, '1', 'at its bound'), 'x = 1.00 (95 %: 0.92 to 1.00, at its bound)'),
    (Value(0.0, 0.0, 20.0, 'kg/m', 'not determined by these postures'),
     'x = 0 kg/m (95 %: 0 to 20, not determined by these postures)'),
    (Value(1e-9, 0.0, 7e-6, '1/N', 'at its bound'),
     'x = 0.000 1/N (95 %: 0.000 to 0.000007, at its bound)'),
])  # fmt: skip
def test_values_are_shown_with_their_interval(value, text):
    assert quantity('x', value) == text


def test_changes_are_shown_in_percent_and_forces_in_one_unit():
    change = {'relative_change': Value(-0.081, -0.085, -0.077, '1')}
    assert quantities(change) == 'relative_change = -8.1 ± 0.4 %'
    assert quantities(LOAD.parameters) == 'force_x = 2.46 ± 0.07 mN, force_y = -0.02 ± 0.10 mN'


AXES = np.eye(3)
FIRM, LEVEL = 1e-6 * AXES, (9.81, 0.0, 0.0)  # [N²]: 1 mN in every direction; x is down


@pytest.mark.parametrize(('force', 'covariance', 'gravity', 'text'), [
    ([0.1, 0.0, 0.0], FIRM, LEVEL,
     "0.1000 ± 0.0020 N, along gravity, 90.0 ± 1.1° from the arm's axis"),
    ([-0.1, 0.001, 0.0], FIRM, LEVEL,
     "0.1000 ± 0.0020 N, against gravity, 90.0 ± 1.1° from the arm's axis"),
    ([0.03, 0.0, 0.04], FIRM, LEVEL,
     "50.0 ± 2.0 mN, 53 ± 2° from gravity, 37 ± 2° from the arm's axis"),
    ([0.03, 0.0, 0.04], FIRM, None, "50.0 ± 2.0 mN, 37 ± 2° from the arm's axis towards x"),
    ([0.0, -0.04, 0.03], FIRM, None, "50.0 ± 2.0 mN, 53 ± 2° from the arm's axis towards -y"),
    ([0.03, 0.03, 0.0], FIRM, None,
     "42.4 ± 2.0 mN, 90 ± 3° from the arm's axis towards 45° (x: 0°, y: 90°)"),
    ([0.0, 0.001, 0.05], FIRM, None, "50.0 ± 2.0 mN, along the arm's axis, towards its tip"),
    ([0.0, 0.0, -0.05], FIRM, None, "50.0 ± 2.0 mN, along the arm's axis, towards its base"),
    ([0.001, 0.001, 0.0], FIRM, LEVEL,
     '1.4 mN (95 %: 0.0 to 3.4), its direction is not told'),
    ([0.1, 0.0, 0.0], None, LEVEL, "0.100 N, along gravity, 90.0° from the arm's axis"),
])  # fmt: skip
def test_a_force_is_told_by_its_size_and_direction(force, covariance, gravity, text):
    assert load_words(load_of(force, covariance, gravity)) == text


def test_intervals_of_size_and_angle_hold_the_true_ones():
    """Forces with correlated errors: 95 % of the intervals hold size and both angles."""
    random = np.random.default_rng(3)
    true = np.array([0.06, 0.02, 0.05])
    root = 2e-3 * random.normal(size=(3, 3))
    exact, held = load_of(true, None, LEVEL), []
    for _ in range(2000):
        found = load_of(true + root @ random.normal(size=3), root @ root.T, LEVEL)
        held.append([
            told.low <= really.value <= told.high
            for told, really in ((found.size, exact.size), (found.from_axis, exact.from_axis),
                                 (found.from_gravity, exact.from_gravity))
        ])  # fmt: skip
    assert np.mean(held, axis=0) == pytest.approx([0.95] * 3, abs=0.02)


def test_a_finding_that_is_a_force_says_so_in_the_verdict():
    load = load_of([2.455e-3, -2e-5, 0.0], 1e-9 * AXES, LEVEL)
    found = replace(FOUND, effects=(replace(LOAD, load=load),))
    assert verdict(found).splitlines() == [
        "Missing: a load of 2.46 ± 0.06 mN at the tip, along gravity, 90.0 ± 1.4° from the arm's "
        'axis (`tip_load`).',
        'It explains 98 % of the error above the noise.',
        'In the description: tip_load: force_x = 2.46 ± 0.07 mN, force_y = -0.02 ± 0.10 mN.',
    ]
    told = found.to_json()['effects'][0]['load']
    assert told['size']['value'] == pytest.approx(2.455e-3, rel=1e-3)
    assert told['from_axis']['unit'] == 'rad' and told['from_gravity']['low'] == 0.0


def test_the_owner_of_a_value_is_said_in_words():
    change = {'relative_change[distal]': Value(-0.081, -0.085, -0.077, '1')}
    assert quantities(change) == 'relative_change of distal = -8.1 ± 0.4 %'


def test_the_share_is_of_what_the_noise_leaves_even_where_it_was_declared_too_large():
    def shares(before, best, other, floor):
        errors = FittedErrors(before, best, best, floor, False)
        return errors.explained(best), errors.explained(other)

    assert shares(5e-3, 1e-3, 3e-3, 1e-3) == (1.0, pytest.approx(0.5))
    assert shares(5e-3, 1e-3, 3e-3, 2e-3) == (1.0, pytest.approx(0.5))  # of what is left
    assert shares(5e-3, 1e-3, 6e-3, 1e-3) == (1.0, 0.0)
    assert shares(1e-3, 1e-3, 1e-3, 2e-3) == (0.0, 0.0)


def test_what_the_effect_does_alone_and_with_the_arm_as_found_have_their_own_names():
    details = FOUND.details | {'error_as_found': 1.2e-3}
    found = replace(FOUND, error_alone=8e-4, details=details)
    assert verdict(found).endswith(
        'It explains 98 % of the error above the noise with the arm as it was found, 68 % alone, '
        'and that arm 45 % without it.'
    )
    assert (
        'error: 2.00 mm as described -> 0.800 mm with hinge_friction alone -> 0.300 mm with the '
        'arm as it was found as well (tolerances and imperfections), which is what `add` writes'
    ) in lines(found)
    assert not any(line.startswith('error: ') for line in lines(replace(FOUND, error_alone=3e-4)))


def test_one_missing_effect():
    assert verdict(FOUND) == (
        'Missing: friction in the hinges of the pressed guides, lever 0.158 ± 0.007 mm '
        '(`hinge_friction`).\nIt explains 98 % of the error above the noise.'
    )
    assert alike(FOUND) == (
        'cannot be told apart from: nothing (next best, tip_load, is 10^31 times less likely)'
    )


@pytest.mark.parametrize('number', [0.0, 3.1e-250, 2.5e-9])
def test_numbers_next_to_nothing_are_no_row_of_zeros(number):
    value = Value(number, 0.9 * number, 1.1 * number, '1')
    assert len(quantity('x', value)) < 30


def test_several_missing_effects():
    found = replace(FOUND, verdict='several', effects=(HINGE, STIFFER))
    assert verdict(found) == (
        'Missing: friction in the hinges of the pressed guides, lever 0.158 ± 0.007 mm '
        '(`hinge_friction`); and the backbone is 10.8 ± 0.2 % stiffer than described '
        '(`backbone_stiffness`).\n'
        'Together they explain 98 % of the error above the noise.\n'
        'In the description: backbone_stiffness: relative_change = 10.8 ± 0.2 %.'
    )


def test_effects_that_cannot_be_told_apart():
    step = NextMeasurement({'left': 1.1, 'right': 0.8}, None, None, 6.3e-3, 3e-4, {
        'hinge_friction': [0.0, 0.0, 0.1], 'backbone_stiffness': [6e-3, 0.0, 0.1],
        'transmission_loss': [6.1e-3, 0.0, 0.1]})  # fmt: skip
    names = ('hinge_friction', 'backbone_stiffness', 'transmission_loss')
    softer = replace(row(0.3), name='backbone_stiffness', parameters={
        'relative_change': Value(-0.081, -0.085, -0.077, '1')})  # fmt: skip
    found = replace(FOUND, verdict='ambiguous', cannot_tell_apart=names, next_measurement=step,
                    candidates=(softer,), details=FOUND.details | {'postures': 6})  # fmt: skip
    assert verdict(found) == (
        'Missing: one of these, and these 6 postures do not tell which:\n'
        '- friction in the hinges of the pressed guides, lever 0.158 ± 0.007 mm '
        '(`hinge_friction`)\n'
        '- the backbone is 8.1 ± 0.4 % softer than described (`backbone_stiffness`)\n'
        '- tension is lost before the base (`transmission_loss`)\n'
        'The first explains 98 % of the error above the noise; the others do about as well.'
    )
    wider = replace(found, details={'wider': ['section_stiffness']})
    assert alike(wider) == 'section_stiffness does the same with more parameters'
    assert next_measurement(found) == (
        'Measure this next: left 1.10 N, right 0.800 N, 5 trials. hinge_friction predicts the '
        'tip at least 6.0 mm from the others; your noise there is 0.30 mm.'
    )


@pytest.mark.parametrize(('changes', 'text'), [
    ({'after': {'left': 2.0, 'right': 0.0}}, 'left 1.10 N, coming from left 2.00 N, 5 trials. '),
    ({'gravity': [0.0, 0.0, -9.81]},
     'left 1.10 N, with the base turned so that gravity is [0, 0, -9.81] m/s², 5 trials. '),
])  # fmt: skip
def test_a_next_measurement_says_how_to_get_there(changes, text):
    step = NextMeasurement({'left': 1.1}, None, None, 6e-3, 3e-4, {
        'a': [0.0, 0.0, 0.1], 'b': [6e-3, 0.0, 0.1]})  # fmt: skip
    found = replace(FOUND, cannot_tell_apart=('a', 'b'), next_measurement=replace(step, **changes))
    assert next_measurement(found) == (
        f'Measure this next: {text}a and b predict tips 6.0 mm apart; your noise there is 0.30 mm.'
    )


def test_exact_twins_need_another_kind_of_measurement():
    step = NextMeasurement({'left': 1.1}, None, None, 2e-9, 3e-4, {'a': [0, 0, 1], 'b': [0, 0, 1]})
    found = replace(FOUND, cannot_tell_apart=('a', 'b'), next_measurement=step)
    assert next_measurement(found).startswith(
        'No posture within the limits separates a and b: they differ by less than 0.01 mm'
    )


def test_a_value_that_is_off():
    found = replace(FOUND, verdict='wrong_parameter', details=WORDS | {'described': {
        'hinge_friction': {'lever': 1e-4}}})  # fmt: skip
    assert verdict(found) == (
        'A value is off: friction in the hinges of the pressed guides, lever 0.158 ± 0.007 mm '
        '(`hinge_friction`); the description says lever 0.100 mm.\n'
        'It explains 98 % of the error above the noise.'
    )


def test_a_tolerance_that_is_broken():
    found = replace(FOUND, verdict='wrong_parameter', effects=(STIFFER,),
                    out_of_tolerance=('bending_stiffness',),
                    details=WORDS | {'moved': {'bending_stiffness': 5.4}})  # fmt: skip
    assert verdict(found) == (
        'A value is off: the backbone is 10.8 ± 0.2 % stiffer than described '
        '(`backbone_stiffness`).\n'
        'bending_stiffness (by 5.4 times its tolerance) must move further than declared.\n'
        'In the description: backbone_stiffness: relative_change = 10.8 ± 0.2 %.'
    )


def row(probability):
    return CandidateRow('hinge_friction', {}, 1.0, 1, probability, 0.9, 1e-3, 1e-3, 'best', False)


def test_a_cause_outside_the_catalogue():
    found = replace(FOUND, verdict='outside_catalogue', error_after=7.75e-4,
                    candidates=(row(1e-30),))  # fmt: skip
    assert verdict(found) == (
        'Missing: something that no known effect describes.\n'
        'Nearest: friction in the hinges of the pressed guides, lever 0.158 ± 0.007 mm '
        '(`hinge_friction`). It lowers the error from 2.00 mm to 0.775 mm, but what remains is '
        '3.1 times the noise (p < 1e-6).'
    )
    small = verdict(replace(found, error_after=2.4e-4))
    assert small.endswith('but what remains is not random (p < 1e-6), though it is only 0.96 '
                          'times the noise.')  # fmt: skip
    load = load_of([0.0, 0.0, 0.05], FIRM)
    loaded = verdict(replace(found, effects=(replace(LOAD, load=load),)))
    assert 'Nearest: a load of 50.0 ± 2.0 mN at the tip, along the arm' in loaded
    beaten = replace(found, candidates=(row(0.2),), details={'rival': {'name': 'soft_cell'}})
    assert verdict(beaten).endswith('but a single soft cell fits better without any physics.')
    nothing = replace(found, effects=(), error_before=7.75e-4)
    assert verdict(nothing) == (
        'Missing: something that no known effect describes.\n'
        'No known effect helps; the error is 3.1 times the noise.'
    )
    small = verdict(replace(nothing, error_before=2.35e-4))
    assert small.endswith('the error is not random, though it is only 0.94 times the noise.')


def test_nothing_missing_and_nothing_to_judge_by():
    found = replace(FOUND, verdict='adequate', effects=(), details={'detectable': {
        'hinge_friction': {'size': 1.43e-5, 'parameter': 'lever', 'unit': 'm'},
        'backbone_stiffness': {'size': 0.0048, 'parameter': 'relative_change', 'unit': '1'},
    }})  # fmt: skip
    assert lines(found)[-1] == (
        'smallest size that would have been seen (four times in five): hinge_friction lever '
        '14 µm, backbone_stiffness relative_change 0.48 %'
    )
    assert verdict(found) == 'Nothing is missing that these measurements could show.'
    assert verdict(replace(found, details={'accuracy': 1e-3})) == (
        'Nothing is missing that matters at an accuracy of 1.0 mm.'
    )
    blank = replace(found, verdict='cannot_judge', remainder='1 measured posture(s)', details={})
    assert lines(blank) == ['Cannot be judged: 1 measured posture(s).']
    swapped = replace(blank, details={'mistake': {}}, remainder='with a and b swapped ...')
    assert verdict(swapped) == 'Mistake of the set-up: with a and b swapped ....'


def test_what_has_changed_since_another_recording():
    since = {'reference': {'data': 'old', 'error': 1e-3}}
    assert verdict(replace(FOUND, details=FOUND.details | since)).startswith(
        'Changed since old: friction in the hinges'
    )
    same = replace(FOUND, verdict='adequate', effects=(), details=since)
    assert verdict(same) == ('Nothing has changed since old that these measurements could show.')


@pytest.mark.parametrize(('title', 'finding', 'values', 'text'), [
    ('a pulley that gives way', '', {'loss': Value(0.02, 0.018, 0.022, '1/N')},
     'a pulley that gives way, loss 0.020 ± 0.002 1/N'),
    ('', 'sections are {relative_change:stiffer/softer}',
     {'relative_change[near]': Value(0.05, 0.04, 0.06, '1'),
      'relative_change[far]': Value(-0.03, -0.04, -0.02, '1')},
     'sections are 5.0 ± 1.0 % stiffer (near) and 3.0 ± 1.0 % softer (far)'),
    ('a force', 'a load of {size}', LOAD.parameters,
     'a force, force x 2.46 ± 0.07 mN, force y -0.02 ± 0.10 mN'),
])  # fmt: skip
def test_a_finding_is_said_in_the_words_of_its_effect(title, finding, values, text):
    assert finding_words(title, finding, values) == text


def test_what_is_not_tested_is_grouped_by_its_reason():
    found = replace(FOUND, not_tested=('gravity', 'a', 'b', 'c'), details={
        'not_tested_because': {'gravity': 'set to zero', 'a': 'no unloading', 'b': 'set to zero'},
    })  # fmt: skip
    assert untested(found) == (
        'not tested by these postures: gravity, b (set to zero); a (no unloading); c'
    )
    assert untested(FOUND) == ''


def test_what_a_verdict_rests_on_stands_below_it():
    details = {'robot': 'arm', 'data': 'run', 'postures': 1, 'trials': 5, 'markers': 1,
               'tolerances': {'position': 2e-4, 'rotation': 2e-3, 'tension_gain': 0.01},
               'noise': {'source': 'declared', 'position': 1e-4, 'trial': 0.0, 'setting': 0.0},
               }  # fmt: skip
    rested = replace(FOUND, details=details | {'postures': 13, 'at_rest': 1})
    said = lines(rested)
    assert said[said.index('') + 1].startswith('arm on run: 13 postures (one at rest), 5 trials')
    assert lines(replace(FOUND, details=details))[-3:] == [
        'arm on run: 1 posture, 5 trials and 1 marker',
        'declared tolerances (1 sd): position 0.20 mm, rotation 0.11°, tension_gain 1.0 %; '
        'everything else is taken as exact',
        'noise, as declared: 0.10 mm per coordinate, inputs 0 % per trial; none declared for how '
        'inputs are set',
    ]


def test_a_trust_that_could_not_be_worked_out_says_why():
    outside = replace(FOUND, verdict='outside_catalogue')
    assert trust_lines(FOUND) == []
    (said,) = trust_lines(replace(outside, details={'trust': None}))
    assert 'could not be simulated' in said
    known = {'runs': 0, 'alarm_rate': None, 'alarm_rate_low': 0.0, 'alarm_rate_high': 1.0,
             'detectable': {}, 'checked': 0, 'detected': 0}  # fmt: skip
    (said,) = trust_lines(replace(outside, details={'trust': known}))
    assert 'no simulation of your postures ended' in said
    known |= {'runs': 9, 'alarm_rate': 0.0, 'alarm_rate_high': 0.3}
    assert trust_lines(replace(outside, details={'trust': known}))[-1].endswith('it says nothing.')
    assert len(trust_lines(replace(FOUND, details={'trust': known}))) == 2
