r"""Our solvers beside what people would use instead, on the same problems in one run.

    python scripts/benchmark_peers.py --plate plate_484.msh --collection mpcc_problems.py --out peers

Four groups: Example 6.1 all at once (the program of ``joint``) and nested (a contact solve per evaluation),
a stretched plate with a hole on a given mesh, and a collection of MPCCs as for ``benchmark_mpcc.py``. Every
run is a process of its own, ``peers.py``, so that a peer which is missing, raises, crashes or hangs is a row
that says so. Writes ``peers.md``.

No peer is needed. Those that there are::

    pip install pyomo NeuROM-Py mpecss pympcc

cyipopt, for pympcc and for Pyomo where there is no ``ipopt`` executable, is built against the Ipopt in
CasADi's wheel, and so is the very Ipopt with MUMPS that ours uses::

    C=$(python -c "import casadi; print(casadi.__path__[0])")
    CFLAGS="-I$C/include/coin-or" LDFLAGS="-L$C -Wl,-rpath,$C" PKG_CONFIG_PATH=$C/pkgconfig \
        pip install cyipopt

Pyomo calls cyipopt through PyNumero's library, built from the source in Pyomo's wheel with the AMPL Solver
Library of Debian (libamplsolver-dev); ``LD_LIBRARY_PATH`` has to name the folder of the result::

    P=$(python -c "import pyomo; print(pyomo.__path__[0])")
    g++ -O2 -shared -fPIC -DBUILDING_PYNUMERO_ASL -I/usr/include/ampl-netlib-solvers \
        $P/contrib/pynumero/src/AmplInterface.cpp -lamplsolver -o libpynumero_ASL.so
"""

from __future__ import annotations

import argparse
import datetime
import importlib.util
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmark_mpcc import load
from peers import GROUPS

SCRIPT = Path(__file__).resolve().parent / "peers.py"
GRACE = 30.0
"""Seconds beyond the limit for imports, the warm-up and the judging."""

STOPPED, ENDED = "stopped at the limit", "all ended"

NEEDS = {
    "Pyomo, Ipopt": ("pyomo",),
    "NeuROM-Py": ("torch", "neurom"),
    "MPECSS": ("mpecss",),
    "pympcc": ("pympcc", "cyipopt"),
}
"""Modules without which a peer is not installed."""

PACKAGES = ("casadi", "numpy", "scipy", "pyomo", "cyipopt", "NeuROM-Py", "torch", "mpecss", "pympcc")


@dataclass(frozen=True)
class Ending:
    """What a process left: its answers, and why it ended if not of itself."""

    answers: tuple[dict[str, Any], ...]
    failure: str | None


@dataclass(frozen=True)
class Row:
    """One solver on one problem: medians over its runs; None where there is no such figure."""

    problem: str
    solver: str
    status: str
    result: str = "-"
    least_area: float | None = None
    seconds: float | None = None
    runs: int = 0
    ratio: float | None = None


def attempt(command: Sequence[str], limit: float) -> Ending:
    """Run a command that appends answers to the file after ``--answer``, for ``limit`` seconds at most."""
    with tempfile.TemporaryDirectory() as folder:
        path, said, failure = Path(folder) / "answers", Path(folder) / "stderr", None
        with said.open("w") as errors:
            try:
                done = subprocess.run(
                    [*command, "--answer", str(path)],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=errors,
                    timeout=limit,
                )
                if done.returncode == -signal.SIGALRM:
                    failure = STOPPED
                elif done.returncode < 0:
                    failure = f"crashed: {signal.Signals(-done.returncode).name}"
                elif done.returncode:
                    lines = said.read_text(errors="replace").strip().splitlines()
                    failure = f"failed: {lines[-1] if lines else f'exit code {done.returncode}'}"
            except subprocess.TimeoutExpired:
                failure = f"stopped after {limit:g} s"
        lines = path.read_text().splitlines() if path.exists() else []
    return Ending(tuple(json.loads(line) for line in lines), failure)


def is_installed(solver: str) -> bool:
    """Whether the modules that a solver needs can be found."""
    return all(importlib.util.find_spec(name) for name in NEEDS.get(solver, ()))


def relocation_row(problem: str, solver: str, command: Sequence[str], repeat: int, limit: float) -> Row:
    """A solver of a relocation problem; one that was stopped or failed is not run again."""
    runs: list[dict[str, Any]] = []
    for _ in range(repeat):
        ending = attempt([*command, "--limit", str(limit)], limit + GRACE)
        if ending.failure or not ending.answers:
            return Row(problem, solver, ending.failure or "no answer", runs=len(runs))
        runs.append(ending.answers[0])
        if runs[-1]["status"].startswith("stopped"):
            break
    seconds = statistics.median(run["seconds"] for run in runs)
    last = runs[-1]
    result = "inverted elements" if last["energy"] is None else f"{last['energy']:.7f}"
    return Row(problem, solver, last["status"], result, last["least_area"], seconds, len(runs))


def collection_run(command: Sequence[str], size: int, limit: float) -> tuple[float, int, dict[str, int]]:
    """Seconds, problems solved and failures of one pass; a process that dies costs the problem it was at."""
    seconds, solved, at, failures = 0.0, 0, 0, dict[str, int]()
    while at < size:
        rest = [*command, "--skip", str(at), "--limit", str(limit)]
        ending = attempt(rest, limit * (size - at) + GRACE)
        for answer in ending.answers:
            seconds += answer["seconds"]
            solved += answer["solved"]
            if answer["failed"]:
                failures[answer["status"]] = failures.get(answer["status"], 0) + 1
        at += len(ending.answers)
        if at < size:
            failure = ending.failure or "no answer"
            failures[failure] = failures.get(failure, 0) + 1
            if failure == STOPPED:
                seconds += limit
            elif failure.startswith("failed"):
                break  # it cannot even start
            at += 1
    return seconds, solved, failures


def collection_row(solver: str, command: Sequence[str], size: int, repeat: int, limit: float) -> Row:
    """An MPCC solver on the whole collection; one that had to be stopped is not run again."""
    passes: list[tuple[float, int, dict[str, int]]] = []
    while len(passes) < repeat and not (passes and STOPPED in passes[-1][2]):
        passes.append(collection_run(command, size, limit))
    seconds = statistics.median(run[0] for run in passes)
    solved, failures = passes[-1][1:]
    status = "; ".join(f"{count} {what}" for what, count in failures.items()) or ENDED
    return Row("MPCCs", solver, status, f"{solved} of {size}", None, seconds, len(passes))


def with_ratios(rows: Sequence[Row]) -> list[Row]:
    """The rows of one problem, seconds of each over those of the first, which is ours."""
    ours = rows[0].seconds
    return [
        Row(**{**vars(row), "ratio": row.seconds / ours if ours and row.seconds is not None else None})
        for row in rows
    ]


def rows_of(group: str, problem: str, arguments: Sequence[str], options: argparse.Namespace) -> list[Row]:
    """All solvers of a group on one problem."""
    rows = []
    for solver in GROUPS[group]:
        command = [sys.executable, str(SCRIPT), f"{group}/{solver}", *arguments]
        if not is_installed(solver):
            rows.append(Row(problem, solver, "not installed"))
        elif group == "mpcc":
            size = len(load(options.collection).names())
            rows.append(collection_row(solver, command, size, options.repeat, options.limit_mpcc))
        else:
            rows.append(relocation_row(problem, solver, command, options.repeat, options.limit))
        print(f"{problem}, {solver}: {rows[-1].status}", file=sys.stderr, flush=True)
    return with_ratios(rows)


def markdown(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""

    def number(value: float | None, form: str) -> str:
        return "-" if value is None else format(value, form)

    lines = [
        "| problem | solver | status | energy or solved | least area | time [s] | runs | time over ours |",
        "|:--|:--|:--|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r.problem} | {r.solver} | {_cell(r.status)} | {r.result} | {number(r.least_area, '.2g')} "
        f"| {number(r.seconds, '.3g')} | {r.runs or '-'} "
        f"| {'> ' if r.ratio and 'stopped' in r.status else ''}{number(r.ratio, '.1f')} |"
        for r in rows
    ]
    return "\n".join(lines)


def _cell(text: str) -> str:
    """A status short enough for a table."""
    text = " ".join(text.replace("|", "/").split())
    return text if len(text) <= 90 else text[:87] + "..."


def heading(repeat: int) -> str:
    """When, on what and with what the table was made."""
    versions = []
    for package in PACKAGES:
        try:
            versions.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            versions.append(f"{package} not installed")
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    return (
        f"{datetime.date.today()}, {os.cpu_count()} CPUs, OMP_NUM_THREADS {threads}, "
        f"Python {sys.version.split()[0]}, {', '.join(versions)}. Medians of {repeat} runs, each a process "
        "of its own. Energies and least element areas (over the initial ones) are ours, of a contact solve "
        "on the mesh where the solver stopped; a solved MPCC is within 1e-4 of the best known value, and "
        "feasible and complementary to 1e-3."
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 whatever the peers do, 1 if one of ours did not end as it should."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--groups", nargs="+", default=list(GROUPS), choices=list(GROUPS))
    parser.add_argument("--n", type=int, nargs="+", default=[8, 16], help="squares per side of Example 6.1")
    parser.add_argument("--plate", type=Path, help="mesh of the plate; without it no such row")
    parser.add_argument("--collection", type=Path, help="Python file of MPCCs; without it no such row")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--limit", type=float, default=120.0, help="seconds that a run may take")
    parser.add_argument("--limit-mpcc", type=float, default=20.0, help="seconds that an MPCC may take")
    parser.add_argument("--out", type=Path, default=Path("peers"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    tasks = [
        (group, f"6.1, n = {n}, {title}", ["--n", str(n)])
        for n in options.n
        for group, title in (("joint", "all at once"), ("nested", "nested"))
    ]
    if options.plate is not None:
        tasks.append(("plate", "plate with a hole", ["--plate", str(options.plate)]))
    if options.collection is not None:
        tasks.append(("mpcc", "MPCCs", ["--collection", str(options.collection)]))
    rows: list[Row] = []
    ours: list[Row] = []
    for group, problem, extra in tasks:
        if group in options.groups:
            found = rows_of(group, problem, extra, options)
            ours.append(found[0])
            rows += found
            # after every problem, so that an interruption keeps what is done
            text = f"{heading(options.repeat)}\n\n{markdown(rows)}\n"
            (options.out / "peers.md").write_text(text, encoding="utf-8")
    print(f"{heading(options.repeat)}\n\n{markdown(rows)}")
    return 0 if all(row.status in ("converged", ENDED) for row in ours) else 1


if __name__ == "__main__":
    sys.exit(main())
