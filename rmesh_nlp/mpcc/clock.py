"""Limits of time and of iterations, and calls that do not look at the clock themselves."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from rmesh_nlp.optimize.status import Status

T = TypeVar("T")


class LimitReachedError(Exception):
    """A limit of time or of iterations was met; ``status`` says which."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.message)
        self.status = status


def within(seconds: float, work: Callable[[], T]) -> T:
    """What ``work`` returns, or LimitReachedError after ``seconds``.

    A sparse factorisation cannot be interrupted. It releases Python's lock, so it runs in a thread that is
    left to itself when the time is over. (HiGHS does not bear that: its own threads abort the process.)
    """
    if not np.isfinite(seconds):
        return work()
    answers: list[T] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            answers.append(work())
        except BaseException as error:  # raised again by the caller
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(min(seconds, threading.TIMEOUT_MAX))
    if errors:
        raise errors[0]
    if not answers:
        raise LimitReachedError(Status.TIME_LIMIT)
    return answers[0]
