"""The live page by itself in real browsers: who may command, what is dragged, what fits."""

import socket

import numpy as np
import pytest

pytest.importorskip('viser')

from live_browser import Browser
from PIL import Image

from tendon_robot_ros.common.colours import ERROR, MEASURED, PREDICTED, rgb
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.ros.shared.files import read_robot
from tendon_robot_ros.ros.viewer.node import _is_local
from tendon_robot_ros.ros.viewer.page import LivePage
from tendon_robot_ros.ros.viewer.state import ViewState

pytestmark = pytest.mark.browser
TENSIONS = [0.6, 0.1, 0.1, 0.3]
STOP_AND_PANEL = """(() => {
  const button = [...document.querySelectorAll('button')].find((b) => b.innerText === 'STOP');
  const panel = document.querySelector('div[style*="max-height: 60%"]');
  const [stop, whole] = [button, panel].map((one) => one.getBoundingClientRect());
  return [stop.top, stop.bottom, whole.left, whole.right]; })()"""


def free_port():
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        return taken.getsockname()[1]


def state():
    """Return what the page shows of an arm that is off by centimetres."""
    shown = ViewState()
    robot = read_robot('kato_10_1')
    shown.inputs, shown.tensions = robot.inputs, tuple(TENSIONS)
    shown.predicted = Model(robot).shape(TENSIONS).positions
    soft = robot.with_effect('backbone_stiffness', {'relative_change': -0.2})
    shown.measured = Model(soft).shape(TENSIONS).positions
    return shown


@pytest.fixture
def opened(tmp_path):
    """Serve a page and open browsers on it."""
    made = []

    def make(token='', widths=(1200,)):
        page = LivePage('127.0.0.1', free_port(), token, 0.208)
        made.append(page)
        shown = state()
        page.draw(shown)
        page.tell(shown, 0.0)
        browsers = []
        for index, width in enumerate(widths):
            (tmp_path / str(index)).mkdir()
            browsers.append(Browser(tmp_path / str(index), width, 850))
            made.insert(0, browsers[-1])
            browsers[-1].open(f'http://127.0.0.1:{page.port}')
            browsers[-1].until(lambda b=browsers[-1]: 'Record' in b.text(), 'the panel', 60.0)
        return page, shown, browsers

    yield make
    for one in made:
        one.close()


def taken(page):
    """Return the commands that came."""
    found = []
    while not page.commands.empty():
        found.append(page.commands.get())
    return found


def is_measured(pixels):
    """Tell which pixels are of the translucent arm, in any light."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return (red > green + 20) & (green > blue + 3)


def places(browser, tmp_path, colour):
    """Return where (n, 2) [px] a colour is on the screen, the panel included."""
    browser.picture(tmp_path / 'shot.png')
    with Image.open(tmp_path / 'shot.png') as image:
        pixels = np.asarray(image.convert('RGB'), dtype=int)
    near = colour(pixels) if callable(colour) else np.abs(pixels - colour).max(axis=2) < 30
    y, x = np.nonzero(near)
    return np.array([x, y]).T


def test_without_the_token_nobody_commands(opened):
    page, _, (browser,) = opened(token='open sesame')
    browser.until(lambda: browser.has_field('token'), 'the field')
    browser.click('1 Record')
    browser.until(lambda: 'need the token' in browser.text(), 'the refusal')
    assert taken(page) == []
    browser.type('token', 'open')
    browser.click('1 Record')
    browser.type('token', 'open sesame')
    browser.until(lambda: not browser.has_field('token'), 'the token to be taken')
    assert taken(page) == []
    browser.click('1 Record')
    browser.until(lambda: not page.commands.empty(), 'the command')
    assert taken(page) == [('record', None)]


@pytest.mark.parametrize(
    ('host', 'local'),
    [('127.0.0.1', True), ('localhost', True), ('::1', True), ('0.0.0.0', False),
     ('192.168.1.7', False), ('robot.example.org', False)],
)  # fmt: skip
def test_a_token_is_needed_beyond_this_machine(host, local):
    assert _is_local(host) == local


def test_a_desktop_and_a_phone_see_both_arms_from_base_to_tip(opened, tmp_path):
    page, shown, browsers = opened(widths=(1200, 400))
    browsers[0].until(lambda: page.clients == 2, 'both browsers')
    for browser, width in zip(browsers, (1200, 400), strict=True):
        assert browser.run('document.documentElement.scrollWidth') <= width
        for colour in (is_measured, rgb(PREDICTED)):
            browser.until(
                lambda b=browser, c=colour: spans(b, tmp_path, c), f'the arm at {width} px'
            )

    def seen_from_base_to_tip():
        page.tell(shown, 0.0)
        return spans(browsers[1], tmp_path, is_measured, 230)

    browsers[1].until(seen_from_base_to_tip, 'the whole arm above the panel of a phone')
    top, bottom, left, right = browsers[1].run(STOP_AND_PANEL)
    assert 0 <= top < bottom <= 60, 'STOP is in sight, at the upper edge'
    assert (left, right) == (0, 400), 'the panel is as wide as the screen'
    assert ERROR not in (MEASURED, PREDICTED)


def test_arms_that_coincide_are_both_seen(opened, tmp_path):
    """The measured one is wider, and what is inside it shines through."""
    page, shown, (browser,) = opened()
    shown.predicted = shown.measured
    page.draw(shown)

    def widths():
        browser.picture(tmp_path / 'shot.png')
        with Image.open(tmp_path / 'shot.png') as image:
            pixels = np.asarray(image.convert('RGB'), dtype=int)
        pixels = pixels[200:, : int(browser.run(PANEL)[0])]  # below the browser's own notice
        blue = pixels[..., 2] > pixels[..., 0] + 10
        inside = blue & (np.cumsum(is_measured(pixels), axis=1) > 0)
        rows = is_measured(pixels).sum(axis=1) > 4
        return rows.sum() > 85 and (inside.sum(axis=1)[rows] > 0).mean() > 0.8

    browser.until(widths, 'the thin arm inside the wide one')


def spans(browser, tmp_path, colour, height=85):
    """Whether an arm is seen over so much of the window's height [px], outside of the panel."""
    left = browser.run(PANEL)
    seen = places(browser, tmp_path, colour)
    seen = seen[(seen[:, 0] < left[0]) | (seen[:, 1] < left[1])]
    return len(seen) > 50 and np.ptp(seen[:, 1]) > height


# left and top [px] of what lies over the scene
PANEL = """(() => { const b = [...document.querySelectorAll('button')]
    .find((b) => b.innerText.includes('Record'));
  let e = b; while (e.parentElement.getBoundingClientRect().width < innerWidth * 0.8
    && e.parentElement.parentElement) e = e.parentElement;
  const r = e.getBoundingClientRect(); return [r.left, r.top]; })()"""


def test_dragging_the_handle_sends_a_target(opened, tmp_path):
    page, shown, (browser,) = opened()
    browser.until(lambda: right_of_tip(browser, tmp_path), 'the handle', 60.0)
    assert taken(page) == []

    def dragged():  # again where a busy machine drew the handle too late for the hand
        arrow = right_of_tip(browser, tmp_path)
        if arrow:
            browser.drag(arrow, (arrow[0] + 60, arrow[1]))
        return not page.commands.empty()

    browser.until(dragged, 'the target', 60.0)
    name, place = taken(page)[-1]
    assert name == 'target'
    moved = place - shown.measured[-1]
    assert moved[0] > 5e-3
    assert moved[1:] == pytest.approx([0.0, 0.0], abs=1e-6)


RED = (255, 32, 96)  # of the arrow along x


def right_of_tip(browser, tmp_path):
    """Return a place [px] on the arrow along x, None while it is not drawn."""
    seen = places(browser, tmp_path, RED)
    seen = seen[seen[:, 0] < 800]
    return None if len(seen) < 10 else tuple(seen[np.argmax(seen[:, 0])].tolist())
