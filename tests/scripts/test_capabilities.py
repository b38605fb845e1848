"""Every row of docs/notes/capabilities.md can be run as it is written."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from support.nl_files import NL

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "notes" / "capabilities.md").read_text(encoding="utf-8")
FIRST = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0]
ROWS = re.findall(r"^\| (.+?) \| (`.+`.*) \|$", PAGE, re.MULTILINE)
ENTRIES = {"rmesh": "main", "rmesh-mpcc": "mpcc"}
REFUSED = "refused with a reason, in one line"


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory):
    """What rows have defined so far, in a folder that has a problem in AMPL's format."""
    before, known = Path.cwd(), {}
    os.chdir(tmp_path_factory.mktemp("capabilities"))
    Path("problem.nl").write_text(NL)
    exec(FIRST, known)
    yield known
    os.chdir(before)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_capability_is_shown_as_the_page_says(row, names) -> None:
    capability, cell = row
    for code in re.findall(r"`([^`]+)`", cell):
        if code.startswith("--"):
            continue
        if not code.startswith(("rmesh ", "rmesh-mpcc ", "python ")):
            exec(code, names)
            continue
        program, *words = shlex.split(code)
        start = (
            ["-c", f"from rmesh_nlp.cli.entry import {ENTRIES[program]} as main; main()"]
            if program in ENTRIES
            else []
        )
        words = [str(ROOT / word) if word.startswith("scripts/") else word for word in words]
        said = subprocess.run([sys.executable, *start, *words], capture_output=True, text=True)
        assert said.returncode == (2 if capability == REFUSED else 0), said.stderr
