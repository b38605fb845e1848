"""The command line: it prepares problems, solves them, and reports."""

from __future__ import annotations

import importlib
import os
import signal
from typing import Any

from rmesh_nlp.errors import Exit


def load(name: str) -> Any:
    """A module of the package, when it is needed; Ctrl-C meanwhile ends the process at once.

    Help needs no CasADi, a solve no pandas and no matplotlib; each takes as long to load as a small solve.
    """
    is_usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_usual:
        signal.signal(signal.SIGINT, _leave)
    module = importlib.import_module(f"rmesh_nlp.{name}")
    if is_usual:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return module


def _leave(*_: object) -> None:
    """An exception would come out of libraries that begin as some other one, with its traceback."""
    os.write(2, b"rmesh: interrupted\n")
    os._exit(Exit.INTERRUPTED)
