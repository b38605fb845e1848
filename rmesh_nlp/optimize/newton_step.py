"""One step of projected Newton-CG: a quadratic model minimised approximately in a box that walls may cut.

A Cauchy point, then rounds of conjugate gradients on the face of the set where the step is, each with a
projected search, all on the same model (:mod:`rmesh_nlp.optimize.trust_region`).

Steps of projected Newton-CG with a preconditioner other than the diagonal, and such preconditioners.

A preconditioner is a symmetric positive definite operator on gradients. On a face of the box its principal
part is taken, which is positive definite again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.constraints import Polyhedron, Wall
from rmesh_nlp.optimize.newton_settings import NewtonSettings, StepSettings


class Model(Protocol):
    """A second-order model of the function at a point."""

    def __call__(self, d: Array) -> Array:
        """Hessian times ``d``."""

    def diagonal(self) -> Array:
        """A positive diagonal to scale the variables with."""


class BoxStep:
    """Minimises ``g . s + 1/2 s . H s`` approximately over a box that holds s = 0."""

    def __init__(self, model: Model, g: Array, settings: StepSettings | None = None) -> None:
        self._model, self._g, self._settings = model, g, settings or StepSettings()
        self.max_products = self._settings.max_products
        self.scale = model.diagonal()
        self.products = 0

    def solve(self, lower: Array, upper: Array, forcing: float) -> tuple[Array, float]:
        """A step within the box, and the decrease that the model predicts."""
        self._lower, self._upper = lower, upper
        s, Hs = self._cauchy()
        while self.products < self.max_products:
            free = self._face(s)
            gradient = self._g + Hs
            residual = np.where(free, gradient, 0.0)
            if self._dual_norm(residual) <= forcing * self._dual_norm(np.where(free, self._g, 0.0)):
                break
            w = self._conjugate_gradients(residual, free, forcing)
            moved, H_moved = self._projected_search(s, gradient, w)
            decrease = -float(gradient @ moved + 0.5 * moved @ H_moved)
            s, Hs = s + moved, Hs + H_moved
            if decrease <= self._settings.worthwhile * self._decrease(s, Hs):
                break
        return s, self._decrease(s, Hs)

    def rows_held(self, s: Array) -> int:
        """Number of the rows of a wall that hold a step."""
        return 0

    def _decrease(self, s: Array, Hs: Array) -> float:
        return float(-(self._g @ s + 0.5 * s @ Hs))

    def _product(self, d: Array) -> Array:
        self.products += 1
        return self._model(d)

    def _dual_norm(self, r: Array) -> float:
        return float(np.sqrt(np.maximum(r @ self._precondition(r), 0.0)))

    def _precondition(self, r: Array) -> Array:
        return r / self.scale

    def _face(self, s: Array) -> NDArray[np.bool_]:
        """The variables that no bound holds at ``s``."""
        return (s > self._lower) & (s < self._upper)

    def _clip(self, s: Array) -> Array:
        return np.clip(s, self._lower, self._upper)

    def _cauchy(self) -> tuple[Array, Array]:
        """Generalised Cauchy point along the projected scaled gradient."""
        direction = -self._g / self.scale
        alpha = 1.0
        s = self._clip(direction)
        while np.any(s):
            Hs = self._product(s)
            if self._g @ s + 0.5 * s @ Hs <= self._settings.decrease * (self._g @ s):
                return s, Hs
            alpha *= self._settings.shorten_cauchy
            s = self._clip(alpha * direction)
        return s, np.zeros_like(s)

    def _conjugate_gradients(self, residual: Array, free: NDArray[np.bool_], forcing: float) -> Array:
        """Steps over the free variables, until they converge or lead far out of the box."""
        far = self._settings.overshoot * float(np.max(np.maximum(self._upper, -self._lower)))
        w, r = np.zeros_like(residual), -residual
        z = self._precondition(r)
        p, rz = z.copy(), float(r @ z)
        target = forcing**2 * rz
        while self.products < self.max_products:
            Hp = np.where(free, self._product(p), 0.0)
            curvature = float(p @ Hp)
            if curvature <= 0:
                return w + far / max(float(np.max(np.abs(p))), 1e-300) * p
            alpha = rz / curvature
            w, r = w + alpha * p, r - alpha * Hp
            z = self._precondition(r)
            rz, old = float(r @ z), rz
            if rz <= target or np.max(np.abs(w)) > far:
                break
            p = z + (rz / old) * p
        return w

    def _projected_search(self, s: Array, gradient: Array, w: Array) -> tuple[Array, Array]:
        """A step along the projected path of ``w`` that decreases the model."""
        beta = 1.0
        for _ in range(self._settings.searches):
            moved = self._clip(s + beta * w) - s
            H_moved = self._product(moved)
            slope = gradient @ moved
            if slope + 0.5 * moved @ H_moved <= self._settings.decrease * np.minimum(slope, 0.0):
                return moved, H_moved
            beta *= self._settings.shorten
        return np.zeros_like(s), np.zeros_like(s)


class WalledStep(BoxStep):
    """The same where the linearised rows of a wall hold too; conjugate gradients run along active ones."""

    def __init__(self, model: Model, g: Array, wall: Wall, settings: NewtonSettings | None = None) -> None:
        chosen = settings or NewtonSettings()
        super().__init__(model, g, chosen.step)
        self.max_products = chosen.step.max_products_walled
        self._wall, self._projection = wall, chosen.projection

    def solve(self, lower: Array, upper: Array, forcing: float) -> tuple[Array, float]:
        """A step within the box and the rows, and the decrease that the model predicts."""
        room = self._wall.slack - self._wall.floor
        self._set = Polyhedron(lower, upper, room, self._wall.jacobian, self.scale, self._projection)
        return super().solve(lower, upper, forcing)

    def rows_held(self, s: Array) -> int:
        """Number of the rows of the wall that hold a step."""
        return int(self._set.active(s).size)

    def multipliers(self, s: Array) -> Array:
        """What the rows that hold the step ``s`` pull with, by least squares; not negative."""
        result, active = np.zeros(self._wall.slack.size), self._set.active(s)
        if active.size:
            self._face(s)
            result[active] = np.maximum(self._along.multipliers(self._g + self._product(s)), 0.0)
        return result

    def _clip(self, s: Array) -> Array:
        return self._set.nearest(s)

    def _face(self, s: Array) -> NDArray[np.bool_]:
        free = super()._face(s)
        self._along = self._set.face(self._set.active(s), free)
        return free

    def _precondition(self, r: Array) -> Array:
        return self._along.precondition(r)


Preconditioner = Callable[[Array], Array]

FIRST_SHIFT = 1e-3
"""First multiple of the mean diagonal that is added to an indefinite matrix."""

GROWTH = 10.0
"""Factor between shifts."""

LARGEST_SHIFT = 1e6
"""Shift at which a matrix counts as none that can be used."""


class PreconditionedStep(BoxStep):
    """The step of :class:`~rmesh_nlp.optimize.newton_step.BoxStep` by preconditioned conjugate gradients.

    Parameters
    ----------
    model : Model
    g : (n,) array
    preconditioner : callable
        See the module.
    settings : StepSettings, optional
    """

    def __init__(
        self, model: Model, g: Array, preconditioner: Preconditioner, settings: StepSettings | None = None
    ) -> None:
        super().__init__(model, g, settings)
        self._apply = preconditioner
        self._free: NDArray[np.bool_] | None = None

    def _face(self, s: Array) -> NDArray[np.bool_]:
        self._free = super()._face(s)
        return self._free

    def _precondition(self, r: Array) -> Array:
        z = self._apply(r)
        return z if self._free is None else np.where(self._free, z, 0.0)


@dataclass(frozen=True)
class Shifted:
    """A factorised symmetric matrix, made positive definite by a multiple of the identity on a part of it.

    Attributes
    ----------
    factor : SuperLU
        Of ``matrix + shift I`` on the first ``n`` unknowns.
    n : int
        The part that is shifted.
    shift : float
        In units of the mean size of the diagonal of that part.
    factorisations : int
        That it took to find the shift.
    """

    factor: Any
    n: int
    shift: float
    factorisations: int

    def __call__(self, r: Array) -> Array:
        """The first n unknowns of the inverse times ``r`` (n,), zero on the others."""
        whole = np.zeros(self.factor.shape[0])
        whole[: self.n] = r
        return np.asarray(self.factor.solve(whole)[: self.n])


def positive_definite(matrix: sp.csc_array, n: int, shift: float = 0.0) -> Shifted | None:
    """Factorise ``matrix + shift I`` with the least shift of a sequence that makes it positive definite.

    ``L D L^T`` without interchanges: by Sylvester's law of inertia the signs of D are those of the
    eigenvalues. The identity is that of the first n unknowns; the matrix must be positive definite
    on the others.

    Parameters
    ----------
    matrix : (m, m) sparse array
        Symmetric.
    n : int
    shift : float
        To begin with, in units of the mean size of the diagonal.

    Returns
    -------
    Shifted or None
        None if no shift helps.
    """
    unit = max(float(np.mean(np.abs(matrix.diagonal()[:n]))), 1e-300)
    on_first = sp.diags_array(np.where(np.arange(matrix.shape[0]) < n, unit, 0.0), format="csc")
    count = 0
    while shift <= LARGEST_SHIFT:
        factor, count = _signed_factor(sp.csc_array(matrix + shift * on_first)), count + 1
        if factor is not None:
            return Shifted(factor, n, shift, count)
        shift = GROWTH * shift if shift else FIRST_SHIFT
    return None


def _signed_factor(matrix: sp.csc_array) -> Any:
    """The factors, or None if a pivot is not positive."""
    indices, starts = (a.astype(np.int32, copy=False) for a in (matrix.indices, matrix.indptr))
    matrix = sp.csc_array((matrix.data, indices, starts), shape=matrix.shape)
    try:
        factor = splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError:  # exactly singular
        return None
    if not np.array_equal(factor.perm_r, factor.perm_c) or np.min(factor.U.diagonal(), initial=1.0) <= 0:
        return None
    return factor
