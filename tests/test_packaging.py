"""What an installation offers, that imports go one way, and that the documents say what is true."""

import importlib.metadata
import inspect
import re
import runpy
import shlex
import sys
from pathlib import Path
from typing import Any

import grimp
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

import rmesh_nlp
from rmesh_nlp.cli import app as cli
from rmesh_nlp.cli import commands, entry
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.io.problem_file import read_table
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.formulation import available, find

pytestmark = pytest.mark.usefixtures("estimates_unasked")

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_no_imports_go_in_a_circle() -> None:
    """Nor those for types alone; import-linter's layers hold it between sub-packages, not within one."""
    graph = grimp.build_graph("rmesh_nlp", "formulations", cache_dir=None)
    modules = sorted(graph.modules)
    number = {name: i for i, name in enumerate(modules)}
    found = [(number[a], number[b]) for a in modules for b in graph.find_modules_directly_imported_by(a)]
    assert len(found) > len(modules)
    matrix = sp.coo_array((np.ones(len(found)), np.array(found).T), shape=(len(modules),) * 2)
    _, circle = connected_components(matrix, directed=True, connection="strong")
    together = [name for name, one in zip(modules, circle, strict=True) if np.sum(circle == one) > 1]
    assert together == []


def test_an_installation_has_one_version_the_command_and_the_formulations() -> None:
    assert importlib.metadata.version("rmesh-nlp") == rmesh_nlp.__version__
    assert f"version: {rmesh_nlp.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    (entry_point,) = importlib.metadata.entry_points(group="console_scripts", name="rmesh")
    assert entry_point.load() is entry.main
    for name in ("fixed", "nested", "joint", "mpcc", "cascade", "auto"):
        assert available()[name].value.startswith(f"formulations.{name}:")
        assert find(name)().name == name


PAGES = ("README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))


def prose(page: Path) -> str:
    """Without code."""
    return re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(), flags=re.S)


def anchors(page: Path) -> set[str]:
    """As a repository's view makes them of headings; Sphinx does of those of the first three levels."""
    titles = re.findall(r"^#{1,3} (.*)", re.sub(r"```.*?```", "", page.read_text(), flags=re.S), re.M)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def test_links_of_the_pages_lead_somewhere_and_each_page_is_once_in_the_menu(monkeypatch):
    for page in (*PAGES, "CHANGELOG.md", "CONTRIBUTING.md"):
        for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)", prose(ROOT / page)):
            if "://" not in target:
                file = (ROOT / page).parent / target if target else ROOT / page
                assert file.exists(), f"{page}: {target}"
                assert not anchor or anchor in anchors(file), f"{page}: {target}#{anchor}"
    monkeypatch.setattr(sys, "path", list(sys.path))
    below = runpy.run_path(str(ROOT / "docs/conf.py"))["BELOW"]
    pages = [Path(page).stem for page in PAGES if page not in ("README.md", "docs/index.md")]
    assert sorted(name for names in below.values() for name in names) == sorted([*pages, "gallery/index"])


def test_the_commands_of_the_pages_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line is read by the command line as it stands, up to the work itself."""

    class Nothing:
        def __getattr__(self, name: str) -> object:
            return lambda *arguments, **keywords: 0

    monkeypatch.setattr(commands, "load", lambda name: Nothing())
    found = [line for page in PAGES for line in re.findall(r"^rmesh .*", (ROOT / page).read_text(), re.M)]
    lines = {tuple(shlex.split(line, comments=True)) for line in found}
    assert len(lines) > 30
    for _, *arguments in lines:
        assert cli.run(arguments) == 0, arguments


def python_blocks(name: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(), re.S)


def toml_blocks(name: str) -> list[str]:
    return re.findall(r"```toml\n(.*?)```", (ROOT / name).read_text(), re.S)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if python_blocks(page)])
def test_the_python_of_the_readme_and_the_pages_runs(page, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)  # it writes files
    Path("my.toml").write_text(toml_blocks("README.md")[0])
    space: dict[str, object] = {}
    for block in python_blocks(page):
        exec(block, space)


TWICE = ("README.md", "docs/own_problems.md")
"""Pages that state one problem in Python and as a file."""


def stated_twice(page: str, folder: Path) -> tuple[ContactProblem, str, Path]:
    """The problem and formulation of the first Python block with a solve, and the first file."""
    block = next(block for block in python_blocks(page) if "rm.solve(" in block)
    statement, rest = block.split("solution = rm.solve(", 1)
    space: dict[str, Any] = {}
    exec(statement, space)
    named = re.match(r"problem(?:, \"(\w+)\")?\)", rest)
    _, formulation, *_ = inspect.signature(rmesh_nlp.solve).parameters.values()
    (folder / "block.toml").write_text(toml_blocks(page)[0])
    return space["problem"], named[1] or formulation.default, folder / "block.toml"


@pytest.mark.parametrize("page", TWICE)
def test_file_of_a_page_is_the_problem_of_its_python(page: str, tmp_path: Path) -> None:
    problem, formulation, path = stated_twice(page, tmp_path)
    other = rmesh_nlp.read_problem(path)
    assert read_table(path).solve.formulation == formulation
    np.testing.assert_array_equal(other.mesh.p, problem.mesh.p)
    np.testing.assert_array_equal(other.mesh.t, problem.mesh.t)
    for name in ("law", "supports", "motion", "rule", "point_loads"):
        assert getattr(other, name) == getattr(problem, name), name
    assert other.obstacle.gap == problem.obstacle.gap
    both = [ContactSolver(one).given for one in (other, problem)]
    assert both[0].energy == pytest.approx(both[1].energy, rel=1e-12)
    np.testing.assert_allclose(both[0].normal_force, both[1].normal_force, rtol=1e-9, atol=1e-9)
