"""One step of projected Newton-CG: a quadratic model minimised approximately in a box.

A Cauchy point, then rounds of conjugate gradients on the face of the set where the step is, each with a
projected search, all on the same model (:mod:`rmesh_nlp.optimize.trust_region`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array

WORTHWHILE = 0.06
"""Least part of a step's decrease that the last round of conjugate gradients must give."""

OVERSHOOT = 2.0
"""How far beyond the trust region, in its widths, a direction is followed before it is projected."""

DECREASE = 0.01
"""Least part of the slope that a Cauchy point and a projected search give: mu_0 of Lin and Moré."""

SHORTEN, SEARCHES = 0.5, 30
"""Factor of the steps that are tried for a Cauchy point and in a projected search, and most tries of that."""


class Model(Protocol):
    """A second-order model of the function at a point."""

    def __call__(self, d: Array) -> Array:
        """Hessian times ``d``."""

    def diagonal(self) -> Array:
        """A positive diagonal to scale the variables with."""


@dataclass(frozen=True)
class Operator:
    """A model made of its product and its diagonal."""

    product: Callable[[Array], Array]
    scale: Callable[[], Array]

    def __call__(self, d: Array) -> Array:
        """Hessian times ``d``."""
        return self.product(d)

    def diagonal(self) -> Array:
        """A positive diagonal."""
        return self.scale()


def scaled(model: Model, width: Array) -> Operator:
    """A model in units of the widths of a trust region."""
    return Operator(lambda d: width * model(width * d), lambda: width**2 * model.diagonal())


class BoxStep:
    """Minimises ``g . s + 1/2 s . H s`` approximately over a box that contains s = 0.

    The conjugate gradients are preconditioned by the inverse diagonal of the model.
    """

    def __init__(self, model: Model, g: Array, max_products: int) -> None:
        self._model, self._g = model, g
        self.scale, self.products, self.max_products = model.diagonal(), 0, max_products

    def within(self, lower: Array, upper: Array, forcing: float) -> tuple[Array, float]:
        """A step within the box, and the decrease that the model predicts."""
        self._lower, self._upper = lower, upper
        s, Hs = self._cauchy()
        while self.products < self.max_products:
            free = (s > self._lower) & (s < self._upper)
            gradient = self._g + Hs
            residual = np.where(free, gradient, 0.0)
            if self._dual_norm(residual) <= forcing * self._dual_norm(np.where(free, self._g, 0.0)):
                break
            w = self._conjugate_gradients(residual, free, forcing)
            moved, H_moved = self._projected_search(s, gradient, w)
            decrease = -float(gradient @ moved + 0.5 * moved @ H_moved)
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
        return float(np.sqrt(np.maximum(r @ (r / self.scale), 0.0)))

    def _clip(self, s: Array) -> Array:
        return np.clip(s, self._lower, self._upper)

    def _cauchy(self) -> tuple[Array, Array]:
        """Generalised Cauchy point along the projected scaled gradient."""
        direction = -self._g / self.scale
        alpha = 1.0
        s = self._clip(direction)
        while np.any(s):
            Hs = self._product(s)
            if self._g @ s + 0.5 * s @ Hs <= DECREASE * (self._g @ s):
                return s, Hs
            alpha *= SHORTEN
            s = self._clip(alpha * direction)
        return s, np.zeros_like(s)

    def _conjugate_gradients(self, residual: Array, free: NDArray[np.bool_], forcing: float) -> Array:
        """Steps over the free variables, until they converge or lead far out of the box."""
        far = OVERSHOOT * float(np.max(np.maximum(self._upper, -self._lower)))
        w, r = np.zeros_like(residual), -residual
        z = r / self.scale
        p, rz = z.copy(), float(r @ z)
        target = forcing**2 * rz
        while self.products < self.max_products:
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
        for _ in range(SEARCHES):
            moved = self._clip(s + beta * w) - s
            H_moved = self._product(moved)
            slope = gradient @ moved
            if slope + 0.5 * moved @ H_moved <= DECREASE * np.minimum(slope, 0.0):
                return moved, H_moved
            beta *= SHORTEN
        return np.zeros_like(s), np.zeros_like(s)
