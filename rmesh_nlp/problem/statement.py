"""What a contact problem consists of, before it is checked: mesh, laws, supports, loads, contact, motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.problem.coefficients import Coefficient, PositionFunction, on_points
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.motion import Motion
from rmesh_nlp.problem.obstacle import NO_CONTACT, Obstacle, Place

BY_VALIDITY = Motion(delta=None)
"""Motion limited by element validity alone."""


@dataclass(frozen=True)
class Traction:
    """A load per unit length on a named boundary, one coefficient per component."""

    boundary: str
    value: tuple[Coefficient, ...]


@dataclass(frozen=True)
class Dirichlet:
    """Displacement given on a named boundary.

    ``value`` has one entry per component: a number, a function of position, or None where the
    component is free. Nodes held at a function of position do not move: sliding along curved
    data would let the optimiser lower the energy by representing the data worse.
    """

    boundary: str
    value: tuple[Coefficient | None, ...]


@dataclass(frozen=True)
class ExactSolution:
    """A known solution, or a reference in its place.

    Attributes
    ----------
    value : function of position
        The displacement.
    energy : float
        Its energy J(u).
    symbol : casadi.SX or casadi.MX
        Kind of CasADi symbol that ``value`` takes: SX, or MX for what SX cannot express.
    """

    value: PositionFunction
    energy: float
    symbol: Any = ca.SX


@dataclass(frozen=True)
class Statement:
    """A contact problem as it is stated, see :class:`rmesh_nlp.problem.ContactProblem`.

    Attributes
    ----------
    mesh : skfem.MeshTri
        First-order triangles with named boundaries.
    law : Laplace, PlaneStrain, PlaneStress, or a mapping from subdomain names to laws
        A mapping must cover every triangle exactly once.
    dirichlet : tuple of str or Dirichlet
        Where the displacement is given; a plain name holds all components at zero.
    obstacle : Obstacle
        ``NO_CONTACT`` by default.
    motion : Motion
    tractions : tuple of Traction
    quadrature : "midpoint" or int
        Rule for the source or body force: the three edge midpoints (degree 2), or a degree.
    exact : ExactSolution, optional
    name, size : str
        For records and file names.
    """

    mesh: MeshTri
    law: Law | Mapping[str, Law]
    dirichlet: tuple[str | Dirichlet, ...]
    obstacle: Obstacle = NO_CONTACT
    motion: Motion = BY_VALIDITY
    tractions: tuple[Traction, ...] = ()
    quadrature: str | int = "midpoint"
    exact: ExactSolution | None = None
    name: str = "problem"
    size: str = field(default="")

    @property
    def laws(self) -> tuple[Law, ...]:
        """The law of each region."""
        return tuple(self.law.values()) if isinstance(self.law, Mapping) else (self.law,)

    @property
    def regions(self) -> tuple[tuple[Law, NDArray[np.int64]], ...]:
        """Each law with the numbers of its elements."""
        if not isinstance(self.law, Mapping):
            return ((self.law, np.arange(self.mesh.t.shape[1])),)
        return tuple((law, np.asarray(self.mesh.subdomains[name])) for name, law in self.law.items())

    @property
    def components(self) -> int:
        """Number of displacement components, 1 or 2."""
        return self.laws[0].components

    @property
    def frictional(self) -> bool:
        """Whether contact is with friction."""
        return self.obstacle.frictional

    @property
    def supports(self) -> tuple[Dirichlet, ...]:
        """``dirichlet`` with plain names written out as zeros."""
        zero = (0.0,) * self.components
        return tuple(Dirichlet(d, zero) if isinstance(d, str) else d for d in self.dirichlet)

    @property
    def triangles(self) -> NDArray[np.int64]:
        """(3, elements) vertex numbers, each triangle counter-clockwise."""
        return counter_clockwise(self.mesh.p, self.mesh.t)

    def boundary_nodes(self, names: tuple[str, ...]) -> NDArray[np.int64]:
        """Sorted numbers of the nodes on the named boundaries."""
        facets = [self.mesh.boundaries[name] for name in names]
        if not facets:
            return np.zeros(0, np.int64)
        return np.unique(self.mesh.facets[:, np.concatenate(facets)]).astype(np.int64)

    def held(self) -> tuple[NDArray[np.bool_], Array]:
        """Where displacement components are given, and their values: two (components, nodes) arrays."""
        shape = (self.components, self.mesh.p.shape[1])
        held, value = np.zeros(shape, dtype=bool), np.zeros(shape)
        for support in self.supports:
            nodes = self.boundary_nodes((support.boundary,))
            what = f"the displacement given on {support.boundary!r}"
            for i, coefficient in enumerate(support.value):
                if coefficient is None:
                    continue
                given = on_points(coefficient, self.mesh.p[:, nodes], what)
                scale = max(1.0, float(np.max(np.abs(given), initial=0.0)))
                clash = held[i, nodes] & (np.abs(value[i, nodes] - given) > 1e-12 * scale)
                if np.any(clash):
                    k = int(np.flatnonzero(clash)[0])
                    raise ProblemError(
                        "dirichlet",
                        f"{what} is {given[k]:.6g} at node {nodes[k]}, where another boundary gives "
                        f"{value[i, nodes[k]]:.6g}",
                    )
                held[i, nodes], value[i, nodes] = True, given
        return held, value

    @property
    def contact_nodes(self) -> NDArray[np.int64]:
        """Nodes of the contact set whose gap depends on a displacement that is not given."""
        place = self.obstacle.boundary
        if place is Place.NOWHERE:
            return np.zeros(0, np.int64)
        nodes = np.unique(self.mesh.t) if isinstance(place, Place) else self.boundary_nodes((place,))
        normal = np.array(self.obstacle.normal) != 0
        held, _ = self.held()
        return nodes[np.any(~held[:, nodes] & normal[:, None], axis=0)].astype(np.int64)
