"""Interior-point methods (Ipopt) on the outer problem, with its second derivatives or with limited memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.curved_program import with_hessian
from rmesh_nlp.models.lifted_program import lifted
from rmesh_nlp.models.nested_settings import NestedSettings
from rmesh_nlp.models.reduced import ReducedEnergy
from rmesh_nlp.models.reduced_program import ReducedProgram
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.status import Status

EXACT = "interior point with exact Hessians"

ROUNDING = 1e-12
"""Part of its value by which an objective may be above that at the start: the error of a contact solve."""

LIMITED_MEMORY = "interior point with limited memory"


@dataclass(frozen=True)
class OuterResult:
    """Where an outer solver stopped.

    ``method`` names what it ran, where its name leaves that open.
    """

    q: Array
    status: Status
    iterations: int
    method: str = ""


def interior(
    program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings
) -> OuterResult:
    """Ipopt with second derivatives where they can be had, else with limited memory; never above the start.

    Those of the energy are sparse in moves and displacements together
    (:mod:`rmesh_nlp.models.lifted_program`); those of other objectives are a dense matrix, for up to
    ``settings.exact`` moves.
    """
    if isinstance(program.function, ReducedEnergy):
        larger = lifted(program)
        return _run(program, larger.nlp, larger.start(start), monitor, _exact(program, settings), EXACT)
    if program.nlp.n_x <= settings.exact:
        return _run(program, with_hessian(program).nlp, start, monitor, _exact(program, settings), EXACT)
    options = settings.options(boxed=bool(np.all(np.isfinite(program.nlp.ubx))))
    return _run(program, program.nlp, start, monitor, options, LIMITED_MEMORY)


def _exact(program: ReducedProgram, settings: NestedSettings) -> dict[str, Any]:
    return settings.exact_options(program.scale / program.unit, program.warm, program.tolerance)


def _run(
    program: ReducedProgram, nlp: NLP, first: Array, monitor: Monitor, options: dict[str, Any], method: str
) -> OuterResult:
    """A solve from ``first``, whose leading unknowns are the moves.

    It ends as soon as the moves are stationary by the measure that counts. Ipopt's own test is of its
    multipliers, and where rounding keeps them from its tolerance it would go on for dozens of contact solves.
    """
    n, stationary = program.nlp.n_x, False
    start, function = first[:n], program.function
    most = function(start).value
    most += ROUNDING * abs(most)

    def watch(iteration: int, x: Array, f: float) -> bool:
        nonlocal stationary
        stop = bool(monitor(iteration, x[:n], f))
        q = np.clip(x[:n], program.nlp.lbx, program.nlp.ubx)
        if not stop and iteration > 0 and program.is_valid(q):
            point = function(q)
            stationary = point.value <= most and program.residual(point) <= program.tolerance
        return stop or stationary

    result = Solver(nlp, options=options, monitor=watch)(first)
    q = np.clip(result.x[:n], program.nlp.lbx, program.nlp.ubx)
    if not (np.isfinite(result.f) and function(q).value <= most):
        status = Status.STALLED if result.converged else result.status
        return OuterResult(start, status, result.iterations, method)
    status = Status.CONVERGED if result.converged or stationary else result.status
    return OuterResult(q, status, result.iterations, method)
