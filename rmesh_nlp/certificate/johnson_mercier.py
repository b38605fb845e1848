"""Equilibrated stresses of plane elasticity: the composite element of Johnson and Mercier [1]_.

A triangle is cut at its barycentre into three. The stress is symmetric and linear on each of them and its
tractions are continuous inside: 15 degrees of freedom, nine of them without divergence, which linear
tractions on the three edges (12 values, in equilibrium) determine. A body force that is linear on the
triangle is balanced by six more stresses, quadratic on each third, again with linear tractions on the edges.

References
----------
.. [1] C. Johnson, B. Mercier, Some equilibrium finite element methods for two-dimensional elasticity
   problems, Numer. Math. 30 (1978) 103-116.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rmesh_nlp.certificate.element import STRESS, Element, Pieces
from rmesh_nlp.certificate.polynomials import elevation
from rmesh_nlp.certificate.skeleton import AFTER
from rmesh_nlp.fem.bernstein import to_coefficients


@lru_cache
def johnson_mercier() -> Element:
    """Linear stresses on the thirds, and the quadratic ones of least values at vertices and midpoints."""
    thirds = np.stack([[*np.eye(3)[ends], np.full(3, 1 / 3)] for ends in AFTER])
    pieces = Pieces(STRESS, 1, thirds)
    return Element.among(pieces, pieces.fields(elevation(2, 3)), pieces.fields(to_coefficients(2, 3)))
