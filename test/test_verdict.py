"""From evidence to a verdict: a table of numbers, without any measurement or fit."""

from dataclasses import replace
from itertools import chain

import pytest

from tendon_robot_ros.diagnosis.verdict import (
    ALARM_LEVEL,
    APART_FROM_SCORE,
    MISFIT_ALARM_LEVEL,
    P_SEVERAL_MIN,
    P_SINGLE_MIN,
    TOLERANCE_SD_MAX,
    Departure,
    Evidence,
    Hypothesis,
    Missing,
    Rival,
    decide,
    indistinct,
    is_alarming,
)

NEAR, FAR = 100.0, 100.0 + 2.0 * APART_FROM_SCORE
HINGE = Hypothesis(('hinge_friction',), NEAR, gain_p=1e-12)
LOAD = Hypothesis(('tip_load',), NEAR + 1.0, gain_p=1e-12)
POOR = replace(HINGE, probability=0.5 * P_SINGLE_MIN)
BOTH = Hypothesis(('hinge_friction', 'tip_load'), NEAR - 30.0, probability=2.0 * P_SEVERAL_MIN)
SOFTER = replace(BOTH, names=('hinge_friction', 'backbone_stiffness'), score=BOTH.score + 2.0)
BENT = replace(BOTH, names=('tip_load', 'pre_curvature'), score=BOTH.score + 3.0)
CELL = Rival('soft_cell', NEAR - 2.0 * APART_FROM_SCORE, gain_p=1e-12)
BEATEN = Rival('soft_cell', NEAR - 0.5 * APART_FROM_SCORE, gain_p=1e-12)
PUSH = Hypothesis(('point_load',), CELL.score)
STRING = Hypothesis(('tether',), CELL.score + 0.9 * APART_FROM_SCORE)


def at_places(*placed):
    """Return effects whose place had to be found as rivals of the others."""
    return tuple(Rival(one.names[0], one.score, gain_p=1e-12, placed=one) for one in placed)


CLEAR, NONE = [Departure(5.0, 25.0, 1)], [Departure(0.1, 0.01, 1)]


def evidence(*singles, built=False, probability=1e-9, departures=CLEAR, **known):
    """Return evidence of which every part is known, without a cause from outside."""
    parts = {'patterns': (), 'rivals': (), 'further': (), 'wider': frozenset(), 'helpful': singles}
    parts |= {'swapped': ()}
    placed = (one.placed for one in known.get('rivals') or () if one.placed)
    joint = (known.get(part) or () for part in ('combined', 'further', 'swapped'))
    every = (*singles, *chain.from_iterable(joint), *placed)
    parts |= {'departures': {one.names: departures for one in every}} | known
    return Evidence(built, 1000.0, probability, singles, **parts)


TABLE = {
    'nothing misfits': (evidence(replace(HINGE, gain_p=0.1), probability=0.5), 'adequate', None),
    'an arm as built may misfit more': (
        evidence(built=True, probability=2.0 * MISFIT_ALARM_LEVEL), 'adequate', None),
    'one effect explains it': (evidence(HINGE), 'missing_effect', HINGE),
    'a gain alone raises the alarm': (evidence(HINGE, probability=0.5), 'missing_effect', HINGE),
    'it is described already': (
        evidence(replace(HINGE, present=True)), 'wrong_parameter', HINGE),
    'two explain it alike': (evidence(HINGE, LOAD), 'ambiguous', HINGE),
    'one of them is far behind': (
        evidence(HINGE, replace(LOAD, score=FAR)), 'missing_effect', HINGE),
    'the larger one contains the smaller': (
        evidence(HINGE, LOAD, wider=frozenset([LOAD.names])), 'missing_effect', HINGE),
    'a declared quantity moved, and its twin explains it': (
        evidence(HINGE, LOAD, moved={'position': TOLERANCE_SD_MAX + 0.1},
                 twins={'position': 'tip_load'}), 'wrong_parameter', LOAD),
    'a cause from outside is better': (
        evidence(HINGE, rivals=(CELL,)), 'outside_catalogue', HINGE),
    'it is not better by enough': (evidence(HINGE, rivals=(BEATEN,)), 'missing_effect', HINGE),
    'what is better by chance does not count': (
        evidence(HINGE, rivals=(replace(CELL, gain_p=0.1),)), 'missing_effect', HINGE),
    'what raised the alarm beats what does not': (
        evidence(replace(HINGE, gain_p=1.0), built=True, patterns=(BEATEN,)),
        'outside_catalogue', HINGE),
    'what raised the alarm explains less than what does not': (
        evidence(replace(HINGE, gain_p=1.0), built=True, probability=0.5,
                 patterns=(replace(CELL, score=NEAR + 1.0),)), 'outside_catalogue', HINGE),
    'a load at a place gains no more than one of two does by chance': (
        evidence(replace(HINGE, gain_p=1.0), built=True, probability=0.5,
                 patterns=[replace(one, gain_p=0.6 * ALARM_LEVEL)
                           for one in at_places(PUSH, STRING)]), 'adequate', None),
    'a cell gains more than chance beside them': (
        evidence(replace(HINGE, gain_p=1.0), built=True, probability=0.5,
                 patterns=[replace(one, gain_p=0.6 * ALARM_LEVEL)
                           for one in (CELL, *at_places(PUSH, STRING))]),
        'outside_catalogue', HINGE),
    'a pattern explains as much as a load at a place': (
        evidence(replace(HINGE, gain_p=1.0), built=True, probability=0.5,
                 patterns=(replace(CELL, gain_p=0.02), *at_places(PUSH))),
        'outside_catalogue', HINGE),
    'a second effect gains as much': (
        evidence(HINGE, built=True, further=(BOTH,)), 'several', BOTH),
    'no single one is adequate, two are': (evidence(POOR, combined=(BOTH,)), 'several', BOTH),
    'two are not adequate on left-out postures': (
        evidence(POOR, combined=(replace(BOTH, trust=0.5 * P_SINGLE_MIN),)),
        'outside_catalogue', POOR),
    'two are adequate, a cause from outside is better': (
        evidence(POOR, combined=(BOTH,), rivals=(replace(CELL, score=0.0),)),
        'outside_catalogue', POOR),
    'nothing could be combined': (evidence(POOR, combined=()), 'outside_catalogue', POOR),
    'no effect differs from what is described': (
        evidence(POOR, combined=(BOTH,), departures=NONE), 'outside_catalogue', None),
    'a load at a place explains more': (
        evidence(HINGE, rivals=at_places(PUSH)), 'missing_effect', PUSH),
    'a load at a place alone raises the alarm': (
        evidence(replace(HINGE, gain_p=1.0), built=True, probability=0.5,
                 patterns=at_places(PUSH), rivals=at_places(PUSH)), 'missing_effect', PUSH),
    'a load at the tip explains nearly as much': (
        evidence(replace(LOAD, gain_p=1.0), built=True, probability=0.5,
                 patterns=at_places(replace(PUSH, score=NEAR - 3.0)),
                 rivals=at_places(replace(PUSH, score=NEAR - 3.0))), 'ambiguous',
        replace(PUSH, score=NEAR - 3.0)),
    'a load at a place alone differs from the description': (
        replace(evidence(replace(HINGE, gain_p=1.0), built=True, probability=0.5,
                         patterns=at_places(PUSH), rivals=at_places(PUSH)),
                departures={HINGE.names: NONE, PUSH.names: CLEAR}), 'missing_effect', PUSH),
    'but none that single postures determine': (
        evidence(replace(HINGE, gain_p=1.0), built=True, probability=0.5,
                 patterns=at_places(replace(PUSH, trust=0.5 * P_SINGLE_MIN))), 'adequate', None),
    'a string at a place explains as much as that load': (
        evidence(HINGE, rivals=at_places(PUSH, STRING)), 'ambiguous', PUSH),
    'a string far behind that load': (
        evidence(HINGE, rivals=at_places(PUSH, replace(STRING, score=NEAR))),
        'missing_effect', PUSH),
    'a string explains more than a load at the tip, but not by enough': (
        evidence(LOAD, rivals=at_places(replace(STRING, score=NEAR - 2.0))), 'ambiguous', LOAD),
    'a string explains no more than chance beyond a load at the tip': (
        evidence(LOAD, rivals=at_places(replace(STRING, score=NEAR))),
        'missing_effect', LOAD),
    'a load at a place that leaves too much is a part of the cause': (
        evidence(HINGE, rivals=at_places(replace(PUSH, probability=0.5 * P_SINGLE_MIN))),
        'outside_catalogue', PUSH),
    'a cause from outside beats a load at a place': (
        evidence(HINGE, rivals=(replace(CELL, score=0.0), *at_places(PUSH))),
        'outside_catalogue', HINGE),
    'nothing was tested': (evidence(combined=()), 'outside_catalogue', None),
}  # fmt: skip


@pytest.mark.parametrize('case', TABLE)
def test_verdict(case):
    known, verdict, chosen = TABLE[case]
    said = decide(known)
    assert said.verdict == verdict
    assert (said.chosen and said.chosen.names) == (chosen and chosen.names)


@pytest.mark.parametrize(
    ('known', 'part'),
    [
        (evidence(built=True, probability=0.5, patterns=None), 'patterns'),
        (evidence(HINGE, wider=None), 'wider'),
        (evidence(HINGE, rivals=None), 'rivals'),
        (replace(evidence(HINGE), departures={}), 'departures'),
        (evidence(HINGE, built=True, further=None), 'further'),
        (evidence(POOR), 'combined'),
        (evidence(POOR, combined=(), helpful=None), 'helpful'),
        (evidence(POOR, combined=(BOTH,), swapped=None), 'swapped'),
    ],
)
def test_what_does_not_decide_is_not_asked_for(known, part):
    with pytest.raises(Missing) as missing:
        decide(known)
    assert missing.value.part == part


@pytest.mark.parametrize(
    ('swapped', 'together'),
    [
        ([], ()),
        ([SOFTER], ('tip_load', 'backbone_stiffness')),
        ([replace(SOFTER, score=BOTH.score + 1.1 * APART_FROM_SCORE)], ()),
        ([replace(SOFTER, probability=0.5 * P_SINGLE_MIN)], ()),
        ([SOFTER, BENT], ('hinge_friction', 'tip_load', 'backbone_stiffness', 'pre_curvature')),
    ],
)
def test_of_several_those_that_another_may_stand_for_are_told(swapped, together):
    for known in ({'combined': (BOTH,)}, {'further': (BOTH,), 'built': True}):
        singles = [HINGE] if known.get('built') else [POOR]
        said = decide(evidence(*singles, swapped=tuple(swapped), **known))
        assert (said.verdict, said.chosen, said.together) == ('several', BOTH, together)
        assert [one.names for one in said.alike[1:]] == [one.names for one in swapped if together]


def test_an_alarm_needs_a_gain_that_the_number_of_candidates_does_not_explain():
    seen = replace(HINGE, gain_p=0.6 * ALARM_LEVEL)
    assert is_alarming(evidence(seen, probability=0.5))
    assert not is_alarming(evidence(seen, replace(LOAD, gain_p=1.0), probability=0.5))


def names(*singles, **known):
    return [one.names[0] for one in indistinct(evidence(*singles, **known))]


def test_the_class_ends_at_its_limit_and_holds_what_is_adequate():
    last = replace(LOAD, score=NEAR + APART_FROM_SCORE - 0.01)
    assert names(HINGE, last) == ['hinge_friction', 'tip_load']
    assert names(HINGE, replace(last, score=NEAR + APART_FROM_SCORE + 0.01)) == ['hinge_friction']
    assert names(HINGE, replace(LOAD, score=99.0, probability=5e-4)) == ['hinge_friction']


def test_ties_go_by_the_order_of_the_catalogue():
    assert (
        names(replace(HINGE, score=NEAR + 0.3), replace(LOAD, score=NEAR))[0] == 'hinge_friction'
    )
    assert names(replace(HINGE, score=NEAR + 3.0), replace(LOAD, score=NEAR))[0] == 'tip_load'
