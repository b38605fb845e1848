"""The command line: it prepares problems, solves them, and reports."""

from __future__ import annotations

import importlib
from typing import Any


def load(name: str) -> Any:
    """A module of the package, when it is needed.

    Help needs no CasADi, a solve no pandas and no matplotlib; each takes as long to load as a small solve.
    """
    return importlib.import_module(f"rmesh_nlp.{name}")
