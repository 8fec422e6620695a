"""How far long work is, on stderr: a bar where a person watches, else a line now and then."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from ..common.errors import Progress

PIPED_EVERY_S = 5.0  # [s] between lines at first; work that takes less stays silent
PIPED_EVERY_SHARE = 0.1  # [1] of the time so far, between later lines: a log stays short
DRAWN_EVERY_S = 1.0  # [s] between bars: the seconds in them pass


@contextmanager
def progress(remaining: bool = False) -> Iterator[Progress]:
    """
    Give a function that shows (what, done, total) on stderr: a bar, or lines in a pipe.

    A step that takes long says nothing itself: a thread tells how long it has taken so far.
    `remaining` shows the time left as well: where all of the work is counted as one.
    """
    form = '{desc} {n_fmt}/{total_fmt} |{bar}| {elapsed}' + (
        ', {remaining} left' if remaining else ''
    )
    start, ended = time.monotonic(), threading.Event()
    now = ('working', 0, 0)  # what was told last

    def show(what: str, done: int, total: int) -> None:
        nonlocal now
        now = (what, done, total)

    with tqdm(disable=None, leave=False, bar_format=form) as bar:

        def line() -> str:
            what, done, total = now
            took = time.monotonic() - start
            left = took / max(done, 1) * (total - done)
            end = f', {left / 60.0:.1f} min left' if remaining and done else ''
            count = f' {done:,}/{total:,}' if total else ''
            return f'{what}{count}, {took:.0f} s so far{end}'

        def tell() -> None:
            pause = PIPED_EVERY_S if bar.disable else DRAWN_EVERY_S
            while not ended.wait(pause):
                if bar.disable:
                    print(line(), file=sys.stderr, flush=True)
                    pause = max(PIPED_EVERY_S, PIPED_EVERY_SHARE * (time.monotonic() - start))
                else:
                    what, bar.n, bar.total = now
                    bar.set_description_str(what)

        teller = threading.Thread(target=tell, name='progress', daemon=True)
        teller.start()
        try:
            yield show
        finally:
            ended.set()
            teller.join()
