"""One step of projected Newton-CG: a quadratic model minimised approximately in a box.

A Cauchy point, by a projected search along the gradient, then rounds of conjugate gradients on the face of
the set where the step is, each with a projected search, all on the same model
(:mod:`rmesh_nlp.optimize.trust_region`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Mask, magnitude
from rmesh_nlp.settings import Count, Factor, Part, Positive, Settings


@dataclass(frozen=True)
class NewtonSettings(Settings):
    """Settings of the descents.

    For the ratios see A. R. Conn, N. I. M. Gould, Ph. L. Toint, Trust-region methods, SIAM 2000, section 6.1;
    docs/notes/speed.md and docs/notes/large_moves.md have the benchmarks that chose the method.

    Attributes
    ----------
    sufficient : float
        Least ratio of actual to predicted decrease of an accepted step, and least part of the slope that a
        projected search gives.
    poor, good : float
        Ratios below and above which the trust region shrinks and grows.
    shrink, grow : float
        Its factors then. A direction is followed as far beyond the trust region as that may grow.
    forcing : float
        Conjugate gradients stop at this part of the residual they began with, and a step after the round of
        them that gives less than this part of its decrease.
    first_radius : float
        First half-width of the trust region, as a part of the longest component of the scaled gradient step;
        of local radii, in widths.
    max_products : int
        Hessian products of one step. On 6.1 with 128 squares a side they take 0.7 of the time of a step.
    """

    sufficient: Positive = 1e-4
    poor: Positive = 0.25
    good: Part = 0.75
    shrink: Part = 0.25
    grow: Factor = 2.0
    forcing: Part = 0.1
    first_radius: Positive = 0.5
    max_products: Count = 40

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sufficient <= self.poor < self.good:
            raise BadInputError(
                "a trust region needs sufficient <= poor < good, got "
                f"{self.sufficient!r}, {self.poor!r} and {self.good!r}"
            )


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

    def __init__(self, model: Model, g: Array, settings: NewtonSettings) -> None:
        self._model, self._g, self._settings = model, g, settings
        self.scale, self.products = model.diagonal(), 0

    def within(self, lower: Array, upper: Array) -> tuple[Array, float]:
        """A step within the box, and the decrease that the model predicts."""
        self._lower, self._upper, forcing = lower, upper, self._settings.forcing
        s, Hs = self._projected_search(np.zeros_like(self._g), self._g, -self._g / self.scale)  # Cauchy point
        while self.products < self._settings.max_products:
            free = (s > self._lower) & (s < self._upper)
            gradient = self._g + Hs
            residual = np.where(free, gradient, 0.0)
            if self._dual_norm(residual) <= forcing * self._dual_norm(np.where(free, self._g, 0.0)):
                break
            w = self._conjugate_gradients(residual, free)
            moved, H_moved = self._projected_search(s, gradient, w)
            decrease = -float(gradient @ moved + 0.5 * moved @ H_moved)
            s, Hs = s + moved, Hs + H_moved
            if decrease <= forcing * self._decrease(s, Hs):
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

    def _conjugate_gradients(self, residual: Array, free: Mask) -> Array:
        """Steps over the free variables, until they converge or lead far out of the box."""
        far = self._settings.grow * np.max(np.maximum(self._upper, -self._lower))
        w, r = np.zeros_like(residual), -residual
        z = r / self.scale
        p, rz = z.copy(), float(r @ z)
        target = self._settings.forcing**2 * rz
        while self.products < self._settings.max_products:
            Hp = np.where(free, self._product(p), 0.0)
            curvature = float(p @ Hp)
            if curvature <= 0:
                return w + far / max(magnitude(p), 1e-300) * p
            alpha = rz / curvature
            w, r = w + alpha * p, r - alpha * Hp
            z = r / self.scale
            rz, old = float(r @ z), rz
            if rz <= target or magnitude(w) > far:
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
            if slope + 0.5 * moved @ H_moved <= self._settings.sufficient * np.minimum(slope, 0.0):
                return moved, H_moved
            w = 0.5 * w
            moved = self._clip(s + w) - s
        return np.zeros_like(s), np.zeros_like(s)
