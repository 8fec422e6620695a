"""Pages: self-contained, drawn at desktop and phone width, escaped; words and numbers in them."""

import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from browser import assert_fine, open_page
from marks import slow
from measurements import blind
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import MissingExtraError
from tendon_robot_ros.common.words import commands, digits, listed, mm, probability, times
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.comparison.result import load_comparison
from tendon_robot_ros.data import Marker, load_dataset
from tendon_robot_ros.report import page as page_module
from tendon_robot_ros.report.comparison import (
    DrawnPosture,
    chosen_postures,
    comparison_page,
    is_planar,
    scene_figure,
    side_figure,
)
from tendon_robot_ros.report.error_plots import Step, staircase
from tendon_robot_ros.report.page import Figure, Page, Shown

SECTIONS = ('Where the models are off', 'Shapes', 'Angular displacement')


def compared(folder, pcca=True):
    data = load_dataset(folder)
    models = [(data.robot.name, data.robot)]
    models += [('PCCA', replace(data.robot, effects={}))] if pcca else []
    return compare(data, models)


@pytest.fixture(scope='module')
def planar():
    return compared(blind('b') / 'fit')


def drawn_postures(comparison):
    return [DrawnPosture(comparison, p, (), {}) for p in chosen_postures(comparison)]


def figures(page):
    """Return what the figures of a page hold."""
    texts = re.findall(r'<script type="application/json">(.*?)</script>', '\n'.join(page.parts))
    return [json.loads(text) for text in texts]


@pytest.mark.browser
@pytest.mark.parametrize(
    ('data', 'widths'),
    [('planar', (1200, 400, 390)), ('spatial', (390, 1200)), slow('tentacle', (400,))],
    ids=['planar', 'spatial', 'tentacle'],
)
def test_the_page_opens_offline_draws_everything_and_fits(data, widths, tmp_path):
    folder = {'planar': blind('b') / 'fit', 'spatial': blind('e') / 'fit'}.get(
        data, ROOT / 'data' / 'tentacle'
    )
    found = compared(folder)
    seen = open_page(comparison_page(found).write(tmp_path / 'page.html'), tmp_path, widths)
    assert_fine(seen, widths)
    for section in (*SECTIONS, 'off by'):
        assert section in seen[widths[-1]]['text']


def test_every_axis_of_every_figure_has_a_unit_or_counts_something(planar):
    counted = ('cell', 'posture', 'model', None)
    for figure in figures(comparison_page(planar)):
        for name in ('xaxis', 'yaxis'):
            title = figure['layout'][name].get('title', {}).get('text')
            assert title in counted or re.search(r'\[(mm|°)\]$', title), title
    spatial = compared(blind('e') / 'fit')
    scene = scene_figure(spatial, drawn_postures(spatial)).layout['scene']
    assert [scene[f'{a}axis']['title']['text'] for a in 'xyz'] == ['x [mm]', 'y [mm]', 'z [mm]']


def test_a_spatial_arm_is_seen_across_the_plane_in_which_it_bends():
    tentacle = compared(ROOT / 'data' / 'tentacle', pcca=False)
    p = tentacle.measured.postures.index('m2_u025')
    postures = drawn_postures(tentacle)
    scene, sides = scene_figure(tentacle, postures), [*map(side_figure, postures)]
    menu = scene.layout['updatemenus'][0]
    drawn = chosen_postures(tentacle)
    assert menu['active'] == drawn.index(p)  # the worst
    camera = menu['buttons'][menu['active']]['args'][1]['scene.camera']
    assert camera == scene.layout['scene']['camera']
    view = np.array([camera['eye'][axis] for axis in 'xy'])
    error = tentacle.models[0].markers[p, -1] - tentacle.measured.mean[p, -1]
    assert abs(error[:2] @ view) < 0.3 * np.linalg.norm(error) * np.linalg.norm(view)
    assert len(sides) == len(drawn)
    across, along = (t for t in sides[drawn.index(p)].data if t['name'] == 'measured')
    assert (across['xaxis'], along['xaxis']) == ('x', 'x2')
    seen = np.column_stack([across['x'], along['x'], across['y']])
    measured = 1e3 * tentacle.measured.mean[p]
    np.testing.assert_allclose(
        np.linalg.norm(seen, axis=1), np.linalg.norm(measured, axis=1), atol=1e-3
    )
    assert np.abs(along['x']).max() < 0.3 * np.max(across['x'])


def test_the_figures_show_the_numbers_of_the_comparison(planar):
    page = comparison_page(planar)
    drawn = figures(page)
    along = next(f for f in drawn if f['layout']['xaxis']['title']['text'] == 'cell')
    model = next(trace for trace in along['data'] if trace['name'] == 'planar1')
    np.testing.assert_allclose(model['y'], 1e3 * planar.models[0].per_marker_rms, atol=1e-4)
    band = along['data'][0]
    np.testing.assert_allclose(band['y'], 1e3 * planar.measured.floor_per_marker, atol=1e-4)
    boxes = next(f for f in drawn if f['data'][0].get('type') == 'box')
    np.testing.assert_allclose(
        sorted(boxes['data'][1]['y']), sorted(1e3 * planar.models[1].tip_errors.ravel()), atol=1e-4
    )
    shapes = [f for f in drawn if f['layout']['yaxis'].get('scaleanchor')]
    assert len(shapes) == 12
    np.testing.assert_allclose(
        shapes[0]['data'][-1]['y'], 1e3 * planar.measured.mean[0, :, 2], atol=1e-4
    )


def test_the_sentences_are_those_of_the_result(planar):
    text = '\n'.join(comparison_page(planar).parts)
    assert 'The best model, planar1, is off by eleven times your repeatability.' in text
    assert (
        'posture 10 (left 2.34 N, right 2.13 N), rms 4.64 mm; the error grows from cell 3 on.'
        in text
    )
    assert '4.4 ± 1.4 mm' in text
    assert 'Tip error: planar1 23.7 mm less than PCCA (95 %: 15.2 to 32.2 mm, paired t' in text
    assert f'<code>python -m tendon_robot_ros diagnose {planar.measured.data}</code>' in text


def test_a_loaded_comparison_gives_the_same_page(tmp_path):
    folder, out = blind('b') / 'fit', tmp_path / 'c.json'
    assert (
        main(['compare', str(folder), '--json', str(out), '--report', str(tmp_path / 'p.html')])
        == 0
    )
    again = comparison_page(load_comparison(out)).html()
    assert again == (tmp_path / 'p.html').read_text(encoding='utf-8')


def test_few_postures_have_boxes_of_their_own():
    found = compared(blind('b') / 'fit')
    few = compare(
        load_dataset(blind('b') / 'fit').select(['0', '3', '7']),
        [(m.name, load_dataset(blind('b') / 'fit').robot) for m in found.models],
    )
    boxes = next(f for f in figures(comparison_page(few)) if f['data'][0].get('type') == 'box')
    assert boxes['layout']['boxmode'] == 'group'
    assert sorted(set(boxes['data'][0]['x'])) == ['0', '3', '7']


def test_many_postures_show_the_worst():
    found = compared(ROOT / 'data' / 'tentacle', pcca=False)
    chosen = chosen_postures(found)
    assert len(chosen) == Shown.POSTURES == 12
    left = np.setdiff1d(np.arange(16), chosen)
    errors = found.best.per_posture_rms
    assert errors[left].max() <= errors[chosen].min()
    assert not is_planar(found)


def test_nothing_measured_stays_out_of_the_figures(planar):
    data = load_dataset(blind('b') / 'fit')
    positions = np.array(data.positions)
    positions[2, :, 5:] = np.nan
    found = compare(
        replace(
            data,
            positions=positions,
            markers=(*data.markers[:-1], Marker('<b>tip</b>', data.arc_lengths[-1])),
        )
    )
    html = comparison_page(found).html()
    assert 'NaN' not in html.split('</script></head>')[1]
    assert '<b>tip' not in html


def test_names_cannot_break_out_of_the_page(planar):
    evil = '</script><script>alert(1)</script>'
    found = replace(planar, models=(replace(planar.models[0], name=evil),))
    assert evil not in comparison_page(found).html()


def test_the_staircase_stands_in_groups():
    steps = [Step('before', 2e-3, '#111111', g) for g in ('fitted', 'check')]
    steps += [Step('after', 3e-4, '#222222', g) for g in ('fitted', 'check')]
    figure = staircase(steps)
    assert [trace['x'] for trace in figure.data] == [['fitted', 'check']] * 2
    assert [trace['text'] for trace in figure.data] == [['2.00'] * 2, ['0.300'] * 2]


def test_without_plotly_the_remedy_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__('sys').modules, 'plotly.offline', None)
    page_module.plotly_source.cache_clear()
    with pytest.raises(MissingExtraError, match=r'tendon_robot_ros\[report\]'):
        Page('x').write(tmp_path / 'x.html')
    assert not list(tmp_path.iterdir())


def test_a_page_holds_tables_boxes_and_figures():
    page = Page('a < b', 'sub')
    page.heading('one')
    page.box(['say `x < y`'], 'warn', 'look')
    page.table([['name', 'rms'], ['a', '1']], ['strong'])
    page.figures([Figure([{'x': [1], 'y': ['</script>']}], {})], 'two')
    html = page.html()
    for part in ('<h1>a &lt; b</h1>', '<code>x &lt; y</code>', 'class="strong"', 'box warn'):
        assert part in html
    assert '"\\u003c/script>"' in html


def test_tables_and_figures_tell_who_does_not_see_them_what_they_are():
    page = Page('x')
    page.table([['model', 'rms'], ['FKM', '1 mm']])
    page.figures([Figure([], {'xaxis': {'title': {'text': 'cell'}}}, caption='Per cell.')])
    root = ElementTree.fromstring(f'<div>{"".join(page.parts)}</div>')
    table = root.find('.//table')
    assert [cell.get('scope') for cell in table.iter('th')] == ['col', 'col']
    assert {e.tag: e.get('role') for e in table.iter()} == {
        'table': 'table', 'tr': 'row', 'th': 'columnheader', 'td': 'cell'
    }  # fmt: skip
    assert [cell.get('data-name') for cell in table.iter('td')] == ['model', 'rms']
    scrolled = root.find("./div[@class='scroll']")
    assert (scrolled.get('tabindex'), scrolled.get('aria-label')) == ('0', 'table of model')
    assert root.find(".//div[@role='img']").get('aria-label') == 'cell Per cell.'


def test_a_page_is_read_in_order_and_everything_in_it_has_a_name(planar):
    html = comparison_page(planar).html()
    body = html.partition('<body>')[2]
    levels = [int(level) for level in re.findall(r'<h([1-6])', body)]
    assert levels[0] == 1 and set(levels[1:]) == {2}, 'no level is left out'
    assert '<html lang="en">' in html and body.startswith('<main>')
    labels = re.findall(r'role="(?:img|region)" aria-label="([^"]*)"', body)
    assert len(labels) == len(figures(comparison_page(planar))) + 1 and all(labels)
    assert set(re.findall(r'tabindex="(-?\d+)"', body)) == {'0'}, 'in the order of the page'
    assert ':focus-visible { outline: 3px' in html


@pytest.mark.parametrize(
    ('shown', 'expected'),
    [
        (digits(0.24567, 3), '0.246'),
        (digits(1234.0, 2), '1200'),
        (digits(0.0), '0'),
        (digits(1.5e-7), '1.5e-07'),
        (mm(0.0123456), '12.3 mm'),
        (mm(None), '–'),
        (mm(float('nan')), '–'),
        (times(5.9), 'six times'),
        (times(2.44), '2.4 times'),
        (times(297.0), '300 times'),
        (probability(3.2e-6), 'p = 3e-6'),
        (probability(0.034), 'p = 0.034'),
        (probability(0.0), 'p < 1e-300'),
        (commands({'left': 1.1, 'right': 0.0, 'up': None}), 'left 1.10 N'),
        (commands({'left': 0.002}, 'displacement'), 'left 2.00 mm'),
        (commands({}), 'nothing pulled'),
        (listed(['a', 'b', 'c'], 'or'), 'a, b or c'),
        (listed([]), 'nothing'),
    ],
)
def test_numbers_read_well(shown, expected):
    assert shown == expected
