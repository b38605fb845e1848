"""A process that answers lines and can be killed: what hangs, leaks or crashes in it ends nothing else."""

from __future__ import annotations

import ctypes
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
from base64 import b64decode, b64encode
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor, TimeoutError
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

from rmesh_nlp.optimize.budget import Budget, Limits, checkpoint

READY = b"ready"

PATIENCE_S = 120.0  # longest wait for a process, a worker or a cluster to begin or to end its work
POLL_S = 0.05
ATTEMPTS = 2  # what is killed from outside is asked once more


class Answer(NamedTuple):
    """A line, or None where the process was ended, the reason, its exit code, and the seconds that it took.

    The reason is ``time_limit``, ``memory_limit`` or ``died``.
    """

    line: bytes | None
    why: str
    code: int | None
    seconds: float


class Process:
    """``python -m MODULE`` on the given cores, which calls :func:`serve`; started anew where need be."""

    def __init__(self, module: str, cores: Collection[int] | None = None) -> None:
        self._module, self._cores = module, cores
        self._process: subprocess.Popen[bytes] | None = None
        self._one_by_one, self._reader = threading.Lock(), ThreadPoolExecutor(1)

    def ask(self, request: bytes, seconds: float = math.inf, megabytes: float = math.inf) -> Answer:
        """The answer to a line, within these limits.

        Ctrl-C, and a StoppedError of the checkpoints on the way, end the process.
        """
        with self._one_by_one:
            try:
                for _ in range(ATTEMPTS):
                    process = self._ready()
                    with suppress(OSError):  # it died while it had nothing to do, and gives no answer
                        cast(IO[bytes], process.stdin).write(request + b"\n")
                        cast(IO[bytes], process.stdin).flush()
                    watch = Budget(Limits(seconds))
                    line, why = self._answer(process, watch, megabytes)
                    code = self.close() if line is None else None
                    if why != "died":
                        break
            except BaseException:
                self.close()
                raise
        return Answer(line, why, code, watch.elapsed)

    def close(self) -> int | None:
        """End the process; returns its exit code."""
        process, self._process = self._process, None
        if process is None:
            return None
        with suppress(OSError), process:  # which closes its pipes and waits for it
            process.kill()
        return process.returncode

    @property
    def megabytes(self) -> float:
        """Memory that the process holds; 0 without one."""
        return 0.0 if self._process is None else _megabytes(self._process.pid)

    def _ready(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.close()
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self._process = process = subprocess.Popen(
            [sys.executable, "-m", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads},
        )
        if self._cores and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(process.pid, self._cores)
        line, _ = self._answer(process, Budget(Limits(PATIENCE_S)))
        if line is None or line.strip() != READY:
            raise OSError(f"no process of {self._module} could be started: it ended with code {self.close()}")
        return process

    def _answer(
        self, process: subprocess.Popen[bytes], budget: Budget, megabytes: float = math.inf
    ) -> tuple[bytes | None, str]:
        """A line of the process; None with the reason if there is none."""
        reading = self._reader.submit(cast(IO[bytes], process.stdout).readline)
        while True:
            with suppress(TimeoutError):
                line = reading.result(POLL_S)
                return (line, "") if line.endswith(b"\n") else (None, "died")
            checkpoint()
            if budget.is_over():
                return None, "time_limit"
            if megabytes < _megabytes(process.pid):
                return None, "memory_limit"


def _megabytes(pid: int) -> float:
    """Memory that a process holds; 0 where the system does not tell (other than Linux without psutil)."""
    with suppress(OSError, IndexError, ValueError):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    with suppress(Exception):
        psutil: Any = __import__("psutil")
        return float(psutil.Process(pid).memory_info().rss / 1e6)
    return 0.0


def packed(value: object) -> bytes:
    """A value as a line for a process."""
    return b64encode(pickle.dumps(value))


def unpacked(line: bytes) -> Any:
    """The value of a line."""
    return pickle.loads(b64decode(line))


def serve(answer: Callable[[bytes], bytes]) -> None:
    """Answer lines on stdin by lines on stdout until stdin ends."""
    if sys.platform == "linux":  # end with the parent, also when that is ended by ``kill -9``
        kill_at_end_of_parent = 1
        ctypes.CDLL(None).prctl(kill_at_end_of_parent, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client, which then ends this process
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # solvers print what they like
        answers.write(READY + b"\n")
        answers.flush()
        for line in sys.stdin.buffer:
            answers.write(answer(line) + b"\n")
            answers.flush()
