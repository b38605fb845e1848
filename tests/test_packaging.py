"""What an installation offers, that imports go one way, and that the documents say what is true."""

from __future__ import annotations

import ast
import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rmesh_nlp
from rmesh_nlp.campaign import strategies
from rmesh_nlp.cli import app as cli
from rmesh_nlp.examples import EXAMPLES

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()


def imported(path: Path) -> set[str]:
    """Top-level names that a file imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add((node.module or "").split(".")[0])
    return names


@pytest.mark.parametrize(
    ("folder", "forbidden"),
    [
        ("rmesh_nlp", {"formulations", "scripts", "tests"}),
        ("formulations", {"scripts", "tests"}),
        ("scripts", {"tests"}),
    ],
)
def test_imports_go_one_way(folder: str, forbidden: set[str]) -> None:
    paths = sorted((ROOT / folder).rglob("*.py"))
    assert paths
    for path in paths:
        assert not imported(path) & forbidden, path


def test_the_library_loads_no_strategy() -> None:
    code = "import sys, rmesh_nlp.cli.commands; print('formulations' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_the_strategies_are_entry_points() -> None:
    found = strategies.available()
    for name in ("fixed", "nested", "joint", "mpcc", "auto"):
        assert found[name].value == f"formulations.{name}:solve"


def test_there_is_one_version() -> None:
    assert importlib.metadata.version("rmesh-nlp") == rmesh_nlp.__version__
    assert f"version: {rmesh_nlp.__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_the_command_is_installed() -> None:
    (entry,) = importlib.metadata.entry_points(group="console_scripts", name="rmesh")
    assert entry.load() is cli.main


def test_the_readme_has_the_two_commands_of_the_set_up() -> None:
    lines = README.splitlines()
    assert "python -m pip install -e . && rmesh compare" in lines
    assert "python -m pip install -e '.[test]' && python -m pytest" in lines
    picture = re.search(r"!\[.*\]\((\S+)\)", README)
    assert picture is not None
    assert (ROOT / picture[1]).read_bytes().startswith(b"\x89PNG")


def test_the_commands_of_the_readme_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line is read by the command line as it stands, up to the work itself."""
    called = []

    class Nothing:
        def __getattr__(self, name: str) -> object:
            return lambda *arguments: called.append(name) or 0

    monkeypatch.setattr(cli, "_commands", Nothing)
    monkeypatch.setattr(cli, "_problem_commands", Nothing)
    lines = [line.split("#")[0].split() for line in README.splitlines() if line.startswith("rmesh ")]
    assert len(lines) >= 5
    for words in lines:
        assert cli.run(words[1:]) == 0, words
    assert set(called) == {"solve", "compare", "table", "figures", "new", "check"}


def python_blocks(name: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(), re.S)


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # it writes files
    space: dict[str, object] = {}
    for block in python_blocks("README.md"):
        exec(block, space)
    assert "problem" in space


def test_the_strategy_of_contributing_runs() -> None:
    (block,) = python_blocks("CONTRIBUTING.md")
    space: dict[str, object] = {}
    exec(block, space)
    solution = space["solve"](EXAMPLES["6.1"](n=4), seed=1)  # type: ignore[operator]
    assert solution.success
    assert solution.formulation == "random"
    assert len(solution.history) == 10


def test_the_folders_that_the_readme_names_exist() -> None:
    section = README.split("## How the code is laid out")[1].split("\n## ")[0]
    names = re.findall(r"^\| .*", section, re.M)
    folders = re.findall(r"`(\w+(?:/\w+)*/)`", " ".join(names))
    assert folders
    for name in folders:
        assert (ROOT / name).is_dir(), name
