"""What a worker does with a planned solve: solve it in a process of its own and write its row.

``python -m rmesh_nlp.study.worker`` is that process, which can be killed: a hang, a leak or a crash becomes a
row. It takes solves on stdin and gives rows on stdout, as JSON lines.
"""

from __future__ import annotations

import functools
import json
import os
import platform
import socket
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from rmesh_nlp.io.records import Record, to_json
from rmesh_nlp.io.results import Results
from rmesh_nlp.optimize.budget import Budget, processor_seconds
from rmesh_nlp.optimize.process import Process, serve
from rmesh_nlp.settings import Values
from rmesh_nlp.solving.entries import versions
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.rows import RowsFile, keys_of
from rmesh_nlp.study.runner import failure, perform

GRACE_S = 2.0
GRACE = 1.25
"""A solve is killed after its time limit times ``GRACE`` plus ``GRACE_S``: formulations that keep the limit
themselves then still return their best point."""


def _row(line: bytes) -> bytes:
    """Run a solve, keep its fields in a folder of results, and return its row as JSON."""
    request = json.loads(line)
    solve, folder = PlannedSolve(**request["solve"]), Path(request["folder"])
    watch, cpu = Budget(), processor_seconds()
    done = perform(solve)
    times = {"task_time_s": watch.elapsed, "cpu_time_s": processor_seconds() - cpu}
    row = {**done.row, **times}
    if solve.fields:
        done.save(Results(folder).result(row))
    return to_json(row).encode()


ALONE = 0.9  # a solve that got less of its time from the processor shared it with something


class Worker:
    """Performs planned solves of the study in a folder, one at a time; as a context it is closed at the end.

    They are solved in a process of its own. If there is one, it takes a core for itself, on which that is
    pinned; rows of solves that had no core alone carry ``shared = true``.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._core = _own_core()
        cores = None if self._core is None else {self._core[0]}
        self._process = Process("rmesh_nlp.study.worker", cores)
        self._rows = RowsFile(folder)
        self._noted = False

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process of the solves and give the core back."""
        self._process.close()
        if self._core is not None:
            self._core[1].close()
            self._core = None

    def perform(self, solve: PlannedSolve) -> Record:
        """Solve, write the row and return it."""
        with self._rows.working():
            if not self._noted:
                self._noted = True
                self._rows.write_environment(json.dumps(environment(), indent=2) + "\n")
            row = self.row(solve)
            self._rows.append(row)
        return row

    def row(self, solve: PlannedSolve) -> Record:
        """The row of a solve, not written anywhere."""
        row = self.solved(solve)
        wall, cpu = row.get("task_time_s"), row.get("cpu_time_s")
        busy = bool(wall and cpu is not None and cpu < ALONE * wall)
        return {**row, "shared": self._core is None or busy, "worker": self._rows.name}

    def solved(self, solve: PlannedSolve) -> Record:
        """What the process answers, whatever happens to it; it keeps the fields in the folder."""
        request = json.dumps({"solve": solve.plain(), "folder": str(self._folder)})
        seconds = solve.time_s * GRACE + GRACE_S
        answer = self._process.ask(request.encode(), seconds, solve.memory_mb)
        if answer.line is not None:
            if self._process.megabytes > 0.5 * solve.memory_mb:
                self._process.close()  # what a leak has left is not charged to the next solve
            row: Record = json.loads(answer.line)
            return row
        said = {
            "time_limit": f"killed after {answer.seconds:.1f} s: the limit is {solve.time_s:g} s",
            "memory_limit": f"killed with more memory than the limit of {solve.memory_mb:g} MB",
            "died": f"its process ended twice, at last with code {answer.code}",
        }
        return failure(solve, answer.why, said[answer.why], answer.seconds)


@functools.lru_cache(maxsize=1)
def worker_of(folder: str) -> Worker:
    """The worker of this process for a folder; on a cluster it lives as long as the process."""
    return Worker(Path(folder))


def task(content: Values, folder: str) -> Record:
    """A task of a cluster: :meth:`Worker.perform`, unless a lost worker has written the row before."""
    solve = PlannedSolve(**content)
    if solve.key in keys_of(Path(folder)):
        return {"key": solve.key, "found": True}
    return worker_of(folder).perform(solve)


def _own_core() -> tuple[int, socket.socket] | None:
    """A core that no other worker on this machine has, and the socket that says so (Linux).

    Of a name in the abstract namespace there is one socket on a machine, whatever the study, and the
    system takes it back when its process ends, also by ``kill -9``.
    """
    for core in sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else ():
        holder = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            holder.bind(f"\0rmesh-nlp-core-{core}")
        except OSError:
            holder.close()
        else:
            return core, holder
    return None


def environment() -> Values:
    """What decides times, and in chaotic descents the last digits, as plain JSON values."""
    return {
        "host": socket.gethostname(),
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "cores_allowed": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "blas": _blas(),
        "threads": {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")},
        "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE"),
        "versions": versions(),
    }


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()


def _blas() -> str:
    try:
        config: Any = np.show_config(mode="dicts")
        blas = config["Build Dependencies"]["blas"]
        return f"{blas['name']} {blas['version']}"
    except (TypeError, KeyError):  # other versions of numpy say it otherwise
        return "unknown"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    serve(_row)
