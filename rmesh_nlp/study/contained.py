"""Solves in a process that can be killed: a hang, a leak or a crash becomes a row.

``python -m rmesh_nlp.study.contained`` is that process: solves on stdin, rows on stdout, as JSON lines.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import select
import signal
import subprocess
import sys
import warnings
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

from rmesh_nlp.io.records import Record, to_json
from rmesh_nlp.io.results import Results
from rmesh_nlp.optimize.budget import Budget, Limits, StoppedError, processor_seconds
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.runner import failure, perform

READY = b"ready"

GRACE_S = 2.0
GRACE = 1.25
"""A solve is killed after its time limit times ``GRACE`` plus ``GRACE_S``: formulations that keep the limit
themselves then still return their best point."""

PATIENCE_S = 120.0  # longest wait for a process, a worker or a cluster to begin or to end its work
POLL_S = 0.05
ATTEMPTS = 2  # a solve whose process is killed from outside is tried once more, then it is a row


class Contained:
    """Runs planned solves one after the other in a process of their own on the given cores.

    It is started anew where need be. Once the ``session`` is stopped a StoppedError ends what is solved.
    """

    def __init__(self, cores: Collection[int] | None, session: Budget | None) -> None:
        self._cores, self._session = cores, session
        self._process: subprocess.Popen[bytes] | None = None

    def solve(self, solve: PlannedSolve, folder: Path) -> Record:
        """The row of a solve, whatever happens to it; its fields are kept in a folder of results."""
        for _ in range(ATTEMPTS):
            process = self._ready()
            request = json.dumps({"solve": solve.plain(), "folder": str(folder)})
            assert process.stdin is not None
            with suppress(OSError):  # it died while it had nothing to do, and gives no answer
                process.stdin.write(request.encode() + b"\n")
                process.stdin.flush()
            watch = Budget(Limits(solve.time_s * GRACE + GRACE_S), self._session)
            line, why = self._answer(process, watch, solve.memory_mb)
            seconds = watch.elapsed
            if line is not None:
                if _megabytes(process.pid) > 0.5 * solve.memory_mb:
                    self.close()  # what a leak has left is not charged to the next solve
                row: Record = json.loads(line)
                return row
            code = self.close()
            if why != "died":
                break
        said = {
            "time_limit": f"killed after {seconds:.1f} s: the limit is {solve.time_s:g} s",
            "memory_limit": f"killed with more memory than the limit of {solve.memory_mb:g} MB",
            "died": f"its process ended twice, at last with code {code}",
        }
        return failure(solve, why, said[why], seconds)

    def close(self) -> int | None:
        """End the process; returns its exit code."""
        process, self._process = self._process, None
        if process is None:
            return None
        with suppress(OSError), process:  # which closes its pipes and waits for it
            process.kill()
        return process.returncode

    def _ready(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.close()
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        process = subprocess.Popen(
            [sys.executable, "-m", "rmesh_nlp.study.contained"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads},
        )
        self._process = process
        if self._cores and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(process.pid, self._cores)
        line, _ = self._answer(process, Budget(Limits(PATIENCE_S), self._session))
        if line is None or line.strip() != READY:
            code = self.close()
            raise OSError(f"no process for solves could be started: it ended with code {code}")
        return process

    def _answer(
        self, process: subprocess.Popen[bytes], budget: Budget, megabytes: float = math.inf
    ) -> tuple[bytes | None, str]:
        """A line of the process; None with the status of its solve if there is none."""
        assert process.stdout is not None
        while not select.select([process.stdout], [], [], POLL_S)[0]:
            if budget.is_over():
                if budget.stopped is Status.INTERRUPTED:
                    raise StoppedError
                return None, "time_limit"
            if megabytes < _megabytes(process.pid):
                return None, "memory_limit"
        line = process.stdout.readline()
        return (line, "") if line.endswith(b"\n") else (None, "died")


def _megabytes(pid: int) -> float:
    """Memory that a process holds; 0 where the system does not tell (other than Linux without psutil)."""
    with suppress(OSError, IndexError, ValueError):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    with suppress(Exception):
        psutil: Any = __import__("psutil")
        return float(psutil.Process(pid).memory_info().rss / 1e6)
    return 0.0


def main() -> None:
    """Answer until stdin ends."""
    if sys.platform == "linux":  # end with the parent, also when that is ended by ``kill -9``
        kill_at_end_of_parent = 1
        ctypes.CDLL(None).prctl(kill_at_end_of_parent, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client, which then ends this process
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # solvers print what they like
        warnings.simplefilter("ignore")
        answers.write(READY + b"\n")
        answers.flush()
        for line in sys.stdin:
            request = json.loads(line)
            answers.write(_row(PlannedSolve(**request["solve"]), Path(request["folder"])) + b"\n")
            answers.flush()


def _row(solve: PlannedSolve, folder: Path) -> bytes:
    """Run a solve, keep its fields in a folder of results, and return its row as JSON."""
    watch, cpu = Budget(), processor_seconds()
    done = perform(solve)
    times = {"task_time_s": watch.elapsed, "cpu_time_s": processor_seconds() - cpu}
    row = {**done.row, **times}
    if solve.fields:
        done.save(Results(folder).result(row))
    return to_json(row).encode()


if __name__ == "__main__":
    main()
