"""Equilibrated fluxes of scalar problems: lowest-order Raviart-Thomas, by Crouzeix-Raviart.

Marini's formula [1]_: with the Crouzeix-Raviart solution w for a source f that is constant on each
element,

    tau = k grad w - f / 2 (x - x_T)

has continuous normal components and ``-div tau = f``. What a linear source has beyond its mean,
``sum_i g_i phi_i`` with sum g_i = 0, is balanced inside each element by bubbles of the next
Raviart-Thomas element, which have no normal component on its edges:

    b = -1/3 sum_i g_i phi_i (x - x_i),    -div b = sum_i g_i phi_i.

References
----------
.. [1] L. D. Marini, An inexpensive method for the evaluation of the solution of the lowest order
   Raviart-Thomas mixed method, SIAM J. Numer. Anal. 22 (1985) 493-496.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.energy import triangle_rule


@dataclass(frozen=True)
class RaviartThomas:
    """The elements of a scalar problem, and the work of their fluxes on the traces at their edges.

    The unknowns of an element are the means of the displacement over its three edges.

    Attributes
    ----------
    skeleton : Skeleton
    conductivity : (elements,) array
    load : (elements,) array
        Mean source.
    slope : (3, elements) array or None
        Values of the linear part of the source at the vertices, of mean zero; None for none.
    """

    skeleton: Skeleton
    conductivity: Array
    load: Array
    slope: Array | None = None

    @cached_property
    def stiffness(self) -> Array:
        """(elements, 3, 3): outflow through each edge by the trace on each."""
        normals = self.skeleton.normals
        weight = self.conductivity / self.skeleton.areas
        return np.asarray(np.einsum("cie,cje,e->eij", normals, normals, weight))

    @cached_property
    def source(self) -> Array:
        """(elements, 3): inflow through each edge at vanishing traces."""
        balanced = np.repeat((self.load * self.skeleton.areas / 3)[:, None], 3, axis=1)
        return balanced + np.einsum("cie,ce->ei", self.skeleton.normals, self._mean_bubble)

    @cached_property
    def mean_square_radius(self) -> Array:
        """(elements,) integrals of |x - x_T|^2."""
        return np.asarray(self.skeleton.areas * np.sum(self.skeleton.normals**2, axis=(0, 1)) / 36)

    @cached_property
    def _mean_bubble(self) -> Array:
        """(2, elements) mean of the bubbles: ``int phi_i (x - x_i) = |T| / 12 (sum_j x_j - 3 x_i)``."""
        if self.slope is None:
            return np.zeros((2, self.load.size))
        corners = self.skeleton.nodes[:, self.skeleton.triangles]
        return np.asarray(np.einsum("ie,cie->ce", self.slope, corners) / 12)

    def flux(self, traces: Array) -> Array:
        """(2, elements) mean fluxes for traces (elements, 3)."""
        weight = self.conductivity / self.skeleton.areas
        return np.asarray(np.einsum("cie,ei,e->ce", self.skeleton.normals, traces, weight))

    def energy(self, flux: Array) -> Array:
        """(elements,) integrals of ``|tau|^2 / (2 k)``, the fluxes given by their means (2, elements)."""
        constant = self.skeleton.areas * np.sum(flux**2, axis=0)
        return np.asarray((constant + self._square_of_rest) / (2 * self.conductivity))

    @cached_property
    def _square_of_rest(self) -> Array:
        """(elements,) integrals of the square of what the flux has beyond its mean."""
        if self.slope is None:
            return np.asarray(self.load**2 / 4 * self.mean_square_radius)
        barycentric, weights = triangle_rule(4)
        arms = self.skeleton.nodes[:, self.skeleton.triangles] - self.skeleton.centres[:, None]
        total = np.zeros(self.load.size)
        for phi, weight in zip(barycentric.T, weights, strict=True):
            x = np.einsum("i,cie->ce", phi, arms)
            bubble = -np.einsum("i,ie,cie->ce", phi, self.slope, x[:, None] - arms) / 3
            rest = -self.load / 2 * x + bubble - self._mean_bubble
            total += weight * np.sum(rest**2, axis=0)
        return total * self.skeleton.areas

    def outflow(self, flux: Array) -> Array:
        """(elements, 3) flux through each edge."""
        return np.asarray(np.einsum("cie,ce->ei", self.skeleton.normals, flux)) - self.source
