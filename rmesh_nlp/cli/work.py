"""The modules that do the work of the commands, each loaded only when one of its commands runs.

They bring CasADi and all, which ``rmesh --help`` does not need.
"""

from __future__ import annotations

import importlib
from types import ModuleType


def commands() -> ModuleType:
    """Examples and comparisons."""
    return importlib.import_module("rmesh_nlp.cli.commands")


def problem_commands() -> ModuleType:
    """Problem files."""
    return importlib.import_module("rmesh_nlp.cli.problem_commands")


def path_commands() -> ModuleType:
    """Load paths."""
    return importlib.import_module("rmesh_nlp.cli.path_commands")


def study_commands() -> ModuleType:
    """Studies, and what is made of their rows."""
    return importlib.import_module("rmesh_nlp.cli.study_commands")


def mpcc_commands() -> ModuleType:
    """The MPCC solver."""
    return importlib.import_module("rmesh_nlp.mpcc.__main__")
