"""Ctrl-C while something is done that must not be lost: heeded when it is done."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def deferred() -> Iterator[Callable[[], bool]]:
    """Note a first Ctrl-C instead of raising KeyboardInterrupt; a second one raises.

    Yields a function that says whether there was one. Outside the main thread, and where Ctrl-C does not
    raise anyway, nothing changes.
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
