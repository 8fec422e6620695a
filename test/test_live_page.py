"""The live page by itself in real browsers: who may command, what is dragged, what fits."""

import contextlib

import numpy as np
import processes
import pytest

pytest.importorskip('viser')

from live_browser import Browser
from PIL import Image
from test_framing import FOV, seen

from tendon_robot_ros.common.colours import ERROR, MEASURED, PREDICTED, rgb
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.viewer.node import is_local
from tendon_robot_ros.ros.viewer.page import MEASURED_WIDTH, LivePage, framed
from tendon_robot_ros.ros.viewer.state import ViewState

pytestmark = pytest.mark.browser
TOKEN = 'open sesame'
TENSIONS = [0.6, 0.1, 0.1, 0.3]
STOP_AND_PANEL = """(() => {
  const button = [...document.querySelectorAll('button')].find((b) => b.innerText === 'STOP');
  const panel = document.querySelector('div[style*="max-height: 60%"]');
  const [stop, whole] = [button, panel].map((one) => one.getBoundingClientRect());
  return [stop.top, stop.bottom, whole.left, whole.right]; })()"""


def state():
    """Return what the page shows of an arm that is off by centimetres."""
    shown = ViewState()
    robot = load_robot('kato_10_1')
    shown.inputs, shown.tensions = robot.inputs, tuple(TENSIONS)
    shown.predicted = Model(robot).shape(TENSIONS).positions
    soft = robot.with_effect('backbone_stiffness', {'relative_change': -0.2})
    shown.measured = Model(soft).shape(TENSIONS).positions
    return shown


class Opened:
    """A page that is served, and browsers on it."""

    def __init__(self, folder):
        self.folder, self.browsers = folder, []
        self.page = LivePage('127.0.0.1', processes.free_port(), TOKEN, 0.208)
        self.show(state())

    def show(self, shown):
        self.shown = shown
        self.page.draw(shown)
        self.page.update(shown, 0.0)

    def browser(self, width):
        """Open one more."""
        folder = self.folder / str(len(self.browsers))
        folder.mkdir()
        browser = Browser(folder, width, 850)
        self.browsers.append(browser)
        browser.open(f'http://127.0.0.1:{self.page.port}')
        browser.until(lambda: 'Record' in browser.text(), 'the panel', 60.0)
        return browser

    def close(self):
        for one in (*self.browsers, self.page):
            one.close()


@pytest.fixture(scope='module')
def opened(tmp_path_factory):
    """Serve a page, and open a browser on it; both take seconds of a processor, so once."""
    with contextlib.closing(Opened(tmp_path_factory.mktemp('browsers'))) as opened:
        started = len(processes.started)
        opened.browser(1200)
        del processes.started[started:]  # it ends with these tests, not with the first of them
        yield opened


@pytest.fixture
def trusted(opened):
    """Give page and browser as at the beginning, with the token."""
    (browser,) = opened.browsers
    opened.show(state())
    if browser.has_field('token'):
        browser.type('token', TOKEN)
        browser.until(lambda: not browser.has_field('token'), 'the token to be taken')
    taken(opened.page)
    return opened, browser


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


def screen(browser, tmp_path):
    """Return what is seen, (height, width, 3), the panel included."""
    browser.picture(tmp_path / 'shot.png')
    with Image.open(tmp_path / 'shot.png') as image:
        return np.asarray(image.convert('RGB'), dtype=int)


def places(browser, tmp_path, colour):
    """Return where (n, 2) [px] a colour is on the screen."""
    pixels = screen(browser, tmp_path)
    near = colour(pixels) if callable(colour) else np.abs(pixels - colour).max(axis=2) < 30
    y, x = np.nonzero(near)
    return np.array([x, y]).T


def test_without_the_token_nobody_commands(opened):
    page, (browser,) = opened.page, opened.browsers
    browser.until(lambda: browser.has_field('token'), 'the field')
    browser.click('1 Record')
    browser.until(lambda: 'need the token' in browser.text(), 'the refusal')
    assert taken(page) == []
    browser.type('token', 'open')
    browser.click('1 Record')
    browser.type('token', TOKEN)
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
    assert is_local(host) == local


def test_a_desktop_and_a_phone_see_both_arms_from_base_to_tip(trusted, tmp_path):
    opened, desktop = trusted
    page, shown = opened.page, opened.shown
    browsers = (desktop, opened.browser(400))
    desktop.until(lambda: page.clients == 2, 'both browsers')
    for browser, width in zip(browsers, (1200, 400), strict=True):
        assert browser.run('document.documentElement.scrollWidth') <= width
        for colour in (is_measured, rgb(PREDICTED)):
            browser.until(
                lambda b=browser, c=colour: spans(b, tmp_path, c), f'the arm at {width} px'
            )

    arm = np.vstack([np.zeros(3), shown.measured])
    whole = np.ptp(seen(framed(0.208, FOV, 400 / 900), arm, 400, 900)[:, 1])  # [px]

    def seen_from_base_to_tip():
        page.update(shown, 0.0)
        return spans(browsers[1], tmp_path, is_measured, 0.9 * whole)

    browsers[1].until(seen_from_base_to_tip, 'the whole arm above the panel of a phone')
    top, bottom, left, right = browsers[1].run(STOP_AND_PANEL)
    assert 0 <= top < bottom <= 60, 'STOP is in sight, at the upper edge'
    assert (left, right) == (0, 400), 'the panel is as wide as the screen'
    assert ERROR not in (MEASURED, PREDICTED)
    opened.browsers.pop().close()


def test_arms_that_coincide_are_both_seen(trusted, tmp_path):
    """The measured one is wider, and what is inside it shines through."""
    opened, browser = trusted
    opened.shown.predicted = opened.shown.measured
    opened.page.draw(opened.shown)

    def widths():
        pixels = screen(browser, tmp_path)
        pixels = pixels[200:, : int(browser.run(PANEL)[0])]  # below the browser's own notice
        blue = pixels[..., 2] > pixels[..., 0] + 10
        inside = blue & (np.cumsum(is_measured(pixels), axis=1) > 0)
        rows = is_measured(pixels).sum(axis=1) > 4
        return rows.sum() > 85 and (inside.sum(axis=1)[rows] > 0).mean() > 0.8

    browser.until(widths, 'the thin arm inside the wide one')


def test_the_camera_follows_the_length_of_the_arm(trusted, tmp_path):
    """Of an arm that is much longer than the one before all is seen, too, and not from afar."""
    opened, browser = trusted
    page, long = opened.page, load_robot('spatial_6').length
    opened.shown.predicted = 3.0 * Model(load_robot('spatial_6')).shape([0.0] * 6).positions
    opened.shown.measured = np.zeros((0, 3))
    try:
        page.resize(3.0 * long)
        page.draw(opened.shown)
        tip = np.array([[0.0, 0.0, 3.0 * long]])

        def whole():
            page.update(opened.shown, 0.0)  # again and again, as the node does
            width, height = browser.run(SCENE)
            view = framed((1.0 + 0.5 * MEASURED_WIDTH) * 3.0 * long, FOV, width / height)
            blue = places(browser, tmp_path, rgb(PREDICTED))
            top = blue[blue[:, 0] < width, 1].min(initial=9999)
            # [px], half the width of the line
            return abs(top - seen(view, tip, width, height)[0, 1]) < 6.0

        browser.until(whole, 'the whole arm as large as its ball fits')
    finally:
        page.resize(0.208)


def spans(browser, tmp_path, colour, height=85):
    """Whether an arm is seen over so much of the window's height [px], outside of the panel."""
    left = browser.run(PANEL)
    seen = places(browser, tmp_path, colour)
    seen = seen[(seen[:, 0] < left[0]) | (seen[:, 1] < left[1])]
    return len(seen) > 50 and np.ptp(seen[:, 1]) > height


# width and height [px] of the scene
SCENE = """(() => { const r = document.querySelector('canvas').getBoundingClientRect();
  return [r.width, r.height]; })()"""
# left and top [px] of what lies over the scene
PANEL = """(() => { const b = [...document.querySelectorAll('button')]
    .find((b) => b.innerText.includes('Record'));
  let e = b; while (e.parentElement.getBoundingClientRect().width < innerWidth * 0.8
    && e.parentElement.parentElement) e = e.parentElement;
  const r = e.getBoundingClientRect(); return [r.left, r.top]; })()"""


def test_dragging_the_handle_sends_a_target(trusted, tmp_path):
    opened, browser = trusted
    page, shown = opened.page, opened.shown
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
