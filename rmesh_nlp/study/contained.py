"""Solves in a process that can be killed: a hang, a leak or a crash becomes a row."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Collection
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rmesh_nlp.io.records import Record
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.runner import READY, failure

GRACE_S = 2.0
GRACE = 1.25
"""A solve is killed after its time limit times ``GRACE`` plus ``GRACE_S``: formulations that keep the limit
themselves then still return their best point."""

START_S = 300.0
"""Longest time that a process may take to begin, on a loaded machine."""

POLL_S = 0.05
ATTEMPTS = 2
"""A solve whose process is killed from outside is tried once more, then it is a row."""


class Contained:
    """Runs planned solves one after the other in a process of their own, started anew where need be.

    Parameters
    ----------
    cores : collection of int, optional
        Where the process may run.
    """

    def __init__(self, cores: Collection[int] | None = None) -> None:
        self._cores = cores
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""

    def solve(self, solve: PlannedSolve, folder: Path | None) -> Record:
        """The row of a solve, whatever happens to it."""
        for attempt in range(1, ATTEMPTS + 1):
            process = self._ready()
            began = time.monotonic()
            request = json.dumps({"solve": asdict(solve), "folder": None if folder is None else str(folder)})
            try:
                assert process.stdin is not None
                process.stdin.write(request.encode() + b"\n")
                process.stdin.flush()
            except OSError:  # it died while it had nothing to do
                self.close()
                continue
            line, why = self._answer(process, solve.time_s * GRACE + GRACE_S, solve.memory_mb)
            seconds = time.monotonic() - began
            if line is not None:
                memory = _megabytes(process.pid)
                if memory is not None and memory > 0.5 * solve.memory_mb:
                    self.close()  # what a leak has left is not charged to the next solve
                row: Record = json.loads(line)
                return row
            code = self.close()
            if why == "time":
                message = f"killed after {seconds:.1f} s: the limit is {solve.time_s:g} s"
                return failure(solve, "time_limit", message, seconds)
            if why == "memory":
                message = f"killed with more memory than the limit of {solve.memory_mb:g} MB"
                return failure(solve, "memory_limit", message, seconds)
            if attempt == ATTEMPTS:
                return failure(solve, "died", f"its process ended twice, at last with code {code}", seconds)
        return failure(solve, "died", "its process could not be given the problem")

    def close(self) -> int | None:
        """End the process; returns its exit code."""
        process, self._process, self._buffer = self._process, None, b""
        if process is None:
            return None
        process.kill()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return process.wait()

    def _ready(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.close()
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        process = subprocess.Popen(
            [sys.executable, "-m", "rmesh_nlp.study.runner"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads},
        )
        self._process = process
        if self._cores and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(process.pid, self._cores)
        line, _ = self._answer(process, START_S, None)
        if line is None or line.decode().strip() != READY:
            code = self.close()
            raise RuntimeError(f"no process for solves could be started: it ended with code {code}")
        return process

    def _answer(
        self, process: subprocess.Popen[bytes], seconds: float, megabytes: float | None
    ) -> tuple[bytes | None, str]:
        """A line of the process; None with the reason (time, memory, died) if there is none."""
        assert process.stdout is not None
        end = time.monotonic() + seconds
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while True:
                if b"\n" in self._buffer:
                    line, self._buffer = self._buffer.split(b"\n", 1)
                    return line, ""
                if selector.select(POLL_S):
                    part = os.read(process.stdout.fileno(), 1 << 16)
                    if not part:
                        return None, "died"
                    self._buffer += part
                    continue
                if time.monotonic() > end:
                    return None, "time"
                used = None if megabytes is None else _megabytes(process.pid)
                if used is not None and megabytes is not None and used > megabytes:
                    return None, "memory"


def _megabytes(pid: int) -> float | None:
    """Memory that a process holds; None where the system does not tell (other than Linux without psutil)."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return _by_psutil(pid)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _by_psutil(pid: int) -> float | None:
    try:
        psutil: Any = __import__("psutil")
        return float(psutil.Process(pid).memory_info().rss / 1e6)
    except Exception:
        return None
