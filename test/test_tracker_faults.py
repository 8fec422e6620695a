"""A marker that was not seen is none for every reader, whatever was written in its place."""

import numpy as np
import pytest

from tendon_robot_ros.data.tracker_faults import (
    HELD,
    SENTINEL,
    ZERO,
    exchange_lines,
    is_missing,
    put_back,
    renumbered,
    unseen_lines,
    without_unseen,
)

LENGTH = 0.12  # [m] of the arm
HIDDEN = slice(40, 70)


def frames(noise=1e-4, count=200, seed=1):
    """Return places (T, 3, 3) [m] of three markers of an arm that goes to and fro."""
    swing = 0.5 * (1.0 - np.cos(np.arange(count) / 15.0))
    arm = np.array([[0.01, 0.0, 0.04], [0.03, 0.0, 0.07], [0.06, 0.0, 0.09]])
    rest = np.array([[0.0, 0.0, 0.04], [0.0, 0.0, 0.08], [0.0, 0.0, 0.12]])
    places = rest + swing[:, None, None] * (arm - rest) + [0.2, 0.1, 0.3]
    return places + np.random.default_rng(seed).normal(0.0, noise, places.shape)


@pytest.mark.parametrize(
    ('value', 'why'),
    [
        ((0.0, 0.0, 0.0), ZERO),
        ((-3.697314e28, -3.697314e28, -3.697314e28), SENTINEL),
        ((9999.999, 9999.999, 9999.999), SENTINEL),
        ((9.999, 9.999, 9.999), SENTINEL),
        ((-1.0, -1.0, -1.0), SENTINEL),
        ((0.0, 0.0, -9.999), SENTINEL),
        ((np.inf, 0.0, 0.0), None),
        ((0.1, np.nan, 0.1), None),
    ],
)
def test_what_stands_for_not_seen_is_taken_out(value, why):
    right = frames()
    places = right.copy()
    places[HIDDEN, 1] = value
    seen, counts = without_unseen(places, LENGTH)
    expected = right.copy()
    expected[HIDDEN, 1] = np.nan
    np.testing.assert_allclose(seen, expected)
    assert {w: count.tolist() for w, count in counts.items()} == ({why: [0, 30, 0]} if why else {})


def test_a_last_place_that_is_held_while_others_change_is_taken_out():
    places = frames()
    places[HIDDEN, 1] = places[HIDDEN.start - 1, 1]
    seen, counts = without_unseen(places, LENGTH)
    assert np.isnan(seen[HIDDEN, 1]).all() and np.isfinite(np.delete(seen, 1, axis=1)).all()
    assert counts[HELD].tolist() == [0, 30, 0]
    assert unseen_lines(counts, 'abc') == [
        '30 marker readings of b are none: the last place, repeated exactly while other markers '
        'change'
    ]


def standing(places):
    """Let the arm stand still without noise for half of the time."""
    return places[np.minimum(np.arange(len(places)), 100)]


def rounded(places):
    """Write in steps of a millimetre."""
    return places.round(3)


def repeated(places):
    """Log every frame three times."""
    return np.repeat(places, 3, axis=0)


def one_fixed(places):
    """Let one marker sit on the base, noise-free."""
    places[:, 0] = places[0, 0]
    return places


def one_alone(places):
    """Leave one marker, which stands still for a while."""
    return standing(places)[:, :1]


@pytest.mark.parametrize('change', [np.copy, standing, rounded, repeated, one_fixed, one_alone])
@pytest.mark.parametrize('noise', [0.0, 5e-5])
@pytest.mark.parametrize('seed', range(3))
def test_what_was_seen_stays(change, noise, seed):
    places = change(frames(noise, seed=seed))
    seen, counts = without_unseen(places, LENGTH)
    assert not counts
    np.testing.assert_array_equal(seen, places)


def test_places_in_a_wrong_unit_are_no_sentinels():
    places = 1e3 * standing(frames(0.0))  # mm, said to be m
    assert not without_unseen(places, LENGTH)[1]


def test_a_single_frame_knows_what_is_none_by_itself():
    places = [[0.0, 0.0, 0.0], [np.nan, 1.0, 1.0], [-9999.0, 0.1, 0.1], [0.0, 0.0, 0.1]]
    assert is_missing(np.array(places)).tolist() == [True, True, True, False]


def test_a_marker_that_is_numbered_anew_is_one():
    places = frames()
    anew = np.full((len(places), 2, 3), np.nan)
    anew[80:150, 0] = places[80:150, 1]
    anew[153:, 1] = places[153:, 1]
    places[79:, 1] = np.nan
    assert renumbered(np.concatenate([places, anew], axis=1)) == [(0,), (1, 3, 4), (2,)]


def gone_for_a_while(places):
    places[80:120, 1] = np.nan
    return places


def another_one(places):
    """Add a marker of another body that comes when one goes."""
    far = np.full_like(places[:, :1], np.nan)
    far[80:, 0] = places[80:, 1] + [0.0, 0.05, 0.0]
    places[80:, 1] = np.nan
    return np.concatenate([places, far], axis=1)


def never_seen(places):
    places[:, 1] = np.nan
    return places


@pytest.mark.parametrize('change', [np.copy, gone_for_a_while, another_one, never_seen])
def test_markers_that_are_others_stay_others(change):
    places = change(frames())
    assert renumbered(places) == [(j,) for j in range(places.shape[1])]


def twice(places):
    """Let markers 0 and 1 exchange their columns from a frame on, and then 1 and 2."""
    places[80:, [0, 1]] = places[80:, [1, 0]]
    places[150:, [1, 2]] = places[150:, [2, 1]]
    return [(80, 0, 1), (150, 1, 2)]


def for_a_while(places):
    places[80:120, [0, 2]] = places[80:120, [2, 0]]
    return [(80, 0, 2), (120, 0, 2)]


def after_a_gap(places):
    """Nobody knows which of the two is seen in the gap: none is."""
    places[70:90, 1] = np.nan
    places[80:, [0, 1]] = places[80:, [1, 0]]
    return [(90, 0, 1)]


@pytest.mark.parametrize('change', [twice, for_a_while, after_a_gap])
@pytest.mark.parametrize('noise', [0.0, 5e-5])
def test_markers_that_exchange_their_columns_are_put_back(change, noise):
    right = frames(noise)
    wrong = right.copy()
    exchanges = change(wrong)
    places, found = put_back(wrong)
    assert found == exchanges
    same = (places == right).all(axis=2)
    gone = np.isnan(places).all(axis=2)
    assert (same | gone).all()
    assert gone.sum() == (40 if change is after_a_gap else 0)


@pytest.mark.parametrize('change', [np.copy, standing, rounded, gone_for_a_while, never_seen])
def test_markers_that_stay_in_their_columns_are_left_there(change):
    places = change(frames(5e-5))
    seen, found = put_back(places)
    assert not found
    np.testing.assert_array_equal(seen, places)


def test_an_exchange_is_said_once_with_when_and_how_often():
    times, names = np.arange(200) / 25.0, ['Marker 2', 'Marker 3', 'Marker 4']
    assert exchange_lines([(50, 0, 1), (100, 1, 2), (125, 0, 1)], times, names) == [
        'Marker 2 and Marker 3 exchange their names at 2.00 s and 1 times more: put back to what '
        'they are before',
        'Marker 3 and Marker 4 exchange their names at 4.00 s: put back to what they are before',
    ]
