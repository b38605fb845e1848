"""Work in a process of its own, so that a solver that hangs, crashes or raises is a row and not the end."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Failed:
    """Why there is no result, in words for a table."""

    why: str


def isolated(work: Callable[[], T], limit: float) -> T | Failed:
    """What ``work`` returns, if it does so within ``limit`` seconds.

    The process is forked: it has what this one has imported and solved before, and nothing of it is timed.
    """
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(work, sender))
    process.start()
    sender.close()
    try:
        answer = receiver.recv() if receiver.poll(limit) else Failed(f"stopped after {limit:g} s")
    except EOFError:
        process.join()
        code = process.exitcode or 0
        answer = Failed(f"crashed: {signal.Signals(-code).name}" if code < 0 else "no answer")
    process.kill()
    process.join()
    return answer


def _send(work: Callable[[], T], pipe: Connection) -> None:
    try:
        pipe.send(work())
    except Exception as error:
        pipe.send(Failed(f"{type(error).__name__}: {' '.join(str(error).split())}"[:90]))
