"""
Chunks of independent work, behind `concurrent.futures`: here, in processes, on a cluster.

A chunk should take a second or more, because handing one out takes a millisecond here and some
milliseconds through a scheduler. Results come in the order in which they are ready. For results
that do not depend on the number of workers, give every chunk its own seed
(`numpy.random.SeedSequence`).
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from .errors import ClusterLostError, InputError, of_extra
from .processes import UPKEEP_S, end_with_parent, one_thread

# [1] workers that may die over a chunk, else one that kills its worker would be tried for ever
LOSSES_MAX = 8

_LOG = logging.getLogger(__name__)
Work = Callable[[Any], Any]
Prepare = Callable[[], None]


@dataclass(frozen=True)
class LostWork:
    """Result of a chunk over which every worker died."""

    workers: int


class Workers(contextlib.AbstractContextManager['Workers']):
    """
    Processes of this machine, or of a cluster, that chunks of work are spread over.

    Parameters
    ----------
    count : int
        Processes; 1: the work is done in this one.
    cluster : str
        Address of a dask scheduler instead, `tcp://host:8786` or `tls://host:8786`.
    prepare : callable
        Called once in every process before its first chunk; can be pickled and hashed.

    Raises
    ------
    InputError, MissingExtraError
        No such number, no scheduler at this address, or dask is not installed.

    """

    def __init__(self, count: int = 1, cluster: str = '', prepare: Prepare | None = None) -> None:
        if count < 1:
            raise InputError(f'--workers: expected at least 1, got {count}')
        self.prepare = prepare
        self.engine: _Processes | _Cluster | None = None
        if cluster:
            self.engine = _Cluster(cluster)
        elif count > 1:
            self.engine = _Processes(count, prepare)

    @property
    def slots(self) -> int:
        """Chunks that are at work or wait for it at a time."""
        return 1 if self.engine is None else self.engine.slots

    def __exit__(self, *_: object) -> None:
        if self.engine is not None:
            self.engine.close()

    def run(
        self, work: Work, chunks: Iterable[Any], until: float = float('inf')
    ) -> Iterator[tuple[int, Any]]:
        """
        Yield (which chunk, its result) as results get ready.

        Parameters
        ----------
        work : callable
            Of a module, so that it can be pickled.
        chunks : iterable
            Taken as workers get free, so that they may be many.
        until : float [s]
            `time.monotonic()` at which to stop; what is not ready then is dropped.

        Raises
        ------
        ClusterLostError
            The scheduler is gone.
        Exception
            What the work raised.

        """
        if self.engine is None:
            for index, chunk in enumerate(chunks):
                yield index, _call((self.prepare, work, chunk))
                if time.monotonic() > until:
                    return
        else:
            yield from self._spread(self.engine, work, chunks, until)

    def in_chunks[T](self, work: Work, items: Sequence[T]) -> Iterator[tuple[tuple[T, ...], Any]]:
        """
        Yield (items, result) of chunks as they get ready: some seconds of work, less at the end.

        Parameters
        ----------
        work : callable
            As for `run`; takes the items of a chunk.
        items : sequence

        """
        handed: list[tuple[T, ...]] = []
        per_item = 0.0  # [s] average over the last five chunks or so; 0: not yet known

        def chunks() -> Iterator[tuple[Work, Any]]:
            begin = 0
            while begin < len(items):
                # a quarter of a slot's share, so that no worker waits for long at the end
                fair = max((len(items) - begin) // (4 * self.slots), 1)
                desired = max(int(UPKEEP_S / per_item), 1) if per_item else 1
                handed.append(tuple(items[begin : begin + min(desired, fair)]))
                begin += len(handed[-1])
                yield work, handed[-1]

        for index, result in self.run(_timed, chunks()):
            if not isinstance(result, LostWork):
                result, seconds = result
                own = seconds / len(handed[index])
                per_item = 0.8 * per_item + 0.2 * own if per_item else own
            yield handed[index], result

    def _spread(
        self, engine: _Processes | _Cluster, work: Work, chunks: Iterable[Any], until: float
    ) -> Iterator[tuple[int, Any]]:
        coming = enumerate(chunks)
        waiting: dict[Future[Any], tuple[int, Any]] = {}
        retries: deque[tuple[int, Any]] = deque()
        losses: dict[int, int] = {}

        def hand_out() -> None:
            while len(waiting) < engine.slots:
                item = retries.popleft() if retries else next(coming, None)
                if item is None:
                    return
                waiting[engine.submit(_call, (self.prepare, work, item[1]))] = item

        hand_out()
        while waiting and (remaining := until - time.monotonic()) > 0.0:
            done, _ = wait(waiting, min(remaining, UPKEEP_S), FIRST_COMPLETED)
            for future in done:
                index, chunk = waiting.pop(future)
                try:
                    result = future.result()
                except (Exception, CancelledError) as error:
                    if not engine.is_loss(error):
                        raise
                    losses[index] = losses.get(index, 0) + 1
                    if losses[index] < LOSSES_MAX:
                        retries.append((index, chunk))
                        continue
                    result = LostWork(losses[index])
                try:
                    hand_out()  # the worker goes on while its result is taken
                finally:  # a cluster that is gone keeps no result back
                    yield index, result
            hand_out()


def _call(task: tuple[Prepare | None, Work, Any]) -> Any:
    """Compute a chunk in a worker."""
    prepare, work, chunk = task
    _prepared(prepare)
    with one_thread():
        return work(chunk)


def _timed(task: tuple[Work, Any]) -> tuple[Any, float]:
    """Return the result of some work, and the time [s] that it took."""
    start = time.monotonic()
    return task[0](task[1]), time.monotonic() - start


@lru_cache(maxsize=8)
def _prepared(prepare: Prepare | None) -> None:
    if prepare is not None:
        prepare()


class _Processes:
    def __init__(self, count: int, prepare: Prepare | None) -> None:
        self.slots = count  # chunks that it should have at a time
        self.processes = [_Process(prepare) for _ in range(count)]

    def submit(self, work: Work, chunk: Any) -> Future[Any]:
        # all are at work where what was dropped, because time was over, is not ready
        wait([one.task for one in self.processes], return_when=FIRST_COMPLETED)
        return next(one for one in self.processes if one.task.done()).submit(work, chunk)

    def is_loss(self, error: BaseException) -> bool:
        """Return whether an error means that a worker died."""
        return isinstance(error, BrokenProcessPool)

    def close(self) -> None:
        for process in self.processes:
            process.end()


class _Process:
    """A process with at most one chunk, started anew when it has died."""

    def __init__(self, prepare: Prepare | None) -> None:
        self.prepare = prepare
        self.task: Future[Any] = Future()  # the last one
        self.task.set_result(None)
        self.start()

    def start(self) -> None:
        self.pool = ProcessPoolExecutor(
            1,
            mp_context=multiprocessing.get_context('spawn'),
            initializer=_begin,
            initargs=(os.getpid(), self.prepare),
        )
        self.identity = self.pool.submit(os.getpid)

    def submit(self, work: Work, chunk: Any) -> Future[Any]:
        try:
            self.task = self.pool.submit(work, chunk)
        except BrokenProcessPool:  # it has died
            self.start()
            self.task = self.pool.submit(work, chunk)
        return self.task

    def end(self) -> None:
        """Kill the process; its unfinished result is dropped."""
        if self.identity.cancel():
            self.pool.shutdown()
            return
        with contextlib.suppress(BrokenProcessPool, ProcessLookupError):
            os.kill(self.identity.result(), signal.SIGKILL)
        self.pool.shutdown(cancel_futures=True)


def _begin(parent: int, prepare: Prepare | None) -> None:
    """
    Leave Ctrl-C to the parent, and end with it.

    What the first chunk needs is imported while the parent opens its table.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent, signal.SIGKILL)
    with contextlib.suppress(Exception):  # raised again with the first chunk
        _prepared(prepare)


def _check_certificates(address: str) -> None:
    """Refuse TLS without certificates, and what dask's settings want encrypted without TLS."""
    from distributed.security import Security

    if not address.startswith('tls://'):
        if Security().require_encryption:
            raise InputError(
                f'--cluster {address}: expected tls://, as distributed.comm.require-encryption of '
                "dask's settings asks for; start the scheduler with `--protocol tls`"
            )
        return
    where = 'distributed.comm.tls in ~/.config/dask/distributed.yaml: ca-file, client.cert and key'
    try:
        if Security().get_connection_args('client').get('ssl_context') is not None:
            return
        problem = 'names no certificates'
    except OSError as error:
        problem = f'names certificates that cannot be read ({error})'
    raise InputError(f'--cluster {address}: {where}; dask {problem} there')


class _Cluster:
    def __init__(self, address: str) -> None:
        distributed = of_extra('cluster', 'distributed')
        self.address, self.checked_at = address, 0.0
        for part in ('client', 'utils'):  # their tracebacks are replaced by one line
            logging.getLogger(f'distributed.{part}').setLevel(logging.CRITICAL)
        self.killed: type[BaseException] = distributed.KilledWorker
        _check_certificates(address)
        try:  # certificates, and all else, are those of dask's own settings
            self.client = distributed.Client(address, timeout=2.0 * UPKEEP_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f'--cluster {address}: no scheduler answers ({error or type(error).__name__}); '
                'start one with `dask scheduler`, then `dask worker`'
            ) from None
        self.executor = self.client.get_executor(pure=False)
        self.threads = 1

    @property
    def slots(self) -> int:
        """Chunks for the current workers, whose number may change."""
        if time.monotonic() > self.checked_at + UPKEEP_S:
            self.checked_at = time.monotonic()
            with contextlib.suppress(OSError, RuntimeError):
                threads = sum(self.client.nthreads().values())
                if not threads and self.threads:
                    _LOG.warning('%s has no workers; waiting for some to come', self.address)
                self.threads = threads
        return 2 * max(self.threads, 1)  # one waits while one is at work

    def submit(self, work: Work, chunk: Any) -> Future[Any]:
        try:
            future: Future[Any] = self.executor.submit(work, chunk)
            return future
        except (OSError, RuntimeError) as error:
            raise self._lost_error(error) from None

    def is_loss(self, error: BaseException) -> bool:
        if isinstance(error, self.killed):
            return True
        if isinstance(error, ModuleNotFoundError) or 'deserialization' in str(error):
            raise InputError(
                f'--cluster {self.address}: its scheduler and workers do not have this package, '
                'or another version of it; install the same on all machines'
            ) from None
        if isinstance(error, (CancelledError, OSError)) or self.client.status != 'running':
            raise self._lost_error(error) from None
        return False

    def _lost_error(self, error: BaseException) -> ClusterLostError:
        return ClusterLostError(
            f'--cluster {self.address}: the scheduler is gone '
            f'({str(error) or type(error).__name__}); what was finished is kept: start it again, '
            'then the same command'
        )

    def close(self) -> None:
        with contextlib.suppress(Exception):  # the scheduler may be gone already
            self.client.close(timeout=2.0)
