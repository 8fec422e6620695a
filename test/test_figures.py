"""Two records of figures side by side: what counts as moved."""

import json
import sys

import pytest
from source_tree import ROOT

sys.path.insert(0, str(ROOT / 'benchmarks'))
from figures import beside, leaves, moved


@pytest.mark.parametrize(
    ('old', 'new', 'counts'),
    [
        ([1.0, 1.2, 1.1], [1.15, 1.3, 1.25], False),  # repeats overlap
        ([1.0, 1.2, 1.1], [1.3, 1.4, 1.35], True),
        ([1.0], [1.005], False),  # less than anybody would act on
        ([1.0], [0.9], True),
        ([0.0], [0.0], False),
        (['hinge_friction'], ['hinge_friction'], False),
        (['hinge_friction'], ['tip_load'], True),
    ],
)
def test_a_figure_moves_beyond_the_spread_of_its_repeats(old, new, counts):
    assert bool(moved(old, new)) is counts


def test_every_number_and_word_of_a_benchmark_is_a_figure_but_those_of_the_machine():
    said = {'host': 'a', 'load_before': 2.0, 'load': {'mm': [1.0, None]}, 'met': True, 'name': 'x'}
    assert dict(leaves(said)) == {'load/mm/0': 1.0, 'met': 1.0, 'name': 'x'}


def test_two_records_side_by_side_name_what_moved_what_is_gone_and_what_is_new(tmp_path, capsys):
    files = []
    for name, figures in (
        ('old', {'a': [1.0, 1.1], 'b': [2.0], 'c': [3.0]}),
        ('new', {'a': [1.05, 1.1], 'b': [2.5], 'd': [4.0]}),
    ):
        files.append(tmp_path / f'{name}.json')
        files[-1].write_text(json.dumps({'parts': {'model': {'figures': figures}}}))
    assert beside(*files) == 3
    told = capsys.readouterr().out
    assert 'model: 3 of 4 figures moved' in told
    for line in ('b: 2 to 2 -> 2.5 to 2.5', 'c: is gone', 'd: is new: 4.0'):
        assert line in told
