"""What the part of a load that an equilibrated field leaves out can do at most.

The field balances a simplified load f_h (and tractions g_h) whose difference from the true one is
orthogonal to the rigid motions of each element. For every displacement v

    int_T (f - f_h) . v + int_e (g - g_h) . v  <=  r_T |v|_T,

|v|_T the energy norm on the element (twice the strain energy, its root). Constants:

- Poincare on a triangle of diameter h: ``|v| <= h / j |grad v|`` for v of mean zero, j = 3.8317 the
  first zero of the Bessel function J_1 [1]_.
- Trace, from the divergence theorem with the field x - (opposite vertex):
  ``|v|_e^2 <= |e| / |T| (|v|^2 + h |v| |grad v|)``.
- Korn, for v without mean rotation: ``|grad v|^2 <= 2 / beta^2 |eps(v)|^2``, beta the inf-sup constant of the
  divergence; for a domain that is star-shaped about a ball of radius rho and lies in the concentric ball of
  radius R, ``beta >= rho / (R sqrt(2)) (1 + sqrt(1 - rho^2 / R^2))^(-1/2)`` [2]_. Here the centre is that
  of the inscribed circle.

References
----------
.. [1] R. S. Laugesen, B. A. Siudeja, Minimizing Neumann fundamental tones of triangles: an optimal Poincare
   inequality, J. Differential Equations 249 (2010) 118-135.
.. [2] M. Costabel, M. Dauge, On the inequalities of Babuska-Aziz, Friedrichs and Horgan-Payne, Arch. Ration.
   Mech. Anal. 217 (2015) 873-898.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array

POINCARE = 1 / 3.8317
"""Of a triangle of diameter 1; 3.8317 is below the first zero of J_1."""


def korn(skeleton: Skeleton) -> Array:
    """(elements,) constants K with ``|grad v| <= K |eps(v)|`` for v without mean rotation."""
    lengths = skeleton.lengths[skeleton.edges]
    perimeter = lengths.sum(axis=0)
    inner = 2 * skeleton.areas / perimeter
    centre = np.einsum("ie,cie->ce", lengths / perimeter, skeleton.corners)
    to_corners = skeleton.corners - centre[:, None]
    ratio = inner / np.max(np.linalg.norm(to_corners, axis=0), axis=0)
    beta_squared = ratio**2 / (2 * (1 + np.sqrt(1 - ratio**2)))
    return np.sqrt(2 / beta_squared)


def oscillation(skeleton: Skeleton, load: Array, edges: Array, gradient_by_energy: Array) -> Array:
    """r_T (elements,) in units of the energy norm.

    ``load`` (elements,) are the L2 norms of f - f_h, ``edges`` (edges,) those of g - g_h, and
    ``gradient_by_energy`` (elements,) constants c with ``|grad v| <= c |v|_T``, rigid motions apart.
    """
    h = skeleton.diameters
    loaded = np.flatnonzero(edges > 0)
    element = skeleton.owner[loaded]
    ratio = skeleton.lengths[loaded] / skeleton.areas[element]
    trace = h[element] * np.sqrt(ratio * (POINCARE**2 + POINCARE))
    total = POINCARE * h * load + np.bincount(element, trace * edges[loaded], h.size)
    return total * gradient_by_energy
