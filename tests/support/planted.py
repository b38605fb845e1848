"""Formulations of a test's own: planted in this process, or installed for those that a test starts."""

from dataclasses import dataclass
from pathlib import Path

import pytest

import rmesh_nlp as rm
from formulations.fixed import Fixed
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.solving import formulation


@dataclass(frozen=True)
class Entry:
    """An entry point of a class that is here already."""

    name: str
    kind: type[rm.Formulation]
    value: str = "planted"

    def load(self) -> type[rm.Formulation]:
        return self.kind


def plant(monkeypatch: pytest.MonkeyPatch, **kinds: type[rm.Formulation]) -> None:
    """Add formulations by name, as entry points would; one that is installed is replaced."""
    installed = formulation.entry_points

    def entries(group: str) -> list[Entry]:
        own = kinds if group == formulation.GROUP else {}
        kept = [entry for entry in installed(group=group) if entry.name not in own]
        return [*kept, *(Entry(name, kind) for name, kind in own.items())]

    monkeypatch.setattr(formulation, "entry_points", entries)


def raising(error: Exception) -> type[rm.Formulation]:
    """A formulation that fails before anything is built."""

    class Raising(Fixed):
        def accepts(self, problem: rm.ContactProblem, objective: Objective) -> None:
            raise error

    return Raising


BAD = """
import os, time
from formulations.fixed import Fixed

class Hang(Fixed):
    def run(self, outer, q, monitor):
        while True:
            time.sleep(0.01)

class Leak(Fixed):
    def run(self, outer, q, monitor):
        kept = []
        while True:
            kept.append(b"x" * 20_000_000)
            time.sleep(0.005)

class Crash(Fixed):
    def run(self, outer, q, monitor):
        os.abort()

class CrashOnce(Fixed):
    def run(self, outer, q, monitor):
        mark = os.environ["CRASH_MARK"]
        if not os.path.exists(mark):
            open(mark, "w").close()
            os.abort()
        return super().run(outer, q, monitor)
"""


def install(folder: Path) -> str:
    """Write a distribution with formulations ``hang``, ``leak``, ``crash``, ``crash_once``."""
    (folder / "bad_formulations.py").write_text(BAD)
    info = folder / "bad_formulations-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bad-formulations\nVersion: 1\n")
    kinds = {"hang": "Hang", "leak": "Leak", "crash": "Crash", "crash_once": "CrashOnce"}
    lines = "".join(f"{name} = bad_formulations:{kind}\n" for name, kind in kinds.items())
    (info / "entry_points.txt").write_text(f"[rmesh_nlp.formulations]\n{lines}")
    return str(folder)
