"""Do the tests notice when the code is wrong? Change one thing at a time, and run them.

python scripts/mutate.py --sample 30                     of all modules below, drawn with a seed
python scripts/mutate.py rmesh_nlp/solution/audit.py     all mutants of one file
python scripts/mutate.py --list rmesh_nlp/fem/stress.py  what they are

Each mutant is a copy of the checkout in a temporary folder with one change of one line: a comparison or
an arithmetic operator turned, a number changed, a condition negated, an argument of ``min`` and
``max`` swapped. The tests of its wing run until the first failure. A mutant that no test
notices survives and is printed as a difference; the exit code is 1 if more than a tenth do.
Some survivors are equivalent to the original, which no test can tell: see ``docs/notes/mutations.md``.
"""

from __future__ import annotations

import argparse
import ast
import copy
import difflib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

TESTS = {
    "rmesh_nlp/solution/audit.py": ("solution", "fem", "formulations/test_strategies.py"),
    "rmesh_nlp/solution/referee.py": ("solution", "formulations/test_strategies.py"),
    "rmesh_nlp/solution/solution.py": ("solution", "io", "formulations/test_strategies.py"),
    "rmesh_nlp/solution/starts.py": ("solution", "problem/test_moves.py", "io"),
    "rmesh_nlp/solution/verification.py": ("api",),
    "rmesh_nlp/programs/reduced.py": ("programs", "fem/test_quantities.py"),
    "rmesh_nlp/contact/sensitivity.py": ("programs", "contact"),
    "rmesh_nlp/fem/stress.py": ("fem", "io"),
    "rmesh_nlp/fem/quantities.py": ("fem/test_quantities.py",),
    "rmesh_nlp/fem/contact_pressure.py": ("fem/test_quantities.py",),
    "rmesh_nlp/fem/objective_text.py": (
        "fem/test_quantities.py",
        "solution",
        "formulations/test_strategies.py",
    ),
    "rmesh_nlp/io/results.py": ("io", "campaign"),
    "rmesh_nlp/io/export.py": ("io",),
    "rmesh_nlp/campaign/run.py": ("campaign", "io"),
    "rmesh_nlp/campaign/cases.py": ("campaign", "cli"),
    "rmesh_nlp/report/columns.py": ("report",),
    "rmesh_nlp/report/blocks.py": ("report",),
    "rmesh_nlp/report/stresses.py": ("report",),
    "rmesh_nlp/mpcc/solver.py": ("mpcc",),
    "rmesh_nlp/mpcc/homotopy.py": ("mpcc",),
    "rmesh_nlp/mpcc/finish.py": ("mpcc",),
    "rmesh_nlp/mpcc/stationarity.py": ("mpcc",),
    "rmesh_nlp/mpcc/result.py": ("mpcc",),
}
"""What makes results trustworthy, and the tests that must notice."""

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
    line : int
    source : str
        The whole file with the change.
    difference : str
    """

    path: str
    line: int
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
            found.append(Mutant(path, node.lineno, source, difference))
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
            for part in [*child.body, *getattr(child, "decorator_list", [])]:
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
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
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


def is_killed(mutant: Mutant, checkout: Path, seconds: float) -> bool:
    """Whether a test fails, or takes longer than ``seconds``."""
    path = checkout / mutant.path
    original = path.read_text()
    path.write_text(mutant.source)
    tests = [f"tests/{name}" for name in TESTS.get(mutant.path, ("",))]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "0",
        "-x",
        "-q",
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
    ]
    environment = {**os.environ, "PYTHONPATH": str(checkout), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [*command, *tests], cwd=checkout, env=environment, capture_output=True, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        return True
    finally:
        path.write_text(original)
    return done.returncode != 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw mutants, run the tests on each, and print the survivors."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", help="files of the package; default: those listed here")
    parser.add_argument("--sample", type=int, help="so many mutants, drawn at random; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=300.0, help="limit for the tests of one mutant")
    parser.add_argument("--list", action="store_true", help="print the mutants, run nothing")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.files if not (ROOT / name).is_file()]
    if unknown:
        parser.error(f"{unknown[0]} is not a file of this checkout")
    chosen = [m for name in options.files or TESTS for m in mutants(name, (ROOT / name).read_text())]
    if options.sample is not None and options.sample < len(chosen):
        chosen = random.Random(options.seed).sample(chosen, options.sample)
    if options.list:
        for mutant in chosen:
            print(f"{mutant.path}:{mutant.line}\n{mutant.difference}")
        return 0
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "checkout"
        ignored = shutil.ignore_patterns(".git", "__pycache__", "*.egg-info", ".*_cache", "results", "_build")
        shutil.copytree(ROOT, checkout, ignore=ignored)
        for mutant in chosen:
            killed = is_killed(mutant, checkout, options.seconds)
            survivors += not killed
            print(f"{'killed  ' if killed else 'SURVIVED'} {mutant.path}:{mutant.line}", flush=True)
            if not killed:
                print(mutant.difference, flush=True)
    print(f"{len(chosen) - survivors} of {len(chosen)} mutants killed")
    return 1 if survivors > 0.1 * len(chosen) else 0


if __name__ == "__main__":
    raise SystemExit(main())
