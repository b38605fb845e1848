"""Solves in a process that can be killed: a hang, a leak or a crash becomes a row.

``python -m rmesh_nlp.study.contained`` is that process: solves on stdin, rows on stdout, as JSON lines.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Collection
from pathlib import Path

from rmesh_nlp.io.records import Record, to_json
from rmesh_nlp.io.results import Results
from rmesh_nlp.optimize.budget import Budget, processor_seconds
from rmesh_nlp.optimize.process import Process, serve
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.runner import failure, perform

GRACE_S = 2.0
GRACE = 1.25
"""A solve is killed after its time limit times ``GRACE`` plus ``GRACE_S``: formulations that keep the limit
themselves then still return their best point."""


class Contained:
    """Runs planned solves one after the other in a process of their own on the given cores.

    Once the ``session`` is stopped a StoppedError ends what is solved.
    """

    def __init__(self, cores: Collection[int] | None, session: Budget | None) -> None:
        self._process, self._session = Process("rmesh_nlp.study.contained", cores), session
        self.close = self._process.close

    def solve(self, solve: PlannedSolve, folder: Path) -> Record:
        """The row of a solve, whatever happens to it; its fields are kept in a folder of results."""
        request = json.dumps({"solve": solve.plain(), "folder": str(folder)})
        seconds = solve.time_s * GRACE + GRACE_S
        answer = self._process.ask(request.encode(), self._session, seconds, solve.memory_mb)
        if answer.line is not None:
            if self._process.megabytes > 0.5 * solve.memory_mb:
                self.close()  # what a leak has left is not charged to the next solve
            row: Record = json.loads(answer.line)
            return row
        said = {
            "time_limit": f"killed after {answer.seconds:.1f} s: the limit is {solve.time_s:g} s",
            "memory_limit": f"killed with more memory than the limit of {solve.memory_mb:g} MB",
            "died": f"its process ended twice, at last with code {answer.code}",
        }
        return failure(solve, answer.why, said[answer.why], answer.seconds)


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


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    serve(_row)
