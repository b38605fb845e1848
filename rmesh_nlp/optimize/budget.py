"""Seconds and iterations that are left of a solve, and interruptions; nothing else looks at a clock."""

from __future__ import annotations

import math
import signal
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from types import FrameType
from typing import Any, Literal, TypeVar

from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import Limit, Seconds, Settings

T = TypeVar("T")

Phase = Literal["build", "solve", "audit"]

TIMING_SECONDS = 0.01
"""Time spent on measuring something short, which is repeated up to five times."""

LEAST_AUDIT = 0.1
"""Seconds that an audit may take whatever the limit: those of small meshes take less."""

LEAST_SECONDS = 1e-3
"""Given to a library that takes no limit of zero."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class Limits(Settings):
    """Limits of one solve, after which its best valid mesh is the solution.

    Attributes
    ----------
    seconds : float
        Of building, solving and the assessment together, looked at after each iteration. What the assessment
        needs is kept for it.
    iterations : int, optional
        Over everything that a formulation runs.
    """

    seconds: Seconds = 600.0
    iterations: Limit | None = None


class StoppedError(Exception):
    """Ends what runs: a limit is reached, or the user or a callback asked for it."""

    def __init__(self, status: Status = Status.INTERRUPTED) -> None:
        super().__init__(status.message)
        self.status = status


class Budget:
    """Seconds since it was made, and iterations that are counted, against limits.

    Time is split into phases of which exactly one runs at any moment. ``build``: models are built with their
    derivatives. ``solve``: the solver runs. ``audit``: the assessment measures.

    Parameters
    ----------
    limits : Limits, optional
        None by default: then it is a stopwatch.
    whole : Budget, optional
        Of which this is a share: where that is over, so is this.

    Attributes
    ----------
    iterations : int
        Counted so far, by who spends them.
    kept : float
        Seconds that what follows the solve will need.
    stopped : Status or None
        INTERRUPTED, TIME_LIMIT or ITERATION_LIMIT, once it is over.
    """

    def __init__(self, limits: Limits | None = None, whole: Budget | None = None) -> None:
        self.limits, self._whole = limits or Limits(math.inf), whole
        self.iterations, self.kept = 0, 0.0
        self.stopped: Status | None = None
        self._seconds: dict[Phase, float] = {"build": 0.0, "solve": 0.0, "audit": 0.0}
        self._phase: Phase = "build"
        self._since = time.perf_counter()

    def share(self, iterations: int | None = None) -> Budget:
        """A budget of what is left, of at most so many iterations, which counts its own."""
        limits = [most for most in (iterations, self.iterations_left) if most is not None]
        return Budget(Limits(math.inf, min(limits, default=None)), self)

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
        """Build and solve so far."""
        return self.seconds("build") + self._seconds["solve"]

    @property
    def remaining(self) -> float:
        """Seconds that are left, not negative."""
        own = max(0.0, self._left - self.kept)
        return own if self._whole is None else min(own, self._whole.remaining)

    @property
    def _left(self) -> float:
        return self.limits.seconds - self.elapsed - self._seconds["audit"]

    def keep(self, seconds: float) -> None:
        """Keep seconds for what follows an audit, which may take ``LEAST_AUDIT`` in any case."""
        self.kept = min(seconds, self._left - LEAST_AUDIT)

    @property
    def iterations_left(self) -> int | None:
        """Up to the limit; None without one."""
        most = self.limits.iterations
        return None if most is None else max(most - self.iterations, 0)

    def is_over(self) -> bool:
        """Whether it was stopped, or a limit is reached."""
        if self.stopped is None and self._whole is not None and self._whole.is_over():
            self.stopped = self._whole.stopped
        if self.stopped is None and self.remaining == 0.0:
            self.stopped = Status.TIME_LIMIT
        if self.stopped is None and self.iterations_left == 0:
            self.stopped = Status.ITERATION_LIMIT
        return self.stopped is not None

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Ctrl-C in this context stops it, also where the KeyboardInterrupt is lost.

        CasADi drops one that is raised while it looks at the attributes of what it is given.
        """

        def stop(number: int, frame: FrameType | None) -> None:
            self.stopped = Status.INTERRUPTED
            signal.default_int_handler(number, frame)

        with signals_to(stop):
            yield

    def check(self) -> None:
        """Raise a StoppedError if it is over."""
        if self.is_over():
            raise StoppedError(self.stopped or Status.INTERRUPTED)


_check: ContextVar[Callable[[], object]] = ContextVar("check", default=lambda: None)
"""That of the innermost :func:`checked`."""


def checked(check: Callable[[], object], work: Callable[[], T]) -> T:
    """The result of work whose long loops call ``check``, which raises a StoppedError to end them."""
    context = copy_context()
    context.run(_check.set, check)
    return context.run(work)


def checkpoint() -> None:
    """Raise a StoppedError where what runs is to end. Called before each factorisation, and in long loops."""
    _check.get()()


def timed(first: Callable[[], object], again: Callable[[], object]) -> float:
    """Wall time of ``first``; where it is short, or known already, the median with a few of ``again``."""
    seconds = [_elapsed(first)]
    while len(seconds) < 5 and sum(seconds) < TIMING_SECONDS:
        seconds.append(_elapsed(again))
    return statistics.median(seconds)


def _elapsed(work: Callable[[], object]) -> float:
    watch = Budget()
    work()
    return watch.elapsed


def processor_seconds() -> float:
    """Of this process so far."""
    return time.process_time()


_handlers: list[Any] = [signal.default_int_handler]
"""Those of the contexts of :func:`signals_to` after Python's own."""


@contextmanager
def signals_to(handle: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Give Ctrl-C and SIGTERM to ``handle`` where they would raise a KeyboardInterrupt in the main thread.

    Within another such context to the inner handler alone.
    """
    if threading.current_thread() is not threading.main_thread():  # only there may handlers be set
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    caught = [number for number, handler in before.items() if handler in _handlers]
    for number in caught:
        signal.signal(number, handle)
    _handlers.append(handle)
    try:
        yield
    finally:
        _handlers.pop()
        for number in caught:
            signal.signal(number, before[number])


@contextmanager
def deferred() -> Iterator[Callable[[], bool]]:
    """Defer a first Ctrl-C: yields a function that says whether there was one; a second one raises."""
    pressed = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        if pressed:
            signal.default_int_handler(number, frame)
        pressed = True

    with signals_to(note):
        yield lambda: pressed
