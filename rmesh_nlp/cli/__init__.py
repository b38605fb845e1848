"""The command line: it prepares problems, solves them, and reports.

Here, and in what is imported before ``entry.main`` runs, stands little: Ctrl-C meanwhile is a traceback.
"""

from __future__ import annotations

import importlib
import os
import signal
from collections.abc import Callable
from enum import IntEnum
from types import ModuleType


class Exit(IntEnum):
    """Exit codes of commands."""

    SUCCESS = 0
    NO_SUCCESS = 1
    BAD_INPUT = 2
    INTERRUPTED = 130


def load(name: str) -> ModuleType:
    """A module of the package, when it is needed; Ctrl-C or SIGTERM meanwhile ends the process at once.

    Help needs no CasADi, a solve no pandas and no matplotlib; each takes as long to load as a small solve.
    """
    hand_over(leave)
    module = importlib.import_module(f"rmesh_nlp.{name}")
    hand_over(signal.default_int_handler, leave)
    return module


def hand_over(
    handler: Callable[..., object], before: Callable[..., object] = signal.default_int_handler
) -> None:
    """Give Ctrl-C and SIGTERM to a handler where another one has them, and they are not ignored."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is before:
            signal.signal(number, handler)


def leave(*_: object) -> None:
    """An exception would come out of libraries that begin as some other one, with its traceback."""
    os.write(2, b"rmesh: interrupted\n")
    os._exit(Exit.INTERRUPTED)
