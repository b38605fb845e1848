"""Descents of an energy with a distortion: as far as the elements allow, without boxes.

Connects :func:`rmesh_nlp.optimize.local_newton.descend` with the mesh: how far a node is trusted, how far
a step may go before an element degenerates, and which model is used.

From the end of a cascade to a stationary point of the regularised energy.

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
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.mapping.validity import is_upright
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy, ReducedPoint
from rmesh_nlp.models.second_derivatives import Curvature, Hessian
from rmesh_nlp.optimize.local_newton import Scaled, descend
from rmesh_nlp.optimize.newton_settings import LocalNewtonSettings
from rmesh_nlp.optimize.newton_step import PreconditionedStep, Preconditioner, Shifted, positive_definite
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.trust_region import Evaluation, NewtonResult
from rmesh_nlp.problem import signed_areas

MODEL_RULE = 3
"""Degree of the quadrature rule of the loads in the second derivatives of the model.

Values and gradients have the rule of the problem. With 4 points in place of 12 a model of Example 6.1 costs
half, and descents go as far."""

KEPT = 0.1
"""Part of its present area that a step leaves to every element."""

OnPoint = Callable[[int, Array, float], bool | None]


class LargeMoves:
    """Descents of one regularised energy.

    Parameters
    ----------
    energy : ReducedEnergy
        Of a program whose objective has a distortion, which keeps the elements valid.
    settings : LocalNewtonSettings, optional
    approximate : bool
        Second derivatives with loads by a lower rule, see ``MODEL_RULE``: for descents that are not followed
        to a stationary point.

    Attributes
    ----------
    iterations, products : int
        So far, over all descents.
    """

    def __init__(
        self, energy: ReducedEnergy, settings: LocalNewtonSettings | None = None, approximate: bool = False
    ) -> None:
        if not energy.relocation.objective.has_barrier:
            raise ValueError("large moves need a distortion in the objective, or elements would be inverted")
        self.energy, self.relocation = energy, energy.relocation
        self._curvature = Curvature(energy, MODEL_RULE if approximate else None)
        self._settings = settings
        self.iterations = self.products = 0

    def __call__(
        self,
        q: Array,
        *,
        gain_tolerance: float,
        reference: float | None = None,
        max_iterations: int = 100,
        on_step: OnPoint | None = None,
        forcing: float | None = None,
        preconditioned: Callable[[Hessian, Array], Preconditioner | None] | None = None,
    ) -> NewtonResult:
        """Descend from moves ``q``; see :func:`rmesh_nlp.optimize.local_newton.descend`."""
        bound, before = self.relocation.mesh_map.bound, self.iterations
        result = descend(
            self._evaluate,
            q,
            -bound,
            bound,
            lambda x: node_widths(self.relocation, x),
            lambda x, s: longest_valid(self.relocation, x, s),
            gain_tolerance=gain_tolerance,
            reference=reference,
            max_iterations=max_iterations,
            forcing=forcing,
            settings=self._settings,
            preconditioned=preconditioned,
            on_step=None if on_step is None else lambda i, x, here: on_step(before + i, x, here.value),
        )
        self.iterations += result.iterations
        self.products += result.products
        return result

    def _evaluate(self, q: Array) -> Evaluation | None:
        if not is_upright(self.relocation.problem, self.relocation.nodes(q)):
            return None
        point = self.energy(q)
        if not np.isfinite(point.value):
            return None
        return Evaluation(point.value, point.gradient, lambda: self._curvature.at(point))


def node_widths(relocation: Relocation, q: Array) -> Array:
    """Least height of the elements at the node behind each move, in the unit of the move."""
    triangles, positions = relocation.problem.triangles, relocation.mesh_map.positions
    nodes = relocation.nodes(q)
    corner = nodes[:, triangles]
    edges = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=0)
    height = 2 * np.abs(signed_areas(nodes, triangles)) / edges.max(axis=0)
    least = np.full(nodes.shape[1], np.inf)
    for vertices in triangles:
        np.minimum.at(least, vertices, height)
    index = positions.index
    moving = index != CONSTANT
    # a move behind both coordinates, or of several tied nodes, is as wide as the narrowest allows
    steps = np.zeros(q.size)
    np.maximum.at(steps, index[moving], np.abs(positions.slopes(q))[moving])
    room = np.full(q.size, np.inf)
    np.minimum.at(room, index[moving], np.broadcast_to(least, index.shape)[moving])
    return np.asarray(room / np.maximum(steps, 1e-300))


def longest_valid(relocation: Relocation, q: Array, step: Array) -> float:
    """Part of a step, at most 1, that leaves every element ``KEPT`` of its area.

    The area is quadratic along the step; its first root is computed without cancellation.
    """
    triangles = relocation.problem.triangles
    here = relocation.nodes(q)
    move = (relocation.nodes(q + step) - here)[:, triangles]
    X = here[:, triangles]
    a, b, u, v = X[:, 1] - X[:, 0], X[:, 2] - X[:, 0], move[:, 1] - move[:, 0], move[:, 2] - move[:, 0]
    constant = (1 - KEPT) * (a[0] * b[1] - a[1] * b[0])
    linear = a[0] * v[1] - a[1] * v[0] + u[0] * b[1] - u[1] * b[0]
    square = u[0] * v[1] - u[1] * v[0]
    discriminant = linear**2 - 4 * square * constant
    with np.errstate(all="ignore"):
        middle = -0.5 * (linear + np.where(linear >= 0, 1.0, -1.0) * np.sqrt(discriminant))
        roots = np.stack([middle / square, constant / middle])
    real = np.isfinite(roots) & (roots > 0)
    return float(min(1.0, np.min(roots[real], initial=1.0)))


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
