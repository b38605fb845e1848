"""What a worker does with a planned solve: solve it in a process of its own and write its row."""

from __future__ import annotations

import functools
import json
import os
import socket
import sys
from pathlib import Path
from typing import Any

from rmesh_nlp.io.records import Record
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.study.contained import Contained
from rmesh_nlp.study.environment import environment
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.rows import RowsFile, keys_of

ALONE = 0.9  # a solve that got less of its time from the processor shared it with something


class Worker:
    """Performs planned solves of the study in a folder, one at a time; as a context it is closed at the end.

    If there is one, it takes a core for itself, on which its solves are pinned; rows of solves that had
    no core alone carry ``shared = true``. Once the ``session`` is stopped a StoppedError ends its solve.
    """

    def __init__(self, folder: Path, session: Budget | None = None) -> None:
        self._folder = folder
        self._core = _own_core()
        self._contained = Contained(None if self._core is None else {self._core[0]}, session)
        self._rows = RowsFile(folder)
        self._noted = False

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process of the solves and give the core back."""
        self._contained.close()
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
        row = self._contained.solve(solve, self._folder)
        wall, cpu = row.get("task_time_s"), row.get("cpu_time_s")
        busy = bool(wall and cpu is not None and cpu < ALONE * wall)
        return {**row, "shared": self._core is None or busy, "worker": self._rows.name}


@functools.lru_cache(maxsize=1)
def worker_of(folder: str) -> Worker:
    """The worker of this process for a folder; on a cluster it lives as long as the process."""
    return Worker(Path(folder))


def task(content: dict[str, Any], folder: str) -> Record:
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
