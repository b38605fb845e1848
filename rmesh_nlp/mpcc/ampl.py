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
from functools import partial
from pathlib import Path

from rmesh_nlp import __version__
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.reading import read_nl
from rmesh_nlp.mpcc.sol import message, write_sol
from rmesh_nlp.mpcc.solver import solve
from rmesh_nlp.settings import from_texts

VARIABLE = "rmesh_mpcc_options"
_FLAGS = ("-AMPL", "-s", "-v", "-=")
_WORDS = {"true": True, "yes": True, "false": False, "no": False, "none": None}


def is_meant(words: Sequence[str]) -> bool:
    """Whether the command is called as AMPL calls solvers."""
    return any(word in _FLAGS for word in words)


def run(words: Sequence[str]) -> int:
    """Solve ``stub.nl`` and write ``stub.sol``; 0 if it was written, whatever the solve ended with.

    Raises
    ------
    ValueError
        If the file or an option is wrong; no file is written then.
    OSError
        If a file cannot be read or written.
    """
    if "-v" in words:
        print(f"rmesh-mpcc {__version__}")
        return 0
    if "-=" in words:
        print("\n".join([*Options.names(), "ipopt.NAME", "outlev"]))
        return 0
    if unknown := [word for word in words if word.startswith("-") and word not in _FLAGS]:
        raise ValueError(f"unknown flag {unknown[0]!r}; there are {', '.join(_FLAGS)}")
    stub, *assignments = [word for word in words if not word.startswith("-")] or [""]
    if not stub:
        raise ValueError("no stub given: the model's file without .nl")
    texts = from_texts([*_assignments(os.environ.get(VARIABLE, "")), *assignments], "option ")
    given = {key: _WORDS.get(str(value).lower(), value) for key, value in texts.items()}
    # whoever reads a pipe sees each line at once
    show = False if given.pop("outlev", 1) == 0 else partial(print, flush=True)
    options = Options().having(given)
    stub = stub.removesuffix(".nl")
    problem = read_nl(Path(f"{stub}.nl"))
    result = solve(problem.mpcc, problem.x0, start=problem.start, options=options, progress=show)
    write_sol(Path(f"{stub}.sol"), problem, result)
    if "-AMPL" not in words:  # AMPL shows the message of the file
        print(message(problem, result))
    return 0


def _assignments(text: str) -> list[str]:
    """The options of the environment, ``key=value``, ``key = value`` or ``key value``, as ``key=value``."""
    words, assignments = iter(shlex.split(re.sub(r"\s*=\s*", "=", text))), []
    for word in words:
        assignments.append(word if "=" in word else f"{word}={next(words, '')}")
    return assignments
