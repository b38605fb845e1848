"""Plans to rows: in this process, on a local cluster, or on a cluster that is there (dask.distributed)."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.records import Record
from rmesh_nlp.study import worker as workers
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.rows import Keys, RowsFile, set_failures_aside, wait_for_workers
from rmesh_nlp.study.runner import failure

BATCH = 1000  # solves that are handed to the scheduler in one message
WAIT_S = 120.0  # longest wait for workers that outlived an earlier client
START_S = 120.0  # longest wait for the workers of a cluster
NO_CLUSTER = (OSError, ValueError, RuntimeError, asyncio.TimeoutError, concurrent.futures.TimeoutError)
"""What dask.distributed raises if a cluster cannot be reached, or its processes do not start."""

OWN_SETTINGS = {
    "distributed.scheduler.preload": [workers.__name__],  # its dask_setup
    "distributed.worker.preload": [workers.__name__],
    "distributed.worker.profile.enabled": False,
}
"""A cluster that is started here serves no pages, and its workers do not look at their own stack."""


def missing(plan: Sequence[PlannedSolve], folder: Path) -> list[PlannedSolve]:
    """Planned solves without a row."""
    keys = Keys(folder).now()
    return [solve for solve in plan if solve.key not in keys]


def run(
    plan: Sequence[PlannedSolve],
    folder: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    retry_failed: bool = False,
) -> Iterator[Record]:
    """Perform what has no row yet; yields each row in short as it is written, in any order.

    Call it again after any end: it goes on. The caller holds the lock of the folder. A BadInputError says
    that there is no cluster, that it is lost, or that workers of an earlier client are still at work.

    Parameters
    ----------
    plan : sequence of PlannedSolve
    folder : Path
    jobs : int
        Processes of a local cluster; 1 needs no cluster.
    scheduler : str, optional
        Address of a running ``dask scheduler``, such as ``tls://host:8786``; its workers must see the folder
        under the same path. Whoever reaches one at a ``tcp://`` address can run code as its owner.
    retry_failed : bool
        Do solves again whose row is a failure; that row is moved to ``rows/failed.jsonl``.
    """
    wait_for_workers(folder, WAIT_S)
    if retry_failed:
        set_failures_aside(folder, {solve.key for solve in plan})
    todo = missing(plan, folder)
    if jobs == 1 and scheduler is None:
        if todo:
            with workers.Worker(folder) as worker:
                yield from map(worker.perform, todo)
        return
    rows = RowsFile(folder)
    for solve, row in distributed_rows(todo, folder, jobs, scheduler):
        if row is None:
            row = {**lost(solve), "worker": rows.name, "shared": True}
            with rows.working():
                rows.append(row)
        yield row


def lost(solve: PlannedSolve) -> Record:
    """The row of a solve whose worker died again and again."""
    return failure(solve, "died", "its worker was lost more often than a solve is tried")


def distributed_rows(
    plan: Sequence[PlannedSolve],
    folder: Path,
    jobs: int,
    scheduler: str | None = None,
    *,
    whole: bool = False,
) -> Iterator[tuple[PlannedSolve, Record | None]]:
    """Solves with their rows as they end; None where the worker was lost for good.

    Workers write the rows and tell them in short; ``whole`` ones are for the caller to write.
    """
    if not plan:
        return
    try:
        import distributed
    except ImportError:
        said = "--jobs above 1 and --scheduler need dask.distributed: pip install 'rmesh-nlp[study]'"
        raise BadInputError(said) from None
    with _client(distributed, min(jobs, len(plan)), scheduler) as client:
        futures = client.map(
            workers.task,
            [solve.plain() for solve in plan],
            folder=str(folder.resolve()),
            whole=whole,
            key=[f"rmesh-{solve.key}" for solve in plan],
            pure=False,
            batch_size=BATCH,
        )
        solve_of = dict(zip(futures, plan, strict=True))
        del futures  # what has ended is released
        for future in distributed.as_completed([*solve_of], loop=client.loop):
            solve = solve_of.pop(future)
            if future.status == "finished":
                yield solve, future.result()
            elif future.status != "error":
                raise BadInputError(
                    f"the scheduler is lost ({solve.key} {future.status}): run again to go on"
                )
            elif isinstance(future.exception(), distributed.KilledWorker):
                yield solve, None
            else:
                raise BadInputError(f"a worker cannot work: {' '.join(str(future.exception()).split())}")


@contextmanager
def _client(distributed: Any, jobs: int, scheduler: str | None) -> Iterator[Any]:
    """A client of the cluster; a local one ends with it."""
    import dask

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if hasattr(signal, "SIGPIPE") and threading.current_thread() is threading.main_thread():
        # as Python has it: libraries such as gmsh may have set it so that a lost connection ends this process
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    cluster = client = None
    try:
        try:
            with dask.config.set(OWN_SETTINGS):
                if scheduler is None:
                    cluster = _own_cluster(distributed)
                    _start_workers(cluster, jobs)
                elif scheduler.startswith("tls:"):
                    _check_certificate(distributed, scheduler)
                client = distributed.Client(cluster or scheduler, timeout=START_S, set_as_default=False)
                client.wait_for_workers(1, timeout=START_S)
        except BadInputError:
            raise
        except NO_CLUSTER as error:
            reason = " ".join(str(error).split()) or "it did not answer in time"
            where = f"at {scheduler}" if scheduler else "on this machine"
            raise BadInputError(f"no cluster {where}: {reason}") from error
        yield client
    finally:
        try:
            for resource in (client, cluster):
                if resource is not None:
                    with suppress(*NO_CLUSTER):  # it did not end in time
                        resource.close(timeout=10)
        finally:  # also after a second Ctrl-C nobody waits again: what is left ends with this process
            if cluster is not None:
                cluster.shutdown_on_close = False


def _check_certificate(distributed: Any, scheduler: str) -> None:
    if distributed.Security().get_connection_args("client").get("ssl_context") is None:
        raise BadInputError(
            f"{scheduler} asks for a certificate: name it in dask's configuration, "
            "distributed.comm.tls.client, or in DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT"
        )


def _own_cluster(distributed: Any) -> Any:
    """A scheduler on this machine that talks to this client and its own workers only.

    Both sides must show a certificate that is made here and never written to the disk: any local user may
    connect to a port of this machine. Its threads, and the processes that they start, do not see Ctrl-C,
    which is for the client.
    """
    try:
        security = distributed.Security.temporary()
    except ImportError:
        raise BadInputError("--jobs above 1 needs cryptography: pip install 'rmesh-nlp[study]'") from None
    with _deaf_to_interrupts():
        return distributed.LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            security=security,
            dashboard_address=None,
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        )


def _start_workers(cluster: Any, jobs: int) -> None:
    """Start worker processes and wait for them; an interrupt ends the waiting, and closing then ends them."""

    async def started() -> None:
        await cluster
        if not cluster.scheduler.workers:
            raise RuntimeError("its worker processes ended while they started; run the same command again")

    # else the failure of one of several workers is printed as a traceback; the others do its work
    cluster.loop.asyncio_loop.set_exception_handler(lambda loop, context: None)
    cluster.scale(jobs)
    asyncio.run_coroutine_threadsafe(started(), cluster.loop.asyncio_loop).result(START_S)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Threads that are started now, and processes that they start, never get Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # else the first process that is started lets signals in again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
