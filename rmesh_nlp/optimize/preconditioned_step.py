"""Steps of projected Newton-CG with a preconditioner other than the diagonal, and such preconditioners.

A preconditioner is a symmetric positive definite operator on gradients. On a face of the box its principal
part is taken, which is positive definite again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.newton_settings import StepSettings
from rmesh_nlp.optimize.newton_step import BoxStep, Model

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
