"""Campaigns on a cluster: a scheduler and workers of dask as they are, each a process."""

import contextlib
import json
import os
import shutil
import signal
import sys

import processes
import pytest
from napping import nap
from small_campaign import plan, without_time
from source_tree import ROOT

from tendon_robot_ros.common.errors import ClusterLostError, InputError
from tendon_robot_ros.common.workers import Workers
from tendon_robot_ros.model.versions import Preparation
from tendon_robot_ros.studies.plan import run_plan

pytestmark = pytest.mark.long

pytest.importorskip('pyarrow')


@contextlib.contextmanager
def started(folder, workers):
    """Start a scheduler and workers as a user does; yield the address and the scheduler."""
    told, dask = folder / 'scheduler.json', [sys.executable, '-m', 'dask']
    scheduler = ['scheduler', '--port', '0', '--host', '127.0.0.1', '--no-dashboard']
    worker = ['worker', '--nworkers', str(workers), '--nthreads', '1', '--no-dashboard']
    kept = ['--local-directory', str(folder)]
    where = {'PYTHONPATH': f'{ROOT}:{ROOT / "test"}', 'DASK_TEMPORARY_DIRECTORY': str(folder)}
    with (folder / 'log.txt').open('w') as log:
        both = [
            processes.Process(
                [*dask, *which, '--scheduler-file', str(told)],
                cwd=folder,
                stdout=log,
                stderr=log,
                env={**os.environ, **where},
            )
            for which in (scheduler, [*worker, *kept])
        ]
    try:
        # written whole
        processes.until(
            lambda: told.exists() and told.read_text().rstrip().endswith('}'), seconds=60
        )
        yield json.loads(told.read_text())['address'], both[0]
    finally:
        for process in reversed(both):
            process.send_signal(signal.SIGTERM)  # it ends its own workers
            with contextlib.suppress(processes.TimeoutExpired):
                process.wait(10.0)
            process.end()


@pytest.fixture(scope='module')
def cluster(tmp_path_factory):
    pytest.importorskip('distributed')
    with started(tmp_path_factory.mktemp('cluster'), workers=2) as both:
        yield both


@pytest.mark.slow  # of processes of this machine: test_workers.py; a new worker takes seconds
def test_workers_of_a_cluster_that_are_killed_again_and_again_lose_nothing(cluster):
    dead, found, handed = set(), {}, []
    often = 4  # Dask itself gives a piece of work up after three

    def chunks():
        while len(dead) < often or len(handed) < 20:
            handed.append(len(handed))
            yield handed[-1]

    with Workers(cluster=cluster[0]) as workers:
        for index, (pid, number) in workers.run(nap, chunks()):
            assert index not in found
            found[index] = number
            if pid not in dead and len(dead) < often:  # a nanny starts it anew
                dead.add(pid)
                os.kill(pid, signal.SIGKILL)
    assert len(dead) == often
    assert sorted(found.items()) == [(number, number) for number in handed]


def test_a_cluster_says_the_same_bit_for_bit(cluster, tmp_path):
    with Workers() as workers:
        rows = run_plan(plan(), tmp_path / 'here', workers)
    with Workers(cluster=cluster[0], prepare=Preparation.of_this_process()) as workers:
        assert without_time(run_plan(plan(), tmp_path / 'out', workers)) == without_time(rows)


@pytest.mark.skipif(shutil.which('openssl') is None, reason='openssl makes the certificate')
def test_certificates_of_dasks_own_settings_are_respected(tmp_path):
    """Of a scheduler and a worker in this process, which is reached as any other."""
    distributed = pytest.importorskip('distributed')
    import dask.config

    key, certificate = str(tmp_path / 'key.pem'), str(tmp_path / 'certificate.pem')
    made = ['openssl', 'req', '-x509', '-newkey', 'rsa:2048', '-nodes', '-subj', '/CN=test']
    processes.run([*made, '-keyout', key, '-out', certificate])
    one = {'cert': certificate, 'key': key}
    keys = {
        f'tls_{who}_{what}': path
        for who in ('scheduler', 'worker', 'client')
        for what, path in one.items()
    }
    security = distributed.Security(tls_ca_file=certificate, require_encryption=True, **keys)
    settings = {'n_workers': 1, 'threads_per_worker': 1, 'dashboard_address': ':0'}
    with (
        dask.config.set({'temporary-directory': str(tmp_path)}),
        distributed.LocalCluster(
            processes=False, protocol='tls', host='127.0.0.1', security=security, **settings
        ) as cluster,
    ):
        address = cluster.scheduler_address
        assert address.startswith('tls://')
        with pytest.raises(InputError, match=r'tls://.*client.cert and key; dask names no cert'):
            Workers(cluster=address)
        with (
            dask.config.set({'distributed.comm.require-encryption': True}),
            pytest.raises(InputError, match=r'--cluster tcp://x:1: expected tls://, as .*--proto'),
        ):
            Workers(cluster='tcp://x:1')
        mine = {'distributed.comm.tls.ca-file': certificate, 'distributed.comm.tls.client': one}
        with dask.config.set(mine), Workers(cluster=address) as workers:
            assert [number for _, (_, number) in workers.run(nap, [7])] == [7]


def test_a_scheduler_that_dies_is_one_line_and_what_was_finished_has_come(cluster):
    address, scheduler = cluster
    found = []

    def take(workers):
        for index, _ in workers.run(nap, range(10_000)):
            found.append(index)
            scheduler.kill()

    gone = r'the scheduler is gone .* then the same command'
    with Workers(cluster=address) as workers, pytest.raises(ClusterLostError, match=gone):
        take(workers)
    assert found
