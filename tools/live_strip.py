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
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from live_browser import Browser

ROOT = Path(__file__).resolve().parents[1]
PORT = 8097
SIZE = 1200, 760  # [px]
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
            browser.find_the_effect(f'http://127.0.0.1:{PORT}', shots, args.postures)
        finally:
            browser.close()
            live.send_signal(signal.SIGINT)
            live.wait(60.0)
        strip([shots / f'{name}.png' for name in SHOWN], ROOT / 'docs/images/live.png')
    return 0


def strip(paths: list[Path], target: Path) -> None:
    """Put pictures side by side."""
    images = [Image.open(path).convert('RGB').crop((0, 0, *SIZE)) for path in paths]
    images = [image.resize((800, 800 * image.height // image.width)) for image in images]
    made = Image.new('RGB', (800 * len(images), images[0].height), 'white')
    for i, image in enumerate(images):
        made.paste(image, (800 * i, 0))
    made.quantize(96).save(target, optimize=True)


if __name__ == '__main__':
    sys.exit(main())
