"""Second derivatives of an objective with the bound of the error: exact where known, else by secants.

The bound is the upper less the lower bound of the energy. The second derivative of the upper one, the reduced
energy, is known; that of the rest is approximated by the symmetric rank-one formula [1]_ from the gradients
at the points that a descent passes,

    B + r r^T / (r . s),    r = y - B s,

s the step and y the change of the gradient, beginning with B = 0: the lower bound lies much closer to the
exact energy than the upper one, and changes less with the nodes.

References
----------
.. [1] J. Nocedal, S. J. Wright, Numerical optimization, Springer 2006, section 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.curvature import Curvature, Hessian
from rmesh_nlp.models.reduced import ReducedPoint
from rmesh_nlp.models.reduced_certificate import ReducedCertificate

MEMORY = 100
"""Secants that are kept; then they are forgotten all at once."""

SKIPPED = 1e-8
"""Cosine of the angle between r and s below which a secant is skipped, as in [1]_, (6.26)."""


class SecantCurvature:
    """Evaluates the approximation at the points of a descent, one after the other.

    Parameters
    ----------
    function : ReducedCertificate
    """

    def __init__(self, function: ReducedCertificate) -> None:
        self._function, self._upper = function, Curvature(function.upper)
        self._last: tuple[Array, Array] | None = None
        self._rest = _RankOnes((), ())

    def at(self, point: ReducedPoint) -> SecantHessian:
        """The approximation at a point, with the secant from the last one."""
        function = self._function
        upper = function.upper(point.q)
        rest = point.gradient - function.weight * upper.gradient
        if self._last is not None:
            self._rest = self._rest.with_secant(point.q - self._last[0], rest - self._last[1])
        self._last = point.q.copy(), rest
        return SecantHessian(function.weight, self._upper.at(upper), self._rest)


@dataclass(frozen=True)
class _RankOnes:
    """``sum_k r_k r_k^T / d_k``."""

    vectors: tuple[Array, ...]
    divisors: tuple[float, ...]

    def __call__(self, d: Array) -> Array:
        result = np.zeros_like(d)
        for r, divisor in zip(self.vectors, self.divisors, strict=True):
            result += np.multiply.outer(r, r @ d) / divisor
        return result

    def with_secant(self, s: Array, y: Array) -> _RankOnes:
        r = y - self(s)
        divisor = float(r @ s)
        if not abs(divisor) > SKIPPED * float(np.linalg.norm(r) * np.linalg.norm(s)):
            return self
        if len(self.vectors) == MEMORY:
            return _RankOnes((), ()).with_secant(s, y)
        return _RankOnes((*self.vectors, r), (*self.divisors, divisor))


@dataclass(frozen=True)
class SecantHessian:
    """The second derivative at one point."""

    weight: float
    upper: Hessian
    rest: _RankOnes

    def diagonal(self) -> Array:
        """Size of the diagonal, that of the upper bound."""
        return abs(self.weight) * self.upper.diagonal()

    def __call__(self, d: Array) -> Array:
        """The product with a vector, or with the columns of a matrix."""
        return self.weight * self.upper(d) + self.rest(d)
