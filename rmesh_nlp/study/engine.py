"""Plans to rows: in this process, in others of this machine, or on a cluster (dask.distributed).

``rm.compare``, ``rmesh compare`` and ``rmesh study`` take what :func:`ended` yields and keep it where each of
them keeps its rows.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Results
from rmesh_nlp.optimize.budget import Budget, checked
from rmesh_nlp.optimize.process import PATIENCE_S
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.solving.monitor import OnStep
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.rows import RowsFile, keys_of, set_failures_aside, wait_for_workers
from rmesh_nlp.study.runner import Done, failure, perform
from rmesh_nlp.study.worker import Worker, task

NO_CLUSTER = (OSError, ValueError, RuntimeError, asyncio.TimeoutError, concurrent.futures.TimeoutError)
"""What dask.distributed raises if a cluster cannot be reached."""


def missing(plan: Sequence[PlannedSolve], folder: Path) -> list[PlannedSolve]:
    """Planned solves without a row."""
    keys = keys_of(folder)
    return [solve for solve in plan if solve.key not in keys]


def run(
    plan: Sequence[PlannedSolve],
    folder: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    retry_failed: bool = False,
) -> Iterator[Record]:
    """Perform what has no row yet; yields each row as it is written, in any order.

    Call it again after any end: it goes on. The caller holds the lock of the folder. A BadInputError says
    that there is no cluster, that it is lost, or that workers of an earlier client are still at work.

    Parameters
    ----------
    plan : sequence of PlannedSolve
    folder : Path
    jobs : int
        Processes that solve on this machine.
    scheduler : str, optional
        Address of a running ``dask scheduler``, such as ``tls://host:8786``; its workers must see the folder
        under the same path. Whoever reaches one at a ``tcp://`` address can run code as its owner.
    retry_failed : bool
        Do solves again whose row is a failure; that row is moved to ``rows/failed.jsonl``.
    """
    wait_for_workers(folder, PATIENCE_S)
    if retry_failed:
        set_failures_aside(folder, {solve.key for solve in plan})
    todo = missing(plan, folder)
    for _, done in ended(todo, folder, jobs, scheduler):
        yield done.row


Ended = Iterator[tuple[PlannedSolve, Done]]
"""Solves with what came of them, as they end."""


def ended(
    plan: Sequence[PlannedSolve],
    folder: Path | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    on_start: Callable[[PlannedSolve], object] = lambda solve: None,
    on_step: OnStep | None = None,
) -> Ended:
    """Perform a plan in this process, in whose order solves end; with a folder of workers in others.

    Workers write rows and fields to the ``folder``. ``on_start`` and ``on_step`` hear of this process alone.
    """
    if folder is None:
        for solve in plan:
            on_start(solve)
            yield solve, perform(solve, on_step)
    elif scheduler is None:
        yield from _by_workers(plan, folder, jobs)
    else:
        for solve, row in _distributed_rows(plan, folder, scheduler):
            yield solve, Done(_lost(solve, folder) if row is None else row)


def _by_workers(plan: Sequence[PlannedSolve], folder: Path, jobs: int) -> Ended:
    """By so many processes, each watched by a worker in a thread."""
    session, idle, count = Budget(), SimpleQueue[Worker](), min(jobs, len(plan))
    if not count:
        return

    def solved(solve: PlannedSolve) -> Record:
        worker = idle.get()
        try:
            return checked(session.check, lambda: worker.perform(solve))
        finally:
            idle.put(worker)

    with ExitStack() as workers, concurrent.futures.ThreadPoolExecutor(count) as pool:
        for _ in range(count):
            idle.put(workers.enter_context(Worker(folder)))
        try:
            solve_of = {pool.submit(solved, solve): solve for solve in plan}
            for future in concurrent.futures.as_completed(solve_of):
                row = future.result()
                yield solve_of[future], Done(row, aside=Results(folder).result(row))
        finally:  # after Ctrl-C nothing goes on
            session.stopped = Status.INTERRUPTED
            pool.shutdown(wait=False, cancel_futures=True)


def _distributed_rows(
    plan: Sequence[PlannedSolve], folder: Path, scheduler: str
) -> Iterator[tuple[PlannedSolve, Record | None]]:
    """By the workers of a cluster; None where one was lost for good."""
    if not plan:
        return
    try:
        import distributed
    except ImportError:
        raise BadInputError("--scheduler needs dask.distributed: pip install 'rmesh-nlp[study]'") from None
    with _client(distributed, scheduler) as client:
        futures = client.map(
            task,
            [solve.plain() for solve in plan],
            folder=str(folder.resolve()),
            key=[f"rmesh-{solve.key}" for solve in plan],
            pure=False,
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
                raise BadInputError(f"a worker cannot work: {one_line(future.exception())}")


def _lost(solve: PlannedSolve, folder: Path) -> Record:
    """Write the row of a solve whose worker was lost for good."""
    rows = RowsFile(folder)
    row = failure(solve, "died", "its worker was lost more often than a solve is tried")
    row |= {"worker": rows.name, "shared": True}
    with rows.working():
        rows.append(row)
    return row


@contextmanager
def _client(distributed: Any, scheduler: str) -> Iterator[Any]:
    """A client of the cluster."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if hasattr(signal, "SIGPIPE") and threading.current_thread() is threading.main_thread():
        # as Python has it: libraries such as gmsh may have set it so that a lost connection ends this process
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    if scheduler.startswith("tls:"):
        _check_certificate(distributed, scheduler)
    client = None
    try:
        try:
            client = distributed.Client(scheduler, timeout=PATIENCE_S, set_as_default=False)
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except NO_CLUSTER as error:
            reason = one_line(error) or "it did not answer in time"
            raise BadInputError(f"no cluster at {scheduler}: {reason}") from error
        yield client
    finally:
        if client is not None:
            with suppress(*NO_CLUSTER):  # it did not end in time
                client.close(timeout=10)


def _check_certificate(distributed: Any, scheduler: str) -> None:
    if distributed.Security().get_connection_args("client").get("ssl_context") is None:
        raise BadInputError(
            f"{scheduler} asks for a certificate: name it in dask's configuration, "
            "distributed.comm.tls.client, or in DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT"
        )
