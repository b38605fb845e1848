"""Strategies with a regularisation: a schedule of weights, each solved from where the last one ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.regularisation import gain_estimate, regularised, weights
from rmesh_nlp.solving.clock import solving
from rmesh_nlp.solving.solution import Solution, counted

ESTIMATE_SOLVES = 2
"""Contact solves of the estimate that the weights are relative to."""

Regularisation = float | Sequence[float] | None
"""Weight of a distortion in the energy, relative to the error of the energy on the mesh as given, or a
schedule of such weights, of which the last may be 0; None for no regularisation."""


def solve_regularised(
    solve: Callable[..., Solution],
    problem: ContactProblem,
    regularisation: float | Sequence[float],
    distortion: str,
    *,
    objective: str | Objective = "energy",
    **options: Any,
) -> Solution:
    """Solve by a strategy with each weight in turn; the last solution, with the costs of all.

    Parameters
    ----------
    solve : callable
        A strategy that takes ``objective`` and ``start``.
    problem : ContactProblem
    regularisation : see :data:`Regularisation`
    distortion : str
        A name in :data:`rmesh_nlp.fem.distortion.DISTORTIONS`.
    objective : str
        Only the energy: the weight is relative to its error.

    Raises
    ------
    BadInputError
        If the weights, the distortion or the objective cannot be used.
    """
    began = time.perf_counter()
    schedule = weights(regularisation)
    if str(objective) != "energy":
        raise BadInputError(
            f"regularisation is relative to the error of the energy, not of {objective!s}: "
            f"write the weight into the objective, such as {objective!s} + 0.01*{distortion}"
        )
    regularised(1.0, schedule[-1], distortion)
    gain = gain_estimate(problem).value
    done: list[Solution] = []
    for weight in schedule:
        if done:
            options["start"] = done[-1].mesh.p
        done.append(solve(problem, objective=regularised(gain, weight, distortion), **options))
    extra = {
        "regularisation": list(schedule) if len(schedule) > 1 else schedule[0],
        "distortion": distortion,
        "regularisation_weight": schedule[-1] * gain,
        "gain_estimate": gain,
    }
    last = done[-1]
    build, audit = sum(s.build_time_s for s in done), sum(s.audit_time_s for s in done)
    return replace(
        last,
        iterations=sum(s.iterations for s in done),
        contact_solves=ESTIMATE_SOLVES + sum(s.contact_solves for s in done),
        build_time_s=build,
        solve_time_s=solving(time.perf_counter() - began, build, audit),
        audit_time_s=audit,
        start=done[0].start,
        extra={**last.extra, **counted(done), **extra},
    )
