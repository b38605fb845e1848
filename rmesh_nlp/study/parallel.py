"""A campaign (``rmesh compare --jobs N``) on the processes of a study; rows and files stay the campaign's."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rmesh_nlp.io.files import folder_aside
from rmesh_nlp.io.results import Result, Results
from rmesh_nlp.study import engine
from rmesh_nlp.study.cases import Case
from rmesh_nlp.study.comparison import Ended, Solver
from rmesh_nlp.study.plan import PlannedSolve

UNLIMITED_S, UNLIMITED_MB = 7 * 86400.0, 1e9


def in_parallel(folder: Path, settings: Mapping[str, Any], jobs: int) -> Solver:
    """Solves cases of the paper's examples in so many processes, for :func:`rmesh_nlp.study.comparison.run`.

    Parameters
    ----------
    folder : Path
        Of the campaign.
    settings : mapping
        From which the cases were made, see :func:`rmesh_nlp.study.cases.plan_comparison`.
    """

    def solver(cases: Sequence[Case]) -> Iterator[Ended]:
        if not cases:
            return
        plans = [_planned(case, settings) for case in cases]
        case_of = {plan.key: case for plan, case in zip(plans, cases, strict=True)}
        with folder_aside(folder) as aside:
            for plan, row in engine.run_for_client(plans, aside, jobs):
                case, files = case_of[plan.key], Results(aside).result(row)
                yield Ended(case, {**row, **case.identity, "key": case.key}, partial(_move, files))

    return solver


def _planned(case: Case, settings: Mapping[str, Any]) -> PlannedSolve:
    problem = {"kind": "example", "example": case.problem.name}
    problem.update({k: v for k, v in settings.items() if k in ("n", "delta", "quadrature") and v is not None})
    return PlannedSolve(
        problem=problem,
        name=case.problem.name,
        family=case.problem.name,
        size=case.problem.size,
        variant=case.formulation,
        formulation=case.formulation,
        options=dict(case.options),
        time_s=case.options.get("time_limit_s", UNLIMITED_S),
        memory_mb=UNLIMITED_MB,
        certify=case.certify,
    )


def _move(files: Result, places: Result) -> None:
    """What a worker wrote aside into place; a solve that raised has none, nor keeps older ones."""
    for source, target in ((files.vtu, places.vtu), (files.history, places.history)):
        if source.exists():
            target.parent.mkdir(exist_ok=True)
            os.replace(source, target)
        else:
            target.unlink(missing_ok=True)
