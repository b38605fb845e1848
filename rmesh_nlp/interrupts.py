"""Ctrl-C while a solver runs."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_CODE = 130
"""128 + SIGINT, what shells expect of an interrupted command."""


@contextmanager
def leaving_on_interrupt(farewell: Callable[[], None]) -> Iterator[None]:
    """End the process at once when Ctrl-C arrives in this context.

    CasADi swallows ``KeyboardInterrupt`` inside a solver and returns a failed status, after
    which a strategy would go on with its next program. The handler runs within Ipopt's
    evaluations, so that leaving from there is prompt; use it only around code that writes no
    files, and in programs of one's own, not in libraries or notebooks.
    """

    def leave(number: int, frame: FrameType | None) -> None:
        farewell()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(EXIT_CODE)

    before = signal.signal(signal.SIGINT, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
