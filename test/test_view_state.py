"""What the live page says to do next, step by step, and what its buttons allow."""

import json

import numpy as np
import pytest

from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.ros.viewer import page_parts
from tendon_robot_ros.ros.viewer.page_parts import SIDES, tube_faces, tube_vertices
from tendon_robot_ros.ros.viewer.state import ViewState


def said(state, **values):
    """Let the monitor say something; return what the page then tells."""
    known = {'recording': 'false', 'postures': '0', 'diagnosing': 'false', 'addition': ''}
    state.set_status(0.0, 'monitor', 0, '', {**known, **values})
    return state.guide()


def published(verdict):
    content = {'verdict': verdict, 'guide': verdict.guide, 'may_add': verdict.may_add}
    return json.loads(json.dumps({**content, 'noise_floor': 3e-4}))


def test_the_page_leads_from_the_first_click_to_the_fallen_error():
    state = ViewState()
    assert 'Waiting for the robot' in state.guide()
    state.add_error(0.0, 5e-3)
    assert 'click 1 to record' in said(state)
    assert not state.ready['diagnose'] and not state.ready['add']
    assert 'Recording: 3 of 8' in said(state, recording='true', postures='3')
    assert 'Click 2' in said(state, recording='true', postures='9')
    assert state.ready['diagnose']
    assert 'Comparing every' in said(state, postures='9', diagnosing='true')
    assert not state.ready['diagnose'] and not state.ready['record']
    state.verdict = published(Verdict.MISSING_EFFECT)
    assert 'Fitting' in said(state, postures='9', diagnosing='true')
    assert 'Click 3' in said(state, postures='9', addition='gravity')
    assert state.ready['record']
    assert state.ready['add']
    assert 'now has gravity' in said(state, postures='9', added='1')
    assert not state.ready['add']
    assert [text for _, text in state.marks] == ['gravity']


def test_the_first_button_says_what_a_click_on_it_does_to_what_is_recorded():
    state = ViewState()
    state.add_error(0.0, 5e-3)
    said(state, kept='true')
    assert state.record_label == '1  Record'
    assert '1 stops' in said(state, recording='true', postures='49', kept='false')
    assert state.record_label == '1  Stop recording (49)'
    assert '1 records more' in said(state, postures='49', kept='false')
    assert state.record_label == '1  Record on, from 49' and state.ready['diagnose']
    said(state, postures='49', kept='true')  # diagnosed: a click begins another one
    assert state.record_label == '1  Record'


def test_a_new_diagnosis_forgets_the_verdict_before():
    state = ViewState()
    state.verdict = published(Verdict.ADEQUATE)
    assert 'Nothing is missing' in said(state, postures='9')
    assert 'Comparing every' in said(state, postures='9', diagnosing='true')
    assert state.verdict == {}


def test_what_the_catalogue_cannot_name_is_not_added():
    state = ViewState()
    state.verdict = published(Verdict.OUTSIDE_CATALOGUE)
    assert 'no name for this cause' in said(state, postures='9', addition='tip_load')
    assert not state.ready['add']


def test_reset_is_offered_after_a_stop_only():
    state = ViewState()
    assert not state.stopped
    state.set_status(0.0, 'driver', 2, '', {'stopped': 'true'})
    assert state.stopped


def test_the_marker_that_is_off_most_is_named_as_of_now():
    state = ViewState()
    assert state.per_marker() == ''
    state.add_marker_errors(0.0, (0.001, 0.004, 0.002))
    assert state.per_marker() == 'most at marker 2 of 3: 4.0 mm'
    state.add_marker_errors(2.0, (0.001, float('nan'), 0.002))
    assert state.per_marker() == 'most at the tip: 2.0 mm'
    state.add_marker_errors(3.0, ())  # another arm
    assert state.per_marker() == ''


def test_numbers_of_the_page_do_not_jump_with_single_readings():
    """An arm that is off by 2 mm; every other reading is anything up to 20 mm."""
    state, random = ViewState(), np.random.default_rng(1)
    shown, worst = set(), set()
    for i in range(300):
        now, wild = 0.2 * i, i % 4 == 3
        state.add_error(now, random.uniform(0.0, 0.02) if wild else 0.002)
        state.add_marker_errors(now, (0.03, 0.0, 0.0) if wild else (0.0005, 0.001, 0.002))
        if now > 1.5:
            shown.add(round(1e3 * state.rolling(now), 1))
            worst.add(state.per_marker())
    assert shown == {2.0} and worst == {'most at the tip: 2.0 mm'}
    assert np.isnan(state.rolling(now + 2.0)), 'what is old is not shown'
    for i in range(8):  # what stays is shown within a second
        state.add_error(now + 0.2 * (i + 1), 0.005)
    assert state.rolling(now + 1.6) == 0.005


@pytest.mark.parametrize(('length', 'square'), [(0.0312, 0.02), (0.05, 0.05), (1.2, 1.0)])
def test_squares_of_the_grid_have_round_sizes(length, square):
    assert page_parts.round_length(length) == pytest.approx(square)
    assert f'a square of the grid: {1e3 * square:g} mm' in page_parts.legend(square)


def test_the_news_of_an_investigation_are_kept_until_the_next_one_begins():
    state = ViewState()
    assert not state.ready['start']
    state.set_status(0.0, 'investigate', 0, 'free', {'code': 'waiting'})
    assert state.ready['start']
    first = {'kind': 'posture', 'number': 1, 'text': 'posture 1'}
    round_ = {'kind': 'diagnosis', 'postures': 4, 'text': '  4 postures: <b>tip_load</b>'}
    for news in (first, round_):
        state.add_investigation(json.dumps(news))
    shown = page_parts.investigation(state.investigation)
    assert '<td>&lt;b&gt;tip_load' in shown
    assert 'just wait' in state.guide()
    end = {'kind': 'end', 'names': ['tip_load'], 'text': '5 postures: no posture separates it'}
    state.add_investigation(json.dumps(end))
    assert 'over after 5 postures: no posture separates it' in state.guide()
    assert 'record' not in state.guide()
    sent = {'kind': 'sent', 'taken': True, 'text': 'the controller uses it'}
    state.add_investigation(json.dumps(sent))
    assert 'The model now has tip_load' in state.guide()
    state.verdict = {'guide': 'something older'}
    state.add_investigation(json.dumps(first))
    assert state.investigation == [first]
    assert 'just wait' in state.guide()
    state.add_investigation(json.dumps({'kind': 'failed', 'text': 'it was stopped'}))
    assert 'it was stopped. Click Investigate' in state.guide()
    assert page_parts.investigation([]) == ''


def test_after_an_alarm_the_page_offers_investigate_and_shows_what_has_changed():
    state = ViewState()
    state.set_status(0.0, 'investigate', 0, 'free', {'code': 'waiting'})
    drifted = 'no longer what the model says: looks like gain of left (97 %)'
    said(state, drift='true', watch=drifted)
    assert state.guide().startswith(f'The arm is {drifted}. Click Investigate')
    for news in (
        {'kind': 'change', 'text': '  looks like gain of left (97 %)', 'postures': 0},
        {'kind': 'posture', 'text': 'posture 1: ...', 'number': 1},
        {'kind': 'changed', 'text': '  1 postures: has changed: gain of left (+3.0 %)',
         'postures': 1},
    ):  # fmt: skip
        state.add_investigation(json.dumps(news))
    assert [news['kind'] for news in state.investigation] == ['change', 'posture', 'changed']
    assert 'Click Investigate' not in state.guide()
    assert '<td>has changed: gain of left (+3.0 %)</td>' in page_parts.investigation(
        state.investigation
    )


def test_a_tube_keeps_its_radius_around_a_bent_arm_and_does_not_turn():
    angle = np.linspace(0.0, np.pi, 40)
    nodes = 0.05 * np.c_[1.0 - np.cos(angle), np.zeros(40), np.sin(angle)]  # half a circle
    rings = tube_vertices(nodes, 0.004).reshape(40, SIDES, 3)
    np.testing.assert_allclose(np.linalg.norm(rings - nodes[:, None], axis=2), 0.004, rtol=1e-4)
    np.testing.assert_allclose(np.abs(rings[..., 1] - rings[0, :, 1]).max(), 0.0, atol=1e-6)
    faces = tube_faces(40)
    assert faces.max() == 40 * SIDES - 1 and len(faces) == 2 * SIDES * 39


def test_peaks_of_the_curve_are_cut_and_that_is_said():
    times = np.linspace(0.0, 100.0, 500).tolist()
    errors = [(t, 0.004 + (0.04 if i % 50 < 5 else 0.0)) for i, t in enumerate(times)]
    state = ViewState(curve=errors, verdict={'noise_floor': 6e-4})  # moves: a tenth
    drawn = page_parts.curve(state, 100.0)
    assert 'peaks up to 44 are cut off' in drawn and '>10</text>' not in drawn
    assert 'now 4.0 mm' in drawn
    state = ViewState(curve=[(t, 0.004) for t in times])
    assert 'cut off' not in page_parts.curve(state, 100.0)


def test_the_progress_of_a_diagnosis_is_a_bar_until_it_is_done():
    assert '<progress' not in page_parts.guide('wait', 'added gravity')
    whole = page_parts.guide('wait', 'effects again 1/1 (42 %, about 2 min to go)')
    assert 'value="42" max="100"' in whole
    assert '<progress aria-label' in page_parts.guide('wait', 'fitting what was found')
    assert 'role="status"' in page_parts.guide('wait', '')  # read out when it changes


def test_the_scene_is_told_in_words_as_well():
    seen = np.array([[0.0, 0.0, 0.1], [0.012, 0.0, 0.18], [np.nan] * 3])
    words = page_parts.scene(seen, seen + [0.003, 0.004, 0.0])
    assert words.startswith('<div role="img" aria-label="Scene in space: ')
    assert 'measured arm: tip at x 12, y 0, z 180 mm; predicted arm: tip at x 15, y 4' in words
    assert '; 5.0 mm apart"' in words
    nothing = page_parts.scene(np.zeros((0, 3)), np.zeros((0, 3)))
    assert 'measured arm: not there yet; predicted arm: not there yet"' in nothing
