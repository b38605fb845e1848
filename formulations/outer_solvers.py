"""Outer solvers of the nested formulation: trust-region Newton-CG, or an interior point (Ipopt).

Both take any outer objective, with its second derivatives (:mod:`rmesh_nlp.models.second_derivatives`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from formulations.ipopt import pushed
from rmesh_nlp.evaluation import ROUNDING, Array
from rmesh_nlp.models.descent import Watch, descend
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.reduced_nlp import reduced_nlp
from rmesh_nlp.optimize.constraints import LARGEST_DENSE
from rmesh_nlp.optimize.newton_step import NewtonSettings
from rmesh_nlp.optimize.solver import PluginOptions, Solver
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import Count, Positive, Settings, Values
from rmesh_nlp.solving.outer import Outer

NEWTON, INTERIOR = "newton", "interior point"  # as records name them

WARM_BARRIER, WARM_PUSH = 1e-8, 1e-6
"""Ipopt's first barrier and least distance to bounds where the start is given. Of 1e-4, 1e-6 and 1e-8, with
six problems started at their minimisers and least areas that are smaller by 1e-4, 1e-8 took 4 to 21
iterations and ended in the same valley each time; larger ones took more, and left it once."""


@dataclass(frozen=True)
class NestedSettings(Settings):
    """Settings of the outer solvers; docs/notes/speed.md has the benchmarks that chose them.

    Attributes
    ----------
    iterations : int or None
        Of the outer solver; by default 500, and 200 for newton.
    enough : float, optional
        newton ends where the model predicts less than this part of the gain so far, stationary or not; by
        default only at a stationary point. On a plate of 4,462 nodes with move limits 20 iterations of 200
        and more have 99.7 % of the gain, after which the residual falls slowly.
    newton : NewtonSettings
        Of the descents of newton without a distortion in the objective.
    ipopt : mapping
        Further Ipopt options, which override all others.
    """

    iterations: Count | None = None
    enough: Positive | None = None
    newton: NewtonSettings = field(default_factory=NewtonSettings)
    ipopt: PluginOptions = field(default_factory=dict)

    def exact(self, outer: Outer) -> Values:
        """Ipopt's options with exact Hessians."""
        return {
            **({"mu_init": WARM_BARRIER, **pushed(WARM_PUSH)} if outer.is_near else {}),
            # many constraints are weakly active: an interior point meets those only to its square root
            "tol": outer.tolerance**2,
            "max_iter": self.iterations or 500,
            "nlp_scaling_method": "none",
            "obj_scaling_factor": 1 / outer.residual.unit,
            **self.ipopt,
        }


@dataclass(frozen=True)
class OuterResult:
    """Where an outer solver stopped, what it ran, and how many of its iterations factorise a KKT matrix.

    Unless it ``is_lower`` it is the start, below which nothing was found.
    """

    q: Array
    status: Status
    method: str = ""
    factorised: int = 0
    is_lower: bool = True


def interior(outer: Outer, start: Array, watch: Watch, settings: NestedSettings) -> OuterResult:
    """Ipopt with second derivatives; ``start`` itself where it does not end below.

    Those of the energy are sparse in outer variables and displacements together
    (:mod:`rmesh_nlp.models.reduced_nlp`), those of other objectives a dense matrix. It ends as soon as the
    outer variables are stationary by the first-order residual: Ipopt's own test is of its multipliers, and
    where rounding keeps them from its tolerance it would go on for dozens of contact solves.
    """
    function, nlp = outer.function, reduced_nlp(outer.function, outer.constraints)
    n, stationary = start.size, False
    violation, value = outer.merit(function(start))
    most = violation, value + ROUNDING * abs(value)

    def monitor(iteration: int, x: Array, *_: object) -> bool:
        nonlocal stationary
        stop, q = watch(iteration, x[:n]), outer.clipped(x[:n])
        if not stop and iteration > 0 and outer.is_valid(q):
            point = function(q)
            stationary = outer.merit(point) <= most and outer.residual(point) <= outer.tolerance
        return stop or stationary

    solver = Solver(nlp, options=settings.exact(outer))
    result = solver(np.append(start, np.zeros(nlp.n_x - n)), monitor=monitor)
    q = outer.clipped(result.x[:n])
    if not (np.isfinite(result.f) and outer.merit(function(q)) <= most):
        status = Status.STALLED if result.converged else result.status
        return OuterResult(start, status, INTERIOR, result.iterations, is_lower=False)
    status = Status.CONVERGED if result.converged or stationary else result.status
    return OuterResult(q, status, INTERIOR, result.iterations)


def solved(outer: Outer, start: Array, watch: Watch, settings: NestedSettings) -> OuterResult:
    """Projected Newton-CG where move limits alone keep the elements valid, else an interior point first.

    Where that does not end below the start, or the Hessian of an objective other than the energy, a dense
    matrix, is too large for it, Newton-CG goes as far as the areas let it.
    """
    function, constraints = outer.function, outer.constraints
    is_part = settings.enough is not None and constraints is None
    has_rows = outer.relocation.n_valid > 0 or constraints is not None or function.objective.has_barrier
    is_small = (
        isinstance(function, ReducedEnergy) or start.size**2 <= LARGEST_DENSE or constraints is not None
    )
    method, factorised = NEWTON, 0
    if has_rows and is_small and not is_part:
        end = interior(outer, start, watch, settings)
        if end.is_lower:
            return end
        method, factorised = f"{INTERIOR}, then {NEWTON}", end.factorised
    result = descend(
        function,
        start,
        outer.is_valid,
        lambda iteration, q: watch(factorised + iteration, q),
        tolerance=np.inf if is_part else outer.tolerance,
        unit=outer.residual.unit,
        gain_tolerance=settings.enough if is_part else np.inf,
        max_iterations=settings.iterations or 200,
        settings=settings.newton,
    )
    return OuterResult(result.x, result.status, method, factorised)
