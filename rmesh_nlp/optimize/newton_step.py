"""One step of projected Newton-CG: a quadratic model minimised approximately in a box.

A Cauchy point, by a projected search along the gradient, then rounds of conjugate gradients on the face of
the set where the step is, each with a projected search, all on the same model
(:mod:`rmesh_nlp.optimize.trust_region`).
"""

from __future__ import annotations

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
"""Least part of the slope that a projected search gives: mu_0 of Lin and Moré."""


class Model(Protocol):
    """A second-order model of the function at a point."""

    def __call__(self, d: Array) -> Array:
        """Hessian times ``d``."""

    def diagonal(self) -> Array:
        """A positive diagonal to scale the variables with."""


@dataclass(frozen=True)
class Scaled:
    """A model in units of the widths of a trust region."""

    model: Model
    width: Array

    def __call__(self, d: Array) -> Array:
        """Hessian times ``d``."""
        return self.width * self.model(self.width * d)

    def diagonal(self) -> Array:
        """A positive diagonal."""
        return self.width**2 * self.model.diagonal()


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
        s, Hs = self._projected_search(np.zeros_like(self._g), self._g, -self._g / self.scale)  # Cauchy point
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
        moved = self._clip(s + w) - s
        least = np.finfo(float).eps * np.max(self._upper - self._lower, initial=0.0)
        while np.any(np.abs(moved) > least):  # not so of NaN
            H_moved = self._product(moved)
            slope = gradient @ moved
            if slope + 0.5 * moved @ H_moved <= DECREASE * np.minimum(slope, 0.0):
                return moved, H_moved
            w = 0.5 * w
            moved = self._clip(s + w) - s
        return np.zeros_like(s), np.zeros_like(s)
