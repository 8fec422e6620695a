"""A progress bar on stderr, where a person watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


@contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """Give a function that shows (what, done, total); silent where stderr is no terminal."""
    with tqdm(disable=None, leave=False, bar_format='{desc} {n_fmt}/{total_fmt} |{bar}|') as bar:

        def show(what: str, done: int, total: int) -> None:
            bar.set_description_str(what, refresh=False)
            bar.total, bar.n = total, done
            bar.refresh()

        yield show
