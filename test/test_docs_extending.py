"""docs/extending.md shows the example as it is, docs/effect_stages.md every stage of a law."""

from source_tree import ROOT

from tendon_robot_ros.effects import STAGES

PAGE, STAGES_PAGE = (
    (ROOT / 'docs' / name).read_text(encoding='utf-8')
    for name in ('extending.md', 'effect_stages.md')
)


def test_the_effect_shown_is_the_example():
    example = (ROOT / 'examples' / 'soft_pulley.py').read_text(encoding='utf-8')
    shown = PAGE.split('```py\n')[1].split('```')[0]
    assert shown in example


def listed(quantities):
    return '; '.join(f'{q.name} [{q.unit}]: {q.meaning}' for q in quantities) or 'nothing'


def test_the_table_has_every_stage():
    rows = [f'| `{s.name}` | {listed(s.context)} | {listed(s.outputs)} |' for s in STAGES.values()]
    assert '\n'.join(rows) in STAGES_PAGE
