"""The pages of effects say what the catalogue says, and show a picture of every effect."""

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
SMALL = 40_000  # [bytes] of a picture


def test_every_effect_has_a_section_in_catalogue_order():
    assert tuple(re.findall(r'^## (\w+)$', TEXT, re.M)) == CATALOGUE.names == tuple(SIZES)


@pytest.mark.parametrize('name', [CATALOGUE.names[0], 'contact', CATALOGUE.names[-1]])
def test_the_section_of_a_new_effect_is_begun_at_its_place(name):
    before, after = TEXT.split(f'## {name}\n')
    _, *behind = after.split('\n## ')
    begun = effects_page.with_all(before + ''.join(f'## {one}' for one in behind))
    order = tuple(re.findall(r'^## (\w+)$', begun, re.M))
    assert order == CATALOGUE.names and effects_page.with_all(begun) == begun


@pytest.mark.parametrize('name', CATALOGUE.names)
def test_a_section_says_what_happens_and_how_to_tell_it_apart(name):
    section = TEXT.split(f'\n## {name}\n')[1].split('\n## ')[0]
    assert re.search(r'\[\d+\]', section), 'the number of its equation'
    assert 'Tell apart: ' in ' '.join(section.split())
    assert len(section) < 800, 'short'


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


def test_the_effect_that_extending_shows_is_the_example():
    page = (ROOT / 'docs' / 'extending.md').read_text(encoding='utf-8')
    example = (ROOT / 'examples' / 'soft_pulley.py').read_text(encoding='utf-8')
    assert page.split('```py\n')[1].split('```')[0] in example
