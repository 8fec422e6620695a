"""
The pictures of `make live` in README and docs: clicked in headless Chromium, as a newcomer would.

    python tools/live_strip.py             # docs/images/live.png
    python tools/live_strip.py --keep DIR  # every step, too

Needs chromium and the extra `viewer`.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from live_browser import Browser

ROOT = Path(__file__).resolve().parents[1]
PORT = 8097
LOOK = 15.0  # [s] for the curve to show what was done
SIZE = 1200, 800  # [px]
SHOWN = ('1_look', '3_diagnose', '4_added')  # side by side in the strip


def start(hidden: str, folder: Path) -> subprocess.Popen[str]:
    """Start the page in a scratch folder; return when it says where it is."""
    command = [sys.executable, '-u', '-m', 'tendon_robot_ros', 'live', '--hidden', hidden]
    live = subprocess.Popen(
        [*command, '--seed', '4', '--postures', '14', '--port', str(PORT)],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert live.stdout is not None
    for line in live.stdout:
        if 'open http' in line:
            return live
    raise SystemExit('live ended before its page was open')


def click_through(browser: Browser, shoot: Callable[[str], None], postures: int) -> None:
    """Record, diagnose, add, as the page says."""
    browser.open(f'http://127.0.0.1:{PORT}')
    browser.until(browser.tip_error, 'the error', 120.0)
    time.sleep(LOOK)
    shoot('1_look')
    browser.click('1 Record')
    browser.until(lambda: f'Recording ({postures})' in browser.text(), 'postures', 300.0)
    shoot('2_record')
    browser.click('2 Diagnose')
    shown = "document.getElementById('verdict')?.innerText"
    browser.until(lambda: browser.run(shown), 'the verdict', 300.0)
    time.sleep(2.0)
    shoot('3_diagnose')
    before = browser.tip_error() or 0.0
    browser.click('3 Add')
    browser.until(lambda: 'The model now has' in browser.text(), 'the adding', 120.0)
    browser.until(lambda: (browser.tip_error() or 99.0) < 0.3 * before, 'the fall', 120.0)
    time.sleep(LOOK)
    shoot('4_added')


def main() -> int:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--hidden', default='hinge_friction')
    parser.add_argument('--postures', type=int, default=8)
    parser.add_argument('--keep', type=Path, help='folder for every step')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        shots = args.keep or folder
        shots.mkdir(parents=True, exist_ok=True)
        live = start(args.hidden, folder)
        browser = Browser(folder, *SIZE)
        try:
            click_through(
                browser, lambda name: browser.picture(shots / f'{name}.png'), args.postures
            )
        finally:
            browser.picture(shots / 'last.png')
            browser.close()
            live.send_signal(signal.SIGINT)
            live.wait(60.0)
        strip([shots / f'{name}.png' for name in SHOWN], ROOT / 'docs/images/live.png')
    return 0


def strip(paths: list[Path], target: Path) -> None:
    """Put pictures side by side."""
    images = [Image.open(path).convert('RGB') for path in paths]
    images = [image.resize((800, 800 * image.height // image.width)) for image in images]
    made = Image.new('RGB', (800 * len(images), images[0].height), 'white')
    for i, image in enumerate(images):
        made.paste(image, (800 * i, 0))
    made.quantize(96).save(target, optimize=True)


if __name__ == '__main__':
    sys.exit(main())
