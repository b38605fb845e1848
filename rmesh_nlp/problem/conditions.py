"""Given displacements, loads and known solutions of a contact problem."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError, expect
from rmesh_nlp.evaluation import ROUNDING, largest_side
from rmesh_nlp.meshes.geometry import nodes_of
from rmesh_nlp.problem.coefficients import Coefficient, PositionFunction, as_tuple, convert
from rmesh_nlp.settings import Checked, Limit

T = TypeVar("T")


@dataclass(frozen=True)
class OnBoundary:
    """Values on a named boundary, one per displacement component; one alone may be given without a tuple."""

    boundary: str
    value: tuple[Coefficient | None, ...]

    def __post_init__(self) -> None:
        convert(self)


class Traction(OnBoundary):
    """A load on a named boundary.

    Parameters
    ----------
    boundary : str
        Its name.
    value : tuple of float or function of position, or one alone
        Force per area, one entry per displacement component.
    """

    value: tuple[Coefficient, ...]


class Dirichlet(OnBoundary):
    """Displacement given on a named boundary.

    Nodes fixed at a function of position do not move: sliding along curved
    data would let the optimiser lower the energy by representing the data worse.

    Parameters
    ----------
    boundary : str
        Its name.
    value : tuple of float, function of position or None, or one alone
        In units of length, one entry per displacement component; None where the component is free.
    """


@dataclass(frozen=True)
class PointLoad(Checked):
    """A force at one node, which does not move: the load would go with it.

    In the plane the energy under a point load has no bound as the mesh is refined, so energies of different
    meshes do not compare.

    Parameters
    ----------
    node : int
        Its number in the mesh.
    force : tuple of float
        Per unit thickness, one entry per displacement component.
    """

    node: Limit
    force: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        convert(self)


@dataclass(frozen=True)
class LoadStep:
    """What changes in one of several load steps; what it does not name stays as it was.

    Parameters
    ----------
    tractions : tuple of Traction
        Each in the place of all on its boundary.
    point_loads : tuple of PointLoad
        Each in the place of all at its node.
    dirichlet : tuple of Dirichlet
        Each in the place of what was given on its boundary.
    tools : mapping of str to tuple of float
        Forces of tools, by the boundaries that they meet.
    """

    tractions: tuple[Traction, ...] = ()
    point_loads: tuple[PointLoad, ...] = ()
    dirichlet: tuple[Dirichlet, ...] = ()
    tools: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.tools, Mapping):
            raise BadInputError(f"tools must map boundaries to forces, got {self.tools!r}", "tools")
        kinds = {"tractions": Traction, "point_loads": PointLoad, "dirichlet": Dirichlet}
        for name, kind in kinds.items():
            object.__setattr__(self, name, as_tuple(getattr(self, name)))
            for one in getattr(self, name):
                expect(f"a part of {name}", one, kind)


def changed(old: Iterable[T], new: Iterable[T], key: str) -> tuple[T, ...]:
    """Conditions of which new ones take the place of those with the same boundary, or node."""
    named = {getattr(part, key) for part in new}
    return (*(part for part in old if getattr(part, key) not in named), *new)


@dataclass(frozen=True)
class ExactSolution:
    """A known solution, or a reference in its place.

    Parameters
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


def symmetric(mesh: MeshTri, boundary: str, components: int = 2) -> Dirichlet:
    """The support of a boundary on an axis: its nodes stay on it and carry no force along it.

    A scalar problem has no given value there: no flux is the natural condition, and the support is empty.

    Raises
    ------
    BadInputError
        If the boundary is not parallel to an axis of coordinates.
    """
    extent = np.ptp(mesh.p[:, nodes_of(mesh, boundary)], axis=1)
    flat = extent <= ROUNDING * largest_side(mesh.p)
    if not np.any(flat):
        raise BadInputError(
            f"the boundary {boundary!r} is not parallel to an axis: symmetry needs one that is, turn the mesh"
        )
    if components == 1:
        return Dirichlet(boundary, (None,))
    return Dirichlet(boundary, (0.0, None) if flat[0] else (None, 0.0))
