"""Projected Newton-CG with a trust region for a smooth function in a box.

In the manner of TRON (C.-J. Lin, J. J. Moré, Newton's method for large bound-constrained
optimization problems, SIAM J. Optim. 9 (1999) 1100-1127): a Cauchy point, then conjugate
gradients over the variables that are free, with a projected search that lets many bounds become
active at once, again and again on the same quadratic model.

The trust region is a box too. TRON's ball stops a step where the conjugate gradients leave it
or meet negative curvature; the projection then shortens that step, so that the ball never grows
although the model is right. In a box the step ends in a corner of the trusted part of the box
instead, and the same model is used until it has nothing left to give: of the functions here, a
derivative costs as much as dozens of Hessian products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.nlp import Status

SUFFICIENT = 1e-4
"""Least ratio of actual to predicted decrease of an accepted step."""

MAX_PRODUCTS = 40
"""Hessian products of one step."""

FIRST_RADIUS = 0.5
"""First half-width of the trust region, as a part of the longest move of the scaled gradient step."""

WORTHWHILE = 0.06
"""Least part of a step's decrease that the last round of conjugate gradients must give."""

OVERSHOOT = 2.0
"""How far beyond the trust region, in its widths, a direction is followed before it is projected."""


class Model(Protocol):
    """A second-order model of the function at a point."""

    def __call__(self, d: Array) -> Array:
        """Hessian times ``d``."""

    def diagonal(self) -> Array:
        """A positive diagonal to scale the variables with."""


@dataclass(frozen=True)
class Evaluation:
    """Value and gradient at a point; ``model`` builds the Hessian there."""

    value: float
    gradient: Array
    model: Callable[[], Model]


@dataclass(frozen=True)
class NewtonResult:
    """Where the method stopped."""

    x: Array
    value: float
    status: Status
    iterations: int
    products: int


def minimise(
    evaluate: Callable[[Array], Evaluation | None],
    start: Array,
    lower: Array,
    upper: Array,
    *,
    tolerance: float = 1e-6,
    gain_tolerance: float = 0.0,
    reference: float | None = None,
    max_iterations: int = 200,
    forcing: float = 0.1,
    on_step: Callable[[int, Array, Evaluation], None] | None = None,
) -> NewtonResult:
    """Minimise in the box ``lower <= x <= upper``.

    Converged means two things: the point is stationary, and the model sees no decrease worth a
    step. On a fine mesh every point is nearly stationary, for each node has little to say.

    Parameters
    ----------
    evaluate : callable
        Value, gradient and model at a point of the box; None where the function is not
        defined (an element would be inverted), which makes the trust region shrink.
    start, lower, upper : (n,) arrays
    tolerance : float
        Stationary: ``max |x - proj(x - g / |f|)|`` is at most this.
    gain_tolerance : float
        No decrease: the model predicts less than this fraction of the decrease so far.
    reference : float, optional
        The value that decrease counts from; by default that at the start.
    max_iterations : int
    forcing : float
        Conjugate gradients stop at this fraction of the residual they began with.
    on_step : callable, optional
        Called with the iteration, the point and its evaluation.
    """
    x = np.clip(start, lower, upper)
    here = evaluate(x)
    if here is None:
        return NewtonResult(x, np.nan, Status.EVALUATION_ERROR, 0, 0)
    reference, products = here.value if reference is None else reference, 0
    radius = 0.0
    model = here.model()
    for iteration in range(max_iterations + 1):
        if on_step is not None:
            on_step(iteration, x, here)
        g = here.gradient
        unit = max(abs(here.value), 1e-300)
        residual = np.max(np.abs(x - np.clip(x - g / unit, lower, upper)), initial=0.0)
        if iteration == max_iterations:
            break
        accepted = False
        while not accepted:
            step = _Step(model, g)
            if radius == 0.0:
                newton_like = np.clip(x - g / step.scale, lower, upper) - x
                radius = FIRST_RADIUS * float(np.max(np.abs(newton_like), initial=0.0))
            s, predicted = step.solve(np.maximum(lower - x, -radius), np.minimum(upper - x, radius), forcing)
            products += step.products
            if residual <= tolerance and predicted <= gain_tolerance * (reference - here.value):
                return NewtonResult(x, here.value, Status.CONVERGED, iteration, products)
            if not np.any(s) or predicted <= 1e-16 * unit:
                status = Status.CONVERGED if residual <= tolerance else Status.STALLED
                return NewtonResult(x, here.value, status, iteration, products)
            trial = np.clip(x + s, lower, upper)
            there = evaluate(trial)
            actual = here.value - there.value if there is not None else -np.inf
            ratio = actual / predicted
            if ratio < 0.25:
                radius = 0.25 * float(np.max(np.abs(s)))
            elif ratio > 0.75:
                radius = 4 * radius
            if there is not None and ratio > SUFFICIENT:
                x, here, accepted = trial, there, True
                model = here.model()
    return NewtonResult(x, here.value, Status.ITERATION_LIMIT, max_iterations, products)


class _Step:
    """Minimises ``g . s + 1/2 s . H s`` approximately over a box that holds s = 0."""

    def __init__(self, model: Model, g: Array) -> None:
        self._model, self._g = model, g
        self.scale = model.diagonal()
        self.products = 0

    def solve(self, lower: Array, upper: Array, forcing: float) -> tuple[Array, float]:
        """A step within the box, and the decrease that the model predicts."""
        self._lower, self._upper = lower, upper
        s, Hs = self._cauchy()
        while self.products < MAX_PRODUCTS:
            free = (s > lower) & (s < upper)
            residual = np.where(free, self._g + Hs, 0.0)
            if self._dual_norm(residual) <= forcing * self._dual_norm(np.where(free, self._g, 0.0)):
                break
            w = self._conjugate_gradients(residual, free, forcing)
            moved, H_moved = self._projected_search(s, residual, w)
            decrease = -float(residual @ moved + 0.5 * moved @ H_moved)
            s, Hs = s + moved, Hs + H_moved
            if decrease <= WORTHWHILE * self._decrease(s, Hs):
                break
        return s, self._decrease(s, Hs)

    def _decrease(self, s: Array, Hs: Array) -> float:
        return float(-(self._g @ s + 0.5 * s @ Hs))

    def _product(self, d: Array) -> Array:
        self.products += 1
        return self._model(d)

    def _dual_norm(self, r: Array) -> float:
        return float(np.sqrt(r @ (r / self.scale)))

    def _clip(self, s: Array) -> Array:
        return np.clip(s, self._lower, self._upper)

    def _cauchy(self) -> tuple[Array, Array]:
        """Generalised Cauchy point along the projected scaled gradient."""
        direction = -self._g / self.scale
        alpha = 1.0
        s = self._clip(direction)
        while np.any(s):
            Hs = self._product(s)
            if self._g @ s + 0.5 * s @ Hs <= 0.01 * (self._g @ s):
                return s, Hs
            alpha *= 0.25
            s = self._clip(alpha * direction)
        return s, np.zeros_like(s)

    def _conjugate_gradients(self, residual: Array, free: NDArray[np.bool_], forcing: float) -> Array:
        """Steps over the free variables, until they converge or lead far out of the box."""
        far = OVERSHOOT * float(np.max(np.maximum(self._upper, -self._lower)))
        w, r = np.zeros_like(residual), -residual
        z = r / self.scale
        p, rz = z.copy(), float(r @ z)
        target = forcing**2 * rz
        while self.products < MAX_PRODUCTS:
            Hp = np.where(free, self._product(p), 0.0)
            curvature = float(p @ Hp)
            if curvature <= 0:
                return w + far / max(float(np.max(np.abs(p))), 1e-300) * p
            alpha = rz / curvature
            w, r = w + alpha * p, r - alpha * Hp
            z = r / self.scale
            rz, old = float(r @ z), rz
            if rz <= target or np.max(np.abs(w)) > far:
                break
            p = z + (rz / old) * p
        return w

    def _projected_search(self, s: Array, gradient: Array, w: Array) -> tuple[Array, Array]:
        """A step along the projected path of ``w`` that decreases the model."""
        beta = 1.0
        for _ in range(30):
            moved = self._clip(s + beta * w) - s
            H_moved = self._product(moved)
            slope = gradient @ moved
            if slope + 0.5 * moved @ H_moved <= 0.01 * np.minimum(slope, 0.0):
                return moved, H_moved
            beta *= 0.5
        return np.zeros_like(s), np.zeros_like(s)
