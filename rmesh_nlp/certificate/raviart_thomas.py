"""Equilibrated fluxes of scalar problems: Raviart-Thomas elements of the second and third order [1]_.

For displacements of order k the flux is a polynomial of degree k on each edge, and balances a source of
degree k on each element. That of a lower order is cheaper, but its own error is as large as that of the
displacements.

References
----------
.. [1] D. Boffi, F. Brezzi, M. Fortin, Mixed finite element methods and applications, Springer 2013,
   section 2.3.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rmesh_nlp.certificate.element import FLUX, Element, Pieces
from rmesh_nlp.certificate.polynomials import elevation, powers
from rmesh_nlp.certificate.skeleton import CORNERS


@lru_cache
def raviart_thomas(degree: int) -> Element:
    """Polynomials phi of the degree in each component, and (x - centre) phi."""
    pieces, raising = Pieces(FLUX, degree, np.eye(3)[None]), elevation(degree + 1, 3)
    # a coefficient of the product has one more power of that coordinate whose vertex multiplies it
    added = powers(degree + 1, 3)[:, None] - powers(degree, 3)
    radial = np.einsum("fg,fgi,vi->fvg", raising, added, CORNERS - CORNERS.mean(axis=1, keepdims=True))
    return Element.among(pieces, pieces.fields(raising), radial[None])
