"""A reference from outside: quadratic elements of scikit-fem and an active set of its own.

Nothing of `rmesh_nlp` is used. Plane strain, one material, a boundary clamped, a traction on another one, a
flat rigid foundation below a third one, without friction. Elements shrink geometrically towards the ends of
these boundaries, where the solution is singular, so that the error that is left is that of smooth parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import splu
from skfem import (
    Basis,
    BilinearForm,
    ElementTriP2,
    ElementVector,
    FacetBasis,
    LinearForm,
    MeshTri,
    condense,
)
from skfem.helpers import ddot, eye, sym_grad, trace

LAYERS = 12
"""Layers of elements, each half as large as the last one, around the ends of boundaries."""

NEAR = 2.0
"""Elements within so many of their own edges of such an end are refined."""


@dataclass(frozen=True)
class Plate:
    """What is solved: Young's modulus, Poisson's ratio, traction (2,) and height of the foundation."""

    young: float
    poisson: float
    traction: tuple[float, float]
    height: float
    clamped: str = "left"
    loaded: str = "load"
    contact: str = "bottom"


def energy(mesh: MeshTri, plate: Plate, refinements: int = 1) -> float:
    """Least energy on the polygon of a mesh, by quadratic elements on a refinement of it."""
    names = (plate.clamped, plate.loaded, plate.contact)
    lines = {name: _ends(mesh, name) for name in names}
    for _ in range(refinements):
        mesh = MeshTri(mesh.p, mesh.t).refined(1)
    corners = np.hstack(list(lines.values()))
    for _ in range(LAYERS):
        mesh = mesh.refined(_around(mesh, corners))
    facets = {name: _on_line(mesh, *ends.T) for name, ends in lines.items()}
    return _solved(mesh, facets, plate)


def _ends(mesh: MeshTri, name: str) -> np.ndarray:
    """(2, 2) the two ends of a straight boundary, one a column."""
    nodes = np.unique(mesh.facets[:, mesh.boundaries[name]])
    p = mesh.p[:, nodes]
    along = int(np.argmax(np.ptp(p, axis=1)))
    return p[:, [int(np.argmin(p[along])), int(np.argmax(p[along]))]]


def _around(mesh: MeshTri, corners: np.ndarray) -> np.ndarray:
    """Triangles close to one of some points (2, n)."""
    points = mesh.p[:, mesh.t]
    size = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=0).max(axis=0)
    close = np.zeros(mesh.t.shape[1], dtype=bool)
    for corner in corners.T:
        distance = np.linalg.norm(points - corner[:, None, None], axis=0).min(axis=0)
        smallest = size[distance < 1e-12 * np.max(size)].min()
        close |= (distance < NEAR * smallest) & (size > 0.6 * smallest)
    return np.flatnonzero(close)


def _on_line(mesh: MeshTri, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Boundary facets on the straight piece between two points."""
    facets = mesh.boundary_facets()
    length = float(np.linalg.norm(b - a))
    along, across = (b - a) / length, np.array([a[1] - b[1], b[0] - a[0]]) / length
    ends = mesh.p[:, mesh.facets[:, facets]] - a[:, None, None]
    s, off = np.einsum("c,cvf->vf", along, ends), np.einsum("c,cvf->vf", across, ends)
    tolerance = 1e-9 * length
    inside = (np.abs(off) < tolerance) & (s > -tolerance) & (s < length + tolerance)
    return np.asarray(facets[inside.all(axis=0)])


def _solved(mesh: MeshTri, facets: dict[str, np.ndarray], plate: Plate) -> float:
    element = ElementVector(ElementTriP2())
    basis = Basis(mesh, element)
    mu = plate.young / (2 * (1 + plate.poisson))
    lam = plate.young * plate.poisson / ((1 + plate.poisson) * (1 - 2 * plate.poisson))
    along, down = plate.traction

    def strain_energy(u, v, _):  # type: ignore[no-untyped-def]
        e = sym_grad(u)
        return ddot(2 * mu * e + lam * eye(trace(e), 2), sym_grad(v))

    stiffness = BilinearForm(strain_energy).assemble(basis)
    load = LinearForm(lambda v, _: along * v[0] + down * v[1]).assemble(
        FacetBasis(mesh, element, facets=facets[plate.loaded])
    )
    clamped = basis.get_dofs(facets[plate.clamped]).all()
    below = np.setdiff1d(basis.get_dofs(facets[plate.contact]).all(["u^2"]), clamped)
    gap = plate.height - basis.doflocs[1, below]
    active = np.zeros(below.size, dtype=bool)
    scale = float(abs(stiffness.diagonal()[below]).max())
    for _ in range(60):
        u = np.zeros(basis.N)
        u[below[active]] = gap[active]
        fixed = np.concatenate([clamped, below[active]])
        matrix, right, _, free = condense(stiffness, load, x=u, D=fixed)
        u[free] = splu(matrix.tocsc()).solve(right)
        force = (stiffness @ u - load)[below]
        new = force + scale * (gap - u[below]) > 0
        if np.array_equal(new, active):
            return float(u @ (stiffness @ u) / 2 - load @ u)
        active = new
    raise RuntimeError("the active set of the quadratic elements does not settle")
