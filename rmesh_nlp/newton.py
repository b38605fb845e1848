"""Projected trust-region Newton-CG for a smooth function in a box, after TRON.

C.-J. Lin, J. J. Moré, Newton's method for large bound-constrained optimization problems,
SIAM J. Optim. 9 (1999) 1100-1127. Each step minimises the quadratic model in the box and the
trust region: a generalised Cauchy point decides which bounds are active, then preconditioned
conjugate gradients with Steihaug's stop minimise over the free variables, and a projected
search lets many bounds become active at once.
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

MAX_PRODUCTS = 200
"""Hessian products of one step."""


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
    max_iterations: int = 200,
    forcing: float = 0.1,
    on_step: Callable[[int, Array, Evaluation], None] | None = None,
) -> NewtonResult:
    """Minimise in the box ``lower <= x <= upper``.

    Parameters
    ----------
    evaluate : callable
        Value, gradient and model at a point of the box; None where the function is not
        defined (an element would be inverted), which makes the trust region shrink.
    start, lower, upper : (n,) arrays
    tolerance : float
        Stop when ``max |x - proj(x - g / |f|)|`` is below it.
    gain_tolerance : float
        Stop when the model predicts a decrease of less than this fraction of the decrease so far.
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
    first, products = here.value, 0
    radius = 0.0  # the first one is the length of the projected gradient step
    model = here.model()
    for iteration in range(max_iterations + 1):
        if on_step is not None:
            on_step(iteration, x, here)
        g = here.gradient
        unit = max(abs(here.value), 1e-300)
        if np.max(np.abs(x - np.clip(x - g / unit, lower, upper)), initial=0.0) <= tolerance:
            return NewtonResult(x, here.value, Status.CONVERGED, iteration, products)
        if iteration == max_iterations:
            break
        accepted = False
        while not accepted:
            step = _Step(model, x, g, lower, upper)
            if radius == 0.0:
                radius = step.norm(np.clip(x - g / step.scale, lower, upper) - x)
            s, predicted = step.solve(radius, forcing)
            products += step.products
            if predicted <= gain_tolerance * (first - here.value):
                return NewtonResult(x, here.value, Status.CONVERGED, iteration, products)
            length = step.norm(s)
            if length == 0 or predicted <= 1e-16 * unit:
                return NewtonResult(x, here.value, Status.STALLED, iteration, products)
            trial = np.clip(x + s, lower, upper)
            there = evaluate(trial)
            actual = here.value - there.value if there is not None else -np.inf
            ratio = actual / predicted
            if ratio < 0.25:
                radius = 0.25 * min(length, radius)
            elif ratio > 0.75 and length > 0.9 * radius:
                radius = 2.5 * radius
            if there is not None and ratio > SUFFICIENT:
                x, here, accepted = trial, there, True
                model = here.model()
    return NewtonResult(x, here.value, Status.ITERATION_LIMIT, max_iterations, products)


class _Step:
    """The trust-region problem at one point: minimise g.s + s.Hs/2 in the box."""

    def __init__(self, model: Model, x: Array, g: Array, lower: Array, upper: Array) -> None:
        self._model, self._g = model, g
        self._lower, self._upper = lower - x, upper - x
        self.scale = model.diagonal()
        self.products = 0

    def norm(self, s: Array) -> float:
        """Length of a step in the metric of the diagonal."""
        return float(np.sqrt(s @ (self.scale * s)))

    def solve(self, radius: float, forcing: float) -> tuple[Array, float]:
        """A step within the box and the radius, and the decrease that the model predicts."""
        s, Hs = self._cauchy(radius)
        for _ in range(s.size):
            free = (s > self._lower) & (s < self._upper)
            residual = np.where(free, self._g + Hs, 0.0)
            size = self._dual_norm(residual)
            if (
                size <= forcing * self._dual_norm(np.where(free, self._g, 0.0))
                or self.products > MAX_PRODUCTS
            ):
                break
            w, stopped = self._conjugate_gradients(residual, free, s, radius, forcing)
            moved, H_moved = self._projected_search(s, residual, w)
            s, Hs = s + moved, Hs + H_moved
            if stopped or not np.any(moved):
                break
        return s, float(-(self._g @ s + 0.5 * s @ Hs))

    def _product(self, d: Array) -> Array:
        self.products += 1
        return self._model(d)

    def _dual_norm(self, r: Array) -> float:
        return float(np.sqrt(r @ (r / self.scale)))

    def _clip(self, s: Array) -> Array:
        return np.clip(s, self._lower, self._upper)

    def _cauchy(self, radius: float) -> tuple[Array, Array]:
        """Generalised Cauchy point along the projected scaled gradient."""
        direction = -self._g / self.scale
        alpha = radius / max(self.norm(direction), 1e-300)
        s = self._clip(alpha * direction)
        while True:
            Hs = self._product(s)
            if self._g @ s + 0.5 * s @ Hs <= 0.01 * (self._g @ s) and self.norm(s) <= radius * (1 + 1e-12):
                return s, Hs
            alpha *= 0.25
            s = self._clip(alpha * direction)
            if not np.any(s):
                return s, np.zeros_like(s)

    def _conjugate_gradients(
        self, residual: Array, free: NDArray[np.bool_], s: Array, radius: float, forcing: float
    ) -> tuple[Array, bool]:
        """Steihaug's method on the free variables; True if it ended at the radius or by curvature."""
        w, r = np.zeros_like(s), -residual
        z = r / self.scale
        p, rz = z.copy(), float(r @ z)
        target = forcing**2 * rz
        while self.products < MAX_PRODUCTS:
            Hp = np.where(free, self._product(p), 0.0)
            curvature = float(p @ Hp)
            if curvature <= 0:
                return w + self._to_radius(s + w, p, radius) * p, True
            alpha = rz / curvature
            if self.norm(s + w + alpha * p) >= radius:
                return w + self._to_radius(s + w, p, radius) * p, True
            w, r = w + alpha * p, r - alpha * Hp
            z = r / self.scale
            rz, old = float(r @ z), rz
            if rz <= target:
                break
            p = z + (rz / old) * p
        return w, False

    def _to_radius(self, s: Array, p: Array, radius: float) -> float:
        """Positive tau with |s + tau p| = radius."""
        a, b = p @ (self.scale * p), s @ (self.scale * p)
        c = np.minimum(s @ (self.scale * s) - radius**2, 0.0)
        return float((-b + np.sqrt(b * b - a * c)) / a)

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
