"""Which tests execute which lines, recorded once and kept."""

from __future__ import annotations

import difflib
import json
import os
import sys
import time
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from coverage import Coverage
from mutation import Mutant

PYTEST = ("-n", "0", "-q", "-m", "not slow", "-p", "no:cacheprovider", "-p", "no:randomly")


@dataclass(frozen=True)
class Reach:
    """Which tests execute which lines.

    Attributes
    ----------
    lines : dict of str to dict of int to list of str
        Tests by file and line.
    seconds : dict of str to float
        By test.
    """

    lines: Mapping[str, Mapping[int, Sequence[str]]]
    seconds: Mapping[str, float]
    root: Path = Path()

    def tests(self, mutant: Mutant, budget: float) -> list[str]:
        """Those that reach the mutant's line, else its file: the shortest of them.

        First come those of the file named after the module, then those of files that import it, then those of
        its own wing.

        They run in the order in which they were collected: some share files that the ones before made.
        """
        lines = self.lines.get(mutant.path, {})
        own = {test for line in range(mutant.line, mutant.last_line + 1) for test in lines.get(line, ())}
        of_the_file = {test for tests in lines.values() for test in tests}
        total = 0.0
        chosen: list[str] = []
        wing = f"tests/{Path(mutant.path).parts[1]}/"
        module, name = mutant.path.removesuffix(".py").replace("/", "."), Path(mutant.path).stem
        imports = {
            file: (self.root / file).exists() and f"from {module} import" in (self.root / file).read_text()
            for file in {test.partition("::")[0] for test in own or of_the_file}
        }

        def order(test: str) -> tuple[bool, bool, bool, float]:
            file = test.partition("::")[0]
            named = Path(file).name == f"test_{name}.py"
            return not named, not imports[file], not test.startswith(wing), self.seconds[test]

        for test in sorted(own or of_the_file, key=order):
            total += self.seconds[test]
            if total > budget and chosen:
                break
            chosen.append(test)
        place = {test: number for number, test in enumerate(self.seconds)}
        return sorted(chosen, key=lambda test: (not test.startswith(wing), place[test]))


class _Recorder:
    """A pytest plugin: the context of coverage is the test that runs; known tests do not run."""

    def __init__(self, coverage: Coverage, known: Collection[str]) -> None:
        self.coverage, self.known = coverage, known
        self.seconds: dict[str, float] = defaultdict(float)
        self.collected: set[str] = set()
        self._began = 0.0

    @pytest.hookimpl(trylast=True)  # without those that their marks deselect
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        self.collected = {item.nodeid for item in items}
        items[:] = [item for item in items if item.nodeid not in self.known]

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.coverage.switch_context(nodeid)
        self._began = time.process_time()

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.seconds[nodeid] = time.process_time() - self._began


def enter(checkout: Path) -> None:
    """Work in a copy from now on: its package is the one that is imported."""
    os.chdir(checkout)
    sys.path.insert(0, str(checkout))
    os.environ["PYTHONPATH"] = str(checkout)
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True


def record_reach(checkout: Path, target: Path, again: Sequence[str] = ()) -> None:
    """Run the quick tests that the file lacks under coverage, and add them; tests that are gone are left out.

    With ``again``, files of tests, only those are run, anew.
    """
    enter(checkout)
    old = json.loads(target.read_text()) if target.exists() else {"lines": {}, "seconds": {}, "sources": {}}
    known = {test for test in old["seconds"] if not test.startswith(tuple(again) or "-")}
    coverage = Coverage(source=[str(checkout / "rmesh_nlp")], data_file=None)
    recorder = _Recorder(coverage, known)
    coverage.start()
    pytest.main([*PYTEST, *(again or ["tests"])], plugins=[recorder])
    coverage.stop()
    if not again:
        known &= recorder.collected
    data = coverage.get_data()
    names = {str(Path(name).relative_to(checkout)): name for name in data.measured_files()}
    lines: dict[str, dict[int, list[str]]] = {}
    sources = {
        path: (checkout / path).read_text() for path in {*names, *old["lines"]} if (checkout / path).exists()
    }
    for path, text in sources.items():
        found = {line: set(tests) & known for line, tests in _moved(old, path, text).items()}
        for line, tests in data.contexts_by_lineno(names[path]).items() if path in names else ():
            found[line] = found.get(line, set()) | {test for test in tests if test}
        lines[path] = {line: sorted(tests) for line, tests in found.items() if tests}
    seconds = {test: spent for test, spent in old["seconds"].items() if test in known} | recorder.seconds
    target.write_text(json.dumps({"lines": lines, "seconds": seconds, "sources": sources}))


def read_reach(path: Path, root: Path) -> Reach:
    """What `record_reach` wrote, with the line numbers of the files as they are now."""
    found = json.loads(path.read_text())
    lines = {
        name: _moved(found, name, (root / name).read_text())
        for name in found["lines"]
        if (root / name).exists()
    }
    return Reach(lines, found["seconds"], root)


def _moved(found: Any, path: str, text: str) -> dict[int, list[str]]:
    """Tests by line of a file that has changed since; of a new line those of the lines around it."""
    lines = {int(line): tests for line, tests in found["lines"].get(path, {}).items()}
    old, new = found["sources"].get(path, text).splitlines(), text.splitlines()
    if old == new:
        return lines
    moved: dict[int, list[str]] = {}
    for kind, a, b, c, d in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if kind == "equal":
            moved |= {line + c - a: lines[line] for line in range(a + 1, b + 1) if line in lines}
        else:
            near = sorted({test for line in range(a, b + 2) for test in lines.get(line, ())})
            moved |= dict.fromkeys(range(c + 1, d + 1), near) if near else {}
    return moved
