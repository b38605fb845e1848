"""Rows of docs/notes/capabilities.md can be run as written; commands and scripts take minutes: not those."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.usefixtures("estimates_unasked")

ROOT = Path(__file__).parents[2]
FIRST, *SECTIONS = (ROOT / "docs" / "notes" / "capabilities.md").read_text(encoding="utf-8").split("\n## ")
SETUP = FIRST.split("```python\n")[1].split("```")[0]
ENTRIES = {"rmesh": "main", "rmesh-mpcc": "mpcc"}
BY_HAND = ("Commands", "Scripts")
REFUSED = "refused with a reason, in one line"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "section", [s for s in SECTIONS if not s.startswith(BY_HAND)], ids=lambda section: section.split("\n")[0]
)
def test_every_capability_is_shown_as_the_page_says(section, tmp_path, monkeypatch) -> None:
    """Rows of a section use what former ones defined."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(SETUP, names)
    failed = {}
    for capability, cell in re.findall(r"^\| (.+?) \| (`.+`.*) \|$", section, re.MULTILINE):
        for code in re.findall(r"`([^`]+)`", cell):
            try:
                run(code, names, 2 if capability == REFUSED else 0)
            except Exception as error:
                failed[code] = f"{type(error).__name__}: {error}"
    assert not failed


def run(code: str, names: dict[str, Any], expected: int) -> None:
    """A command, or Python; an option alone stands beside the command that it belongs to."""
    if code.startswith("--"):
        return
    if not code.startswith(("rmesh", "python ")):
        exec(code, names)
        return
    program, *words = shlex.split(code)
    if program in ENTRIES:
        words = ["-c", f"from rmesh_nlp.cli.entry import {ENTRIES[program]} as main; main()", *words]
    words = [str(ROOT / word) if word.startswith("scripts/") else word for word in words]
    said = subprocess.run([sys.executable, *words], capture_output=True, text=True)
    assert said.returncode == expected, said.stderr
