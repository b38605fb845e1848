"""From the end of a cascade to a stationary point of the regularised energy.

Far from it conjugate gradients with the diagonal are the cheapest per iteration. Near it the second
derivatives are nearly singular in many directions, along which elements slide past each other at
hardly any cost; there one factorisation of the second derivatives in moves and displacements together is
a nearly exact preconditioner, and Newton's method converges quadratically.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.curvature import Curvature, Hessian
from rmesh_nlp.models.large_moves import LargeMoves, OnPoint, node_widths
from rmesh_nlp.models.reduced import ReducedEnergy, ReducedPoint
from rmesh_nlp.optimize.local_newton import Scaled
from rmesh_nlp.optimize.newton import NewtonResult
from rmesh_nlp.optimize.preconditioned_step import PreconditionedStep, Shifted, positive_definite
from rmesh_nlp.optimize.status import Status

NEAR = 3e-3
"""First-order residual below which the second derivatives are factorised (chosen on Example 6.1)."""

FORCING = 0.01
"""Conjugate gradients stop at this part of the residual they began with."""

EXACT = 1e-4
"""The same for steps that are judged by the residual."""

POLISH = 10
"""Largest number of factorisations for such steps."""


@dataclass(frozen=True)
class Finish:
    """How the way to a stationary point ended.

    Attributes
    ----------
    result : NewtonResult
        CONVERGED if the residual is at most the tolerance.
    residual : float
    factorisations : int
        Of second derivatives in moves and displacements together.
    """

    result: NewtonResult
    residual: float
    factorisations: int


def finished(
    energy: ReducedEnergy,
    q: Array,
    residual: Callable[[ReducedPoint], float],
    *,
    tolerance: float,
    reference: float,
    max_iterations: int,
    on_step: OnPoint | None = None,
) -> Finish:
    """Descend from moves ``q`` until the first-order residual is at most ``tolerance``.

    Parameters
    ----------
    energy : ReducedEnergy
        With a distortion.
    q : (n,) array
    residual : callable
        See :class:`rmesh_nlp.models.residual.OuterResidual`.
    tolerance : float
    reference : float
        Value above which a decrease is a gain.
    max_iterations : int
    on_step : callable, optional
        The descent stops if it returns True.
    """
    here, factorisations = float("inf"), 0

    def report(iteration: int, x: Array, value: float) -> bool:
        nonlocal here
        here = residual(energy(x))
        stop = on_step is not None and on_step(iteration, x, value)
        return bool(stop) or here <= tolerance

    def factorised(model: Hessian, width: Array) -> Shifted | None:
        nonlocal factorisations
        if here > NEAR:
            return None
        found = positive_definite(*model.joint(width))
        factorisations += 0 if found is None else found.factorisations
        return found

    result = LargeMoves(energy)(
        q,
        gain_tolerance=0.0,
        reference=reference,
        max_iterations=max_iterations,
        on_step=report,
        forcing=FORCING,
        preconditioned=factorised,
    )
    here = residual(energy(result.x))
    q, status = result.x, result.status
    if status in (Status.CONVERGED, Status.STALLED) and tolerance < here <= NEAR:
        q, here, more = _polished(energy, q, residual, here, tolerance)
        factorisations += more
    if here <= tolerance:
        status = Status.CONVERGED
    elif status is Status.CONVERGED:
        status = Status.STALLED
    return Finish(replace(result, x=q, value=energy(q).value, status=status), here, factorisations)


def _polished(
    energy: ReducedEnergy, q: Array, residual: Callable[[ReducedPoint], float], here: float, tolerance: float
) -> tuple[Array, float, int]:
    """Newton steps that are judged by the residual: decreases of the value are rounding by now."""
    curvature, bound, count = Curvature(energy), energy.relocation.mesh_map.bound, 0
    while here > tolerance and count < POLISH:
        model, width = curvature.at(energy(q)), node_widths(energy.relocation, q)
        factor = positive_definite(*model.joint(width))
        if factor is None:
            break
        count += factor.factorisations
        step = PreconditionedStep(Scaled(model, width), width * energy(q).gradient, factor)
        low, high = (-bound - q) / width, (bound - q) / width
        move, _ = step.solve(np.maximum(low, -1.0), np.minimum(high, 1.0), EXACT)
        there = np.clip(q + width * move, -bound, bound)
        if not energy.is_defined(there) or not residual(energy(there)) < here:
            break
        q, here = there, residual(energy(there))
    return q, here, count
