"""The process in which solves run: it takes planned solves on stdin and answers with records on stdout.

``python -m rmesh_nlp.study.runner``, one JSON line each way. It is started, watched and if need be
killed by :mod:`rmesh_nlp.study.contained`, and ends when that does.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from rmesh_nlp.io.records import REQUIRED, Record, to_json
from rmesh_nlp.io.results import Results
from rmesh_nlp.solving.solution import versions
from rmesh_nlp.study import comparison as campaign
from rmesh_nlp.study.cases import Case
from rmesh_nlp.study.plan import PlannedSolve
from rmesh_nlp.study.problems import build

READY = "ready"


def perform(solve: PlannedSolve, folder: Path | None) -> Record:
    """Run one solve, keep its fields, and return its row."""
    began, cpu = time.perf_counter(), time.process_time()
    try:
        case = Case(build(solve), solve.formulation, solve.options, solve.certify)
        outcome = campaign.solve(case)
        record = outcome.record
    except Exception as error:  # a problem that cannot be built here
        return failure(solve, "failed", f"{type(error).__name__}: {' '.join(str(error).split())}")
    wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    row = {**record, **identity(solve), "task_time_s": wall, "cpu_time_s": cpu}
    if folder is not None and solve.fields:
        campaign.save(outcome, Results(folder).result(row))
    return row


def identity(solve: PlannedSolve) -> Record:
    """The entries of a row that say which solve it is."""
    return {
        "key": solve.key,
        "example": solve.name,
        "family": solve.family,
        "variant": solve.variant,
        "formulation": solve.formulation,
        "repeat": solve.repeat,
    }


def failure(solve: PlannedSolve, status: str, message: str, seconds: float = 0.0) -> Record:
    """The row of a solve of which nothing else is known."""
    empty = dict.fromkeys(REQUIRED)
    return {
        **empty,
        **identity(solve),
        "objective": solve.options.get("objective", "energy"),
        "n": solve.size,
        "status": status,
        "success": False,
        "message": message,
        "stationarity": "",
        "wall_time_s": seconds,
        "versions": versions(),
        "seed": solve.options.get("seed"),
    }


def main() -> None:
    """Answer until stdin ends."""
    _end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client, which then ends this process
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # solvers print what they like
    warnings.simplefilter("ignore")
    _say(answers, READY)
    for line in sys.stdin:
        request: dict[str, Any] = json.loads(line)
        folder = None if request["folder"] is None else Path(request["folder"])
        _say(answers, to_json(perform(PlannedSolve(**request["solve"]), folder)))


def _say(answers: Any, text: str) -> None:
    answers.write(text + "\n")
    answers.flush()


def _end_with_parent() -> None:
    """Ask Linux to kill this process when the one that started it is gone, also by ``kill -9``."""
    if sys.platform == "linux":
        kill_at_end_of_parent = 1
        ctypes.CDLL(None).prctl(kill_at_end_of_parent, signal.SIGKILL)


if __name__ == "__main__":
    main()
