"""docs/effects.md says what the catalogue says, and shows a picture of every effect."""

import json
import re
import sys

import pytest
from PIL import Image
from source_tree import ROOT

sys.path.insert(0, str(ROOT / 'tools'))
import effects_page
from effect_shapes import CATALOGUE, SIZES

TEXT = effects_page.PAGE.read_text(encoding='utf-8')
NAMES = ['overview', *CATALOGUE.names]
SMALL = 40_000  # [bytes] of a picture


def written(name):
    """Return the part of the page that the command writes."""
    found = [match[0] for match in effects_page.WRITTEN.finditer(TEXT) if match[2] == name]
    assert len(found) == 1, f'{name}: expected once in docs/effects.md'
    return found[0].split('\n', 1)[1].removesuffix('<!-- end -->')


@pytest.mark.parametrize('name', NAMES)
def test_tables_and_figures_are_those_of_the_model(name):
    assert written(name) == effects_page.part(name), 'type: python tools/effects_page.py'


def test_every_effect_has_a_section_in_catalogue_order():
    assert tuple(re.findall(r'^## (\w+)$', TEXT, re.M)) == CATALOGUE.names == tuple(SIZES)


@pytest.mark.parametrize('name', CATALOGUE.names)
def test_a_section_says_what_happens_and_how_to_tell_it_apart(name):
    section = TEXT.split(f'\n## {name}\n')[1].split('\n## ')[0]
    by_hand = effects_page.WRITTEN.sub('', section)
    assert re.search(r'\[\d+\]', by_hand), 'the number of its equation'
    assert 'Tell apart: ' in by_hand
    assert len(by_hand) < 800, 'short'


@pytest.mark.parametrize('name', CATALOGUE.names)
def test_its_picture_is_small_and_shows_the_model_as_it_is(name):
    path = effects_page.PICTURES / f'{name}.png'
    assert path.stat().st_size < SMALL
    with Image.open(path) as picture:
        shown = json.loads(picture.text['Description'])
    now = effects_page.tips(name)
    assert list(shown) == list(now)
    for posture, numbers in now.items():
        assert shown[posture] == pytest.approx(numbers, abs=0.02), 'python tools/effects_page.py'


def test_no_picture_is_left_over():
    drawn = {path.stem for path in effects_page.PICTURES.iterdir()}
    assert drawn == set(CATALOGUE.names)
