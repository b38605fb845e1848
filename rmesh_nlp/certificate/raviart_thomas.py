"""Equilibrated fluxes of scalar problems: lowest-order Raviart-Thomas, by Crouzeix-Raviart.

Marini's formula [1]_: with the Crouzeix-Raviart solution w for a source f that is constant on each
element,

    tau = k grad w - f / 2 (x - x_T)

has continuous normal components and ``-div tau = f``.

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
    """

    skeleton: Skeleton
    conductivity: Array
    load: Array

    @cached_property
    def stiffness(self) -> Array:
        """(elements, 3, 3): outflow through each edge by the trace on each."""
        normals = self.skeleton.normals
        weight = self.conductivity / self.skeleton.areas
        return np.asarray(np.einsum("cie,cje,e->eij", normals, normals, weight))

    @cached_property
    def source(self) -> Array:
        """(elements, 3): inflow through each edge that balances the source."""
        return np.repeat((self.load * self.skeleton.areas / 3)[:, None], 3, axis=1)

    @cached_property
    def mean_square_radius(self) -> Array:
        """(elements,) integrals of |x - x_T|^2."""
        return np.asarray(self.skeleton.areas * np.sum(self.skeleton.normals**2, axis=(0, 1)) / 36)

    def flux(self, traces: Array) -> Array:
        """(2, elements) mean fluxes for traces (elements, 3)."""
        weight = self.conductivity / self.skeleton.areas
        return np.asarray(np.einsum("cie,ei,e->ce", self.skeleton.normals, traces, weight))

    def energy(self, flux: Array) -> Array:
        """(elements,) integrals of ``|tau|^2 / (2 k)``, the fluxes given by their means (2, elements)."""
        linear = self.load**2 / 4 * self.mean_square_radius
        return np.asarray((self.skeleton.areas * np.sum(flux**2, axis=0) + linear) / (2 * self.conductivity))

    def outflow(self, flux: Array) -> Array:
        """(elements, 3) flux through each edge."""
        return np.asarray(np.einsum("cie,ce->ei", self.skeleton.normals, flux)) - self.source
