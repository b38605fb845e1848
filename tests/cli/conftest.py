"""The command line as a function."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from rmesh_nlp.cli import app


class Said(NamedTuple):
    """Exit code and what was printed."""

    code: int
    out: str
    err: str


Rmesh = Callable[..., Said]


@pytest.fixture
def rmesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Rmesh:
    """Runs a command line, and further arguments as they are, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)  # output is not a screen's

    def run(line: str, *more: str) -> Said:
        capsys.readouterr()
        code = app.run([*shlex.split(line), *more])
        return Said(code, *capsys.readouterr())

    return run
