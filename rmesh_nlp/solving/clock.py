"""The one clock of all strategies: wall time by what it was spent on."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal, TypeVar

T = TypeVar("T")

Phase = Literal["build", "solve", "audit"]

TIMING_SECONDS = 0.05
"""Time spent on measuring something short, which is then repeated up to five times."""


def timed(solve: Callable[[], T]) -> tuple[T, float]:
    """A result and the wall time that it takes, the median of a few where it is short."""
    seconds: list[float] = []
    while not seconds or (len(seconds) < 5 and sum(seconds) < TIMING_SECONDS):
        began = time.perf_counter()
        result = solve()
        seconds.append(time.perf_counter() - began)
    return result, statistics.median(seconds)


def solving(elapsed: float, build: float, audit: float) -> float:
    """Seconds of the ``elapsed`` ones that went neither into statements of programs nor into audits."""
    return max(elapsed - build - audit, 0.0)


class Clock:
    """Wall time since it was made, split into phases; at any moment exactly one of them runs.

    ``build``: programs and their derivatives are stated. ``solve``: the strategy runs. ``audit``: the
    referee measures, the unit of cost included. So their sum is the time from the first line of a
    strategy to its solution.
    """

    def __init__(self) -> None:
        self._seconds: dict[Phase, float] = {"build": 0.0, "solve": 0.0, "audit": 0.0}
        self._phase: Phase = "build"
        self._since = time.perf_counter()

    def enter(self, phase: Phase) -> None:
        """From now on time counts as spent on ``phase``."""
        now = time.perf_counter()
        self._seconds[self._phase] += now - self._since
        self._phase, self._since = phase, now

    @contextmanager
    def during(self, phase: Phase) -> Iterator[None]:
        """Time in this context counts as spent on ``phase``, then on what it was before."""
        before = self._phase
        self.enter(phase)
        try:
            yield
        finally:
            self.enter(before)

    def seconds(self, phase: Phase) -> float:
        """What ``phase`` has taken so far."""
        self.enter(self._phase)
        return self._seconds[phase]

    @property
    def elapsed(self) -> float:
        """Build and solve so far: what the strategy itself has cost."""
        return self.seconds("build") + self._seconds["solve"]
