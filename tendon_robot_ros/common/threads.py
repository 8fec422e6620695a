"""Linear algebra in one thread: matrices are small here, and threads cost more than they bring."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


@contextmanager
def one_thread() -> Iterator[None]:
    """
    Keep the linear algebra of numpy and scipy to one thread, also where they came first.

    Who imports numpy before this package has as many threads as cores, and a diagnosis takes
    ten times as long. Works as a decorator as well.
    """
    with threadpool_limits(limits=1, user_api='blas'):
        yield
