"""The command as AMPL, Pyomo and JuMP call solvers: ``rmesh-mpcc stub -AMPL key=value ...``.

It reads ``stub.nl`` and writes ``stub.sol``. Options are ``key=value``, first those of the environment
variable ``rmesh_mpcc_options``, then those of the command line: fields of :class:`rmesh_nlp.mpcc.Options`,
``ipopt.NAME``, and ``outlev=0`` for no output. ``-s`` in place of ``-AMPL`` shows the message too, ``-v`` the
version, ``-=`` the names of the options.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

from rmesh_nlp import __version__
from rmesh_nlp.mpcc.options import Options, with_ipopt
from rmesh_nlp.mpcc.reading import read_nl
from rmesh_nlp.mpcc.sol import message, write_sol
from rmesh_nlp.mpcc.solver import solve

VARIABLE = "rmesh_mpcc_options"
_FLAGS = ("-AMPL", "-s", "-v", "-=")
_WORDS = {"true": True, "yes": True, "false": False, "no": False, "none": None}
_NOT_TEXT = ("ipopt_relaxed", "ipopt_exact", "ipopt_warm")
"""Options that a word cannot say."""


def is_meant(arguments: Sequence[str]) -> bool:
    """Whether the command is called as AMPL calls solvers."""
    return any(argument in _FLAGS for argument in arguments)


def run(arguments: Sequence[str]) -> int:
    """Solve ``stub.nl`` and write ``stub.sol``; 0 if it was written, whatever the solve ended with.

    Raises
    ------
    ValueError
        If the file or an option is wrong; no file is written then.
    OSError
        If a file cannot be read or written.
    """
    if "-v" in arguments:
        print(f"rmesh-mpcc {__version__}")
        return 0
    if "-=" in arguments:
        print("\n".join([*_keys(), "outlev", "ipopt.NAME"]))
        return 0
    flags = [argument for argument in arguments if argument.startswith("-")]
    stub, *assignments = [argument for argument in arguments if not argument.startswith("-")] or [""]
    unknown = [flag for flag in flags if flag not in _FLAGS]
    if unknown:
        raise ValueError(f"unknown flag {unknown[0]!r}; there are {', '.join(_FLAGS)}")
    if not stub:
        raise ValueError("no stub given: the model's file without .nl")
    options, level = _options([*_assignments(os.environ.get(VARIABLE, "")), *assignments])
    stub = stub.removesuffix(".nl")
    problem = read_nl(Path(f"{stub}.nl"))
    show = partial(print, flush=True) if level > 0 else False  # whoever reads a pipe sees each line at once
    result = solve(problem.mpcc, problem.x0, options=options, progress=show)
    write_sol(Path(f"{stub}.sol"), problem, result)
    if "-AMPL" not in arguments:  # AMPL shows the message of the file
        print(message(problem, result))
    return 0


def _assignments(text: str) -> list[str]:
    """The options of the environment, ``key=value``, ``key = value`` or ``key value``, as ``key=value``."""
    words, assignments = iter(shlex.split(re.sub(r"\s*=\s*", "=", text))), []
    for word in words:
        assignments.append(word if "=" in word else f"{word}={next(words, '')}")
    return assignments


def _keys() -> list[str]:
    return [option.name for option in fields(Options) if option.name not in _NOT_TEXT]


def _options(words: Sequence[str]) -> tuple[Options, int]:
    """The options of the solver and the level of output, from ``key=value``; later ones hold."""
    given: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not (key and equals):
            raise ValueError(f"option {word!r} is not of the form key=value")
        if key not in (*_keys(), "outlev") and not key.startswith("ipopt."):
            keys = ", ".join(_keys())
            raise ValueError(f"unknown option {key!r}; there are {keys}, outlev, and ipopt.{key} for Ipopt's")
        given[key] = _value(text)
    level = given.pop("outlev", 1)
    if not isinstance(level, int):
        raise ValueError(f"outlev must be 0 (quiet) or 1 (a line per NLP), got {level!r}")
    return Options().having(with_ipopt(given)), level


def _value(text: str) -> Any:
    """A word as a whole number, a number, true or false, or text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return _WORDS.get(text.lower(), text)
