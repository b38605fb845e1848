"""Solve a corpus of cases, freeze how they end, and hold a later version against it.

    python scripts/corpus.py --freeze FILE             add a run of all cases to FILE
    python scripts/corpus.py --quick --against         a part against scripts/baseline/baseline.json.gz
    python scripts/corpus.py --against FILE --allow-missing certificate_remark

A baseline has one run for each of several values of ``OPENBLAS_CORETYPE``, to know what depends on rounding;
set that variable before a run that is added. The exit code is 1 if a record lost an entry, if a status, a
label or a value is worse than in every run of the baseline, if a number differs although the solve ended at
the value of the baseline, or if processor time is more than a tenth longer.

Seconds are processor time over that of a fixed piece of work beside each case, which other processes slow
down alike. A case that takes more than ``--limit`` seconds of wall time is stopped, and is a row.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import multiprocessing
import os
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from typing import TypedDict, cast

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy is imported
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402

import rmesh_nlp as rm  # noqa: E402
from baseline.cases import FORMULATIONS, Case, cases  # noqa: E402
from baseline.comparison import CRASHED, OVERTIME, REFUSED, Row, compare, compare_seconds  # noqa: E402
from isolated import Failed, isolated  # noqa: E402
from rows import command_line  # noqa: E402

BASELINE = Path(__file__).parent / "baseline" / "baseline.json.gz"

UNIT = 0.005
"""Seconds of the fixed piece of work on the machine that the seconds of a run are reduced to."""

STEADY = 1.5
"""Factor between the runs of a baseline within which the seconds of a case are compared."""

NOTHING = {"keys": [], "success": False, "label": "", "value": None, "iterations": 0, "contact_solves": 0}


class Run(TypedDict):
    """A run: its kernel, and by the name of a case its row and the seconds of the fixed work beside it."""

    kernel: str
    rows: dict[str, Row]
    units: dict[str, float]


def fixed_work() -> float:
    """Processor seconds of a piece of work that is like a solve: interpreter, small and larger matrices."""
    began = time.process_time()
    matrix = np.eye(150) + 1 / np.add.outer(np.arange(150), np.arange(1, 151))
    for _ in range(8):
        np.linalg.solve(matrix, matrix)
    sum(k * k % 7 for k in range(40_000))
    return time.process_time() - began


def row_of(case: Case) -> tuple[Row, float]:
    """Run a case: its row and the seconds of the fixed work."""
    unit, began = fixed_work(), time.process_time()
    end: dict[str, object] = {**NOTHING, "numbers": {}, "text": ""}
    with open(os.devnull, "w") as null, contextlib.redirect_stdout(null), contextlib.redirect_stderr(null):
        try:
            end |= case.run()
        except Exception as error:  # a crash is a row
            words = " ".join(str(error).split())[:200]
            is_refused = isinstance(error, ValueError)
            end |= {"status": REFUSED if is_refused else CRASHED, "text": f"{type(error).__name__}: {words}"}
    end["seconds"] = round(time.process_time() - began, 4)
    end["label"] = end["label"] or ""
    return cast(Row, end), round((unit + fixed_work()) / 2, 5)


def isolated_row(case: Case, limit: float) -> tuple[Row, float]:
    """The same in a process of its own, which may crash or be stopped."""
    answer = isolated(partial(row_of, case), limit)
    if not isinstance(answer, Failed):
        return answer
    status = OVERTIME if answer.why.startswith("stopped") else CRASHED
    end = {**NOTHING, "numbers": {}, "status": status, "text": answer.why, "seconds": limit}
    return cast(Row, end), UNIT


def warm_up() -> None:
    """Import what the first solves import, so that no case is timed with it."""
    for formulation in FORMULATIONS:
        rm.solve(rm.EXAMPLES["6.1"](n=3), formulation)


def solved(chosen: Sequence[Case], jobs: int, limit: float) -> Run:
    """Run cases in a pool of processes."""
    warnings.simplefilter("ignore")
    warm_up()
    context = multiprocessing.get_context("fork")
    ends = {}
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        answers = pool.map(partial(isolated_row, limit=limit), chosen)
        for number, (case, answer) in enumerate(zip(chosen, answers, strict=True), start=1):
            ends[case.name] = answer
            if number % 50 == 0:
                print(f"{number} of {len(chosen)} cases", file=sys.stderr, flush=True)
    kernel = os.environ.get("OPENBLAS_CORETYPE", "default")
    return Run(
        kernel=kernel,
        rows={name: row for name, (row, _) in ends.items()},
        units={name: unit for name, (_, unit) in ends.items()},
    )


def seconds(run: Run, chosen: Sequence[Case]) -> dict[str, float]:
    """Processor seconds of cases by formulation, at the speed at which the fixed work takes ``UNIT``."""
    speed = UNIT / median(run["units"][case.name] for case in chosen)
    sums: dict[str, float] = defaultdict(float)
    for case in chosen:
        sums[case.formulation] += speed * run["rows"][case.name]["seconds"]
    return sums


def write(path: Path, runs: Sequence[Run]) -> None:
    """Write runs."""
    path.write_bytes(gzip.compress(json.dumps(runs, sort_keys=True).encode(), mtime=0))


def read(path: Path) -> list[Run]:
    """The runs of a file."""
    return cast(list[Run], json.loads(gzip.decompress(path.read_bytes())))


def against(runs: Sequence[Run], latest: Run, chosen: Sequence[Case], allowed: Sequence[str]) -> int:
    """Print how a run differs from those of a baseline; the exit code."""
    rows = {case.name: latest["rows"][case.name] for case in chosen}
    result = compare([old["rows"] for old in runs], rows, allowed)
    steady = [case for case in chosen if _is_steady([old["rows"].get(case.name) for old in runs])]
    compare_seconds(result, [seconds(old, steady) for old in runs], seconds(latest, steady))
    print(result)
    return 1 if result.faults else 0


def _is_steady(rows: Sequence[Row | None]) -> bool:
    """Whether all runs have a case, and took about as long for it."""
    times = [row["seconds"] for row in rows if row is not None]
    return len(times) == len(rows) and max(times) <= STEADY * min(times)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases; the exit code."""
    parser = command_line(__doc__)
    parser.add_argument("--freeze", type=Path, metavar="FILE", help="add the run to a baseline")
    parser.add_argument("--against", type=Path, nargs="?", const=BASELINE, metavar="FILE")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="compare its last run, and solve nothing")
    parser.add_argument("--quick", action="store_true", help="about a quarter of the cases")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases whose name has it")
    parser.add_argument("--allow-missing", nargs="*", default=[], metavar="ENTRY")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of wall time of a case")
    options = parser.parse_args(arguments)
    chosen = [case for case in cases() if (case.quick or not options.quick) and options.only in case.name]
    print(f"{len(chosen)} cases with {Path(rm.__file__).parent}", file=sys.stderr)
    latest = read(options.rows)[-1] if options.rows else solved(chosen, options.jobs, options.limit)
    chosen = [case for case in chosen if case.name in latest["rows"]]
    if options.freeze:
        write(options.freeze, [*(read(options.freeze) if options.freeze.exists() else ()), latest])
    return against(read(options.against), latest, chosen, options.allow_missing) if options.against else 0


if __name__ == "__main__":
    sys.exit(main())
