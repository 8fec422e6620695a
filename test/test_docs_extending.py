"""docs/extending.md shows the example as it is."""

from source_tree import ROOT


def test_the_effect_shown_is_the_example():
    page = (ROOT / 'docs' / 'extending.md').read_text(encoding='utf-8')
    example = (ROOT / 'examples' / 'soft_pulley.py').read_text(encoding='utf-8')
    assert page.split('```py\n')[1].split('```')[0] in example
