"""Equilibrated stresses of plane elasticity: the composite elements of Johnson and Mercier [1]_, [2]_.

A triangle is cut at its barycentre into three. The stress is symmetric and a polynomial of degree k on each
of them, and its tractions are continuous inside. For k = 1 these are 15 degrees of freedom, nine of them
without divergence, which linear tractions on the three edges (12 values, in equilibrium) determine; for k = 2
there are 18 without divergence, three more than quadratic tractions determine. Body forces of degree k on the
triangle are balanced by stresses of degree k + 1 on each third, with tractions of degree k on the edges.

References
----------
.. [1] C. Johnson, B. Mercier, Some equilibrium finite element methods for two-dimensional elasticity
   problems, Numer. Math. 30 (1978) 103-116.
.. [2] D. N. Arnold, J. Douglas, C. P. Gupta, A family of higher order mixed finite element methods for plane
   elasticity, Numer. Math. 45 (1984) 1-22.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from rmesh_nlp.certificate.element import STRESS, Element, Pieces
from rmesh_nlp.certificate.polynomials import elevation
from rmesh_nlp.certificate.skeleton import AFTER


@lru_cache
def johnson_mercier(degree: int) -> Element:
    """Stresses of a degree on the thirds, and those of the next one, of least coefficients, for loads."""
    thirds = np.stack([[*np.eye(3)[ends], np.full(3, 1 / 3)] for ends in AFTER])
    pieces, raising = Pieces(STRESS, degree, thirds), elevation(degree + 1, 3)
    return Element.among(pieces, pieces.fields(raising), pieces.fields(np.eye(len(raising))))
