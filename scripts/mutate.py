"""Do the tests notice when the code is wrong? Change one thing at a time, and run them.

python scripts/mutate.py --sample 30                     of all modules below, drawn with a seed
python scripts/mutate.py rmesh_nlp/solution/audit.py     all mutants of one file
python scripts/mutate.py rmesh_nlp/solution/audit.py:74  of one line
python scripts/mutate.py --list rmesh_nlp/fem/stress.py  what they are

Each mutant is a copy of the checkout in a temporary folder with one change of one line: a comparison or
an arithmetic operator turned, a number changed, a condition negated, an argument of ``min`` and
``max`` swapped. First all quick tests run once under coverage (``pip install coverage``; ``--map FILE``
keeps what it found), then for each mutant the tests that reach its line, the shortest first, until one
fails. Numbers at the top of a module are reached by every test of the module.
A mutant that no test notices survives and is printed as a difference; the exit code is 1 if more than a
tenth do. Some survivors are equivalent to the original, which no test can tell: see
``docs/notes/mutations.md``.

mutmut 3 works in the same way but leaves numbers at the top of a module alone, and tolerances stand there.
"""

from __future__ import annotations

import argparse
import ast
import copy
import difflib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import connection, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest
from coverage import Coverage

ROOT = Path(__file__).resolve().parent.parent

MODULES = (
    "rmesh_nlp/solution/audit.py",
    "rmesh_nlp/solution/referee.py",
    "rmesh_nlp/solution/solution.py",
    "rmesh_nlp/solution/verdict.py",
    "rmesh_nlp/solution/starts.py",
    "rmesh_nlp/solution/verification.py",
    "rmesh_nlp/programs/reduced.py",
    "rmesh_nlp/contact/sensitivity.py",
    "rmesh_nlp/fem/stress.py",
    "rmesh_nlp/fem/quantities.py",
    "rmesh_nlp/fem/contact_pressure.py",
    "rmesh_nlp/fem/objective_text.py",
    "rmesh_nlp/io/results.py",
    "rmesh_nlp/io/export.py",
    "rmesh_nlp/campaign/run.py",
    "rmesh_nlp/campaign/cases.py",
    "rmesh_nlp/report/columns.py",
    "rmesh_nlp/report/blocks.py",
    "rmesh_nlp/report/stresses.py",
    "rmesh_nlp/mpcc/solver.py",
    "rmesh_nlp/mpcc/homotopy.py",
    "rmesh_nlp/mpcc/finish.py",
    "rmesh_nlp/mpcc/stationarity.py",
    "rmesh_nlp/mpcc/result.py",
)
"""What makes results trustworthy."""

COMPARISONS = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
CALLS = {"min": "max", "max": "min", "any": "all", "all": "any", "argmin": "argmax", "argmax": "argmin"}


@dataclass(frozen=True)
class Mutant:
    """One changed line.

    Attributes
    ----------
    path : str
        Of the file, relative to the checkout.
    line, last_line : int
        Of the change.
    source : str
        The whole file with the change.
    difference : str
    """

    path: str
    line: int
    last_line: int
    source: str
    difference: str


def mutants(path: str, text: str) -> list[Mutant]:
    """All mutants of a file; annotations, docstrings and messages of errors are left alone."""
    tree = ast.parse(text)
    lines = text.splitlines(keepends=True)
    found = []
    for node in _code(tree):
        for changed in _changes(node):
            start, end = node.lineno - 1, node.end_lineno or node.lineno
            before = "".join(lines[start:end]).encode()
            head, tail = before[: node.col_offset], _after(lines, node)
            new = head.decode() + ast.unparse(changed) + tail
            source = "".join(lines[:start]) + new + "".join(lines[end:])
            if source == text:
                continue
            difference = "".join(
                line
                for line in difflib.unified_diff(lines, source.splitlines(keepends=True), path, path, n=0)
                if not line.startswith(("---", "+++"))
            )
            found.append(Mutant(path, node.lineno, end, source, difference))
    return found


def _after(lines: Sequence[str], node: ast.expr) -> str:
    last = lines[(node.end_lineno or node.lineno) - 1].encode()
    return last[node.end_col_offset :].decode()


def _code(tree: ast.AST) -> Iterator[ast.expr]:
    """Expressions that compute something."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, (ast.Raise, ast.JoinedStr, ast.arg)):
            continue
        if isinstance(child, ast.AnnAssign):
            if child.value is not None:
                yield from _code(ast.Expression(child.value))
            continue
        if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
            for part in child.body:
                yield from _code(ast.Module([part], []))
            continue
        if isinstance(child, ast.expr):
            yield child
        yield from _code(child)


def _changes(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARISONS:
        yield _with(node, ops=[COMPARISONS[type(node.ops[0])]()])
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS and not _is_text(node):
        yield _bracketed(_with(node, op=OPERATORS[type(node.op)]()))
    elif isinstance(node, ast.BoolOp):
        yield _bracketed(_with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And()))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        if isinstance(node.value, float) and 0 < abs(node.value) < 0.1:
            yield ast.Constant(node.value * 1e4)
        else:
            yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Call) and isinstance(node.func, (ast.Name, ast.Attribute)):
        name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
        if name in CALLS:
            key = "id" if isinstance(node.func, ast.Name) else "attr"
            yield _with(node, func=_with(node.func, **{key: CALLS[name]}))


def _with(node: ast.expr, **fields: object) -> ast.expr:
    changed = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _bracketed(node: ast.expr) -> ast.expr:
    """The expression in brackets: it may stand inside another one."""
    return ast.Name(f"({ast.unparse(node)})")


def _is_text(node: ast.BinOp) -> bool:
    """Whether text is joined, or a type is stated."""
    sides = (node.left, node.right)
    return any(
        isinstance(side, ast.JoinedStr)
        or (isinstance(side, ast.Constant) and (isinstance(side.value, str) or side.value is None))
        for side in sides
    )


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

    lines: dict[str, dict[int, list[str]]]
    seconds: dict[str, float]

    def tests(self, mutant: Mutant, budget: float) -> list[str]:
        """Those that reach the mutant's line, else its file: those of its own wing first, then by time."""
        lines = self.lines.get(mutant.path, {})
        own = {test for line in range(mutant.line, mutant.last_line + 1) for test in lines.get(line, ())}
        of_the_file = {test for tests in lines.values() for test in tests}
        total = 0.0
        chosen: list[str] = []
        wing = f"tests/{Path(mutant.path).parts[1]}/"
        for test in sorted(own or of_the_file, key=lambda t: (not t.startswith(wing), self.seconds[t])):
            total += self.seconds[test]
            if total > budget and chosen:
                break
            chosen.append(test)
        return chosen


class _Recorder:
    """A pytest plugin: the context of coverage is the test that runs."""

    def __init__(self, coverage: Coverage) -> None:
        self.coverage = coverage
        self.seconds: dict[str, float] = defaultdict(float)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.coverage.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] += report.duration


SLOW_IMPORTS = ("casadi", "hypothesis", "matplotlib.pyplot", "meshio", "pandas", "pydantic", "skfem", "typer")
"""Loaded once, before a process is forked for each mutant; never this package itself."""

PYTEST = ("-n", "0", "-q", "-m", "not slow", "-p", "no:cacheprovider", "-p", "no:randomly")


def enter(checkout: Path) -> None:
    """Work in a copy from now on: its package is the one that is imported."""
    os.chdir(checkout)
    sys.path.insert(0, str(checkout))
    os.environ["PYTHONPATH"] = str(checkout)
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True


def record_reach(checkout: Path, tests: Sequence[str], target: Path) -> None:
    """Run the quick tests once under coverage; write a `Reach` as JSON."""
    enter(checkout)
    coverage = Coverage(source=[str(checkout / "rmesh_nlp")], data_file=None)
    recorder = _Recorder(coverage)
    coverage.start()
    pytest.main([*PYTEST, *tests], plugins=[recorder])
    coverage.stop()
    data = coverage.get_data()
    lines = {
        str(Path(name).relative_to(checkout)): {
            line: [test for test in found if test] for line, found in data.contexts_by_lineno(name).items()
        }
        for name in data.measured_files()
    }
    target.write_text(json.dumps({"lines": lines, "seconds": recorder.seconds}))


def read_reach(path: Path) -> Reach:
    """What `record_reach` wrote."""
    found = json.loads(path.read_text())
    lines = {
        name: {int(line): tests for line, tests in of_the_file.items()}
        for name, of_the_file in found["lines"].items()
    }
    return Reach(lines, found["seconds"])


def try_mutant(mutant: Mutant, checkout: Path, tests: Sequence[str], seconds: int) -> None:
    """Run ``tests`` in this process on a mutant; it ends with pytest's code, or by an alarm."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(seconds)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    enter(checkout)
    (checkout / mutant.path).write_text(mutant.source)
    os._exit(pytest.main([*PYTEST, "-x", *tests]))


def survivors(
    chosen: Sequence[Mutant], reach: Reach, folder: Path, jobs: int, seconds: float
) -> Iterator[tuple[Mutant, bool]]:
    """Each mutant and whether it survives, ``jobs`` at a time, each in a process and a copy of its own."""
    for name in SLOW_IMPORTS:
        import_module(name)
    context = get_context("fork")
    free = [_copy(folder / f"checkout-{job}") for job in range(jobs)]
    running: dict[int, tuple[BaseProcess, Mutant, Path]] = {}
    waiting = list(reversed(chosen))
    while waiting or running:
        while waiting and free:
            mutant = waiting.pop()
            tests = reach.tests(mutant, seconds)
            if not tests:
                yield mutant, True
                continue
            limit = int(30 + 5 * sum(reach.seconds[test] for test in tests))
            process = context.Process(target=try_mutant, args=(mutant, checkout := free.pop(), tests, limit))
            process.start()
            running[process.sentinel] = process, mutant, checkout
        for sentinel in connection.wait(list(running)) if running else ():
            assert isinstance(sentinel, int)
            ended, mutant, checkout = running.pop(sentinel)
            ended.join()
            (checkout / mutant.path).write_text((ROOT / mutant.path).read_text())
            free.append(checkout)
            yield mutant, ended.exitcode == 0


def _copy(target: Path) -> Path:
    ignored = shutil.ignore_patterns(".git", "__pycache__", "*.egg-info", ".*_cache", "results", "_build")
    shutil.copytree(ROOT, target, ignore=ignored)
    return target


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw mutants, run the tests on each, and print the survivors."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "files", nargs="*", help="files of the package, or FILE:LINE; default: those listed here"
    )
    parser.add_argument("--sample", type=int, help="so many mutants, drawn at random; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="mutants at a time")
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests per mutant, at most")
    parser.add_argument("--map", type=Path, help="file with the lines that tests reach; written if missing")
    parser.add_argument("--tests", nargs="*", default=["tests"], help="for the map")
    parser.add_argument("--list", action="store_true", help="print the mutants, run nothing")
    options = parser.parse_args(arguments)
    chosen = []
    for name in options.files or MODULES:
        path, _, line = name.partition(":")
        if not (ROOT / path).is_file():
            parser.error(f"{path} is not a file of this checkout")
        chosen += [m for m in mutants(path, (ROOT / path).read_text()) if line in ("", str(m.line))]
    if options.sample is not None and options.sample < len(chosen):
        chosen = random.Random(options.seed).sample(chosen, options.sample)
    if options.list:
        for mutant in chosen:
            print(f"{mutant.path}:{mutant.line}\n{mutant.difference}")
        return 0
    count = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        reached = (options.map or folder / "reach.json").absolute()
        if not reached.exists():
            arguments_of = (_copy(folder / "covered"), options.tests, reached)
            mapping = get_context("fork").Process(target=record_reach, args=arguments_of)
            mapping.start()
            mapping.join()
        reach = read_reach(reached)
        for mutant, survives in survivors(chosen, reach, folder, options.jobs, options.seconds):
            count += survives
            print(f"{'SURVIVED' if survives else 'killed  '} {mutant.path}:{mutant.line}", flush=True)
            if survives:
                print(mutant.difference, flush=True)
    print(f"{len(chosen) - count} of {len(chosen)} mutants killed")
    return 1 if count > 0.1 * len(chosen) else 0


if __name__ == "__main__":
    raise SystemExit(main())
