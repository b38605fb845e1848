"""SciPy on the reduced energy: a contact solve per evaluation."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import Bounds, minimize

from peer_solvers.case import Case, Finish
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy

TOLERANCE = 1e-8
"""Of SciPy's solvers."""


class OutOfTimeError(Exception):
    """Raised inside a solver of SciPy to end it."""


def scipy_minimize(method: str) -> Callable[[Case], Finish]:
    """``scipy.optimize.minimize`` on the reduced energy with our gradient."""

    def run(case: Case) -> Finish:
        began = time.process_time()
        reduced = ReducedEnergy(relocation(case.problem))
        bound = reduced.relocation.mesh_map.bound
        start = np.zeros(bound.size)
        unit = abs(reduced(start).value) or 1.0
        best, lowest = start, np.inf

        def objective(q: Array) -> float:
            nonlocal best, lowest
            if time.process_time() - began > case.limit:
                raise OutOfTimeError
            found = reduced(q).value
            if found < lowest:
                best, lowest = q.copy(), found
            return found / unit

        try:
            result = minimize(
                objective,
                start,
                jac=lambda q: reduced(q).gradient / unit,
                method=method,
                bounds=Bounds(-bound, bound),
                tol=TOLERANCE,
                options={"maxiter": 500},
            )
            q, status = result.x, "converged" if result.success else str(result.message)
        except OutOfTimeError:
            q, status = best, f"stopped after {case.limit:g} s"
        seconds = time.process_time() - began
        return Finish(reduced.relocation.nodes(np.clip(q, -bound, bound)), status, seconds)

    return run
