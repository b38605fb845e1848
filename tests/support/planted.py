"""Strategies of a test's own, installed for processes that the test starts."""

from __future__ import annotations

from pathlib import Path

BAD = """
import os, time
from support.formulations import fixed

def hang(problem):
    while True:
        time.sleep(0.01)

def leak(problem):
    kept = []
    while True:
        kept.append(b"x" * 20_000_000)
        time.sleep(0.005)

def crash(problem):
    os.abort()

def crash_once(problem):
    mark = os.environ["CRASH_MARK"]
    if not os.path.exists(mark):
        open(mark, "w").close()
        os.abort()
    return fixed.solve(problem)
"""


def install(folder: Path) -> str:
    """Write a distribution with strategies ``hang``, ``leak``, ``crash``, ``crash_once``."""
    (folder / "bad_strategies.py").write_text(BAD)
    info = folder / "bad_strategies-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bad-strategies\nVersion: 1\n")
    names = ("hang", "leak", "crash", "crash_once")
    lines = "".join(f"{name} = bad_strategies:{name}\n" for name in names)
    (info / "entry_points.txt").write_text(f"[rmesh_nlp.formulations]\n{lines}")
    return str(folder)
