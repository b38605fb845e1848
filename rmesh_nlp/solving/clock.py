"""Time of one solve: its limits, its clock, Ctrl-C in critical sections, and guesses of the time left."""

from __future__ import annotations

import math
import signal
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Literal

import numpy as np

from rmesh_nlp.settings import Limit, Seconds, Settings

TOLERANCE = 1e-6
"""Default of ``tolerance``: the largest first-order residual of a point that is called stationary."""


@dataclass(frozen=True)
class Limits(Settings):
    """Limits of one solve, after which its best valid mesh is the solution.

    Attributes
    ----------
    seconds : float
        Of building and solving together, looked at after each iteration.
    iterations : int, optional
        Over everything that a formulation runs.
    """

    seconds: Seconds = 600.0
    iterations: Limit | None = None


Phase = Literal["build", "solve", "audit"]

TIMING_SECONDS = 0.01
"""Time spent on measuring something short, which is repeated up to five times."""


def timed(first: Callable[[], object], again: Callable[[], object]) -> float:
    """Wall time of ``first``; where it is short, or known already, the median of a few of ``again``."""
    seconds = [_elapsed(first)]
    if seconds[0] >= TIMING_SECONDS:
        return seconds[0]
    seconds = [_elapsed(again)]
    while len(seconds) < 5 and sum(seconds) < TIMING_SECONDS:
        seconds.append(_elapsed(again))
    return statistics.median(seconds)


def _elapsed(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


class Clock:
    """Wall time since it was made, split into phases of which exactly one runs at any moment.

    ``build``: models are built with their derivatives. ``solve``: the formulation runs. ``audit``: the
    assessment measures, the unit of cost included.
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
        """Build and solve so far: what the formulation itself has cost."""
        return self.seconds("build") + self._seconds["solve"]


@contextmanager
def deferred() -> Iterator[Callable[[], bool]]:
    """Defer a first Ctrl-C: yields a function that says whether there was one; a second one raises.

    Outside the main thread, and where Ctrl-C does not raise anyway, nothing changes.
    """
    pressed = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        if pressed:
            signal.default_int_handler(number, frame)
        pressed = True

    main = threading.current_thread() is threading.main_thread()
    raises = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if raises:
        signal.signal(signal.SIGINT, note)
    try:
        yield lambda: pressed
    finally:
        if raises:
            signal.signal(signal.SIGINT, signal.default_int_handler)


MEMORY = 12
"""Steps from which the time left is estimated."""

LONGEST = 86400.0
"""Longer estimates are not reported."""


class Falling:
    """Follows a quantity that falls in time about like a geometric sequence, until it is at ``target``."""

    def __init__(self, target: float) -> None:
        self._target = math.log10(target)
        self._last: deque[tuple[float, float]] = deque(maxlen=MEMORY)

    def __call__(self, seconds: float, value: float) -> None:
        """Note a value; one that is not positive and finite is passed over."""
        if math.isfinite(value) and value > 0:
            self._last.append((seconds, math.log10(value)))

    @property
    def seconds_left(self) -> float | None:
        """An estimate, as if it fell on as over the last steps; None where it does not, or few are known."""
        if len(self._last) < MEMORY // 2:
            return None
        seconds, logs = np.array(self._last).T
        if np.ptp(seconds) == 0:
            return None
        rate = np.polyfit(seconds - seconds[0], logs, 1)[0]
        left = (logs[-1] - self._target) / -rate if rate < 0 else math.inf
        return float(max(left, 0.0)) if left < LONGEST else None
