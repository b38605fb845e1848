"""Blocks that lie on each other, with nodes in pairs, and lines inside a body."""

from typing import Any

import numpy as np
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.meshes import from_arrays
from rmesh_nlp.meshes.geometry import counter_clockwise

STEEL = rm.PlaneStrain.from_young(young=1000.0, poisson=0.3)


def stacked(count: int = 2, n: tuple[int, int] = (4, 2), irregular: float = 0.15) -> MeshTri:
    """Blocks (0, 2) x (k, k + 1), k = 0, 1, ..., with edges bottom-k, top-k, left-k, right-k, body-k."""
    rng = np.random.default_rng(3)
    x, y = np.linspace(0, 2, n[0] + 1), np.linspace(0, 1, n[1] + 1)
    x[1:-1] += irregular * rng.uniform(-1, 1, n[0] - 1) * 2 / n[0]
    grid = MeshTri.init_tensor(x, y)
    size, inside = grid.p.shape[1], np.setdiff1d(np.arange(grid.p.shape[1]), grid.boundary_nodes())
    nodes, triangles, boundaries, subdomains = [], [], dict[str, Any](), dict[str, Any]()
    for k in range(count):
        p = np.array(grid.p)
        p[:, inside] += irregular * rng.uniform(-1, 1, (2, inside.size)) / np.array([[n[0] / 2], [n[1]]])
        nodes.append(p + np.array([[0], [k]]))
        triangles.append(counter_clockwise(grid.p, grid.t) + k * size)
        subdomains[f"body-{k}"] = k * grid.nelements + np.arange(grid.nelements)
        for name, axis, value in (("bottom", 1, 0), ("top", 1, 1), ("left", 0, 0), ("right", 0, 2)):
            facets = grid.facets_satisfying(lambda at, a=axis, v=value: np.isclose(at[a], v))
            boundaries[f"{name}-{k}"] = grid.facets[:, facets].T + k * size
    pairs = [(f"bottom-{k + 1}", f"top-{k}") for k in range(count - 1)]
    return from_arrays(np.hstack(nodes).T, np.hstack(triangles).T, boundaries, subdomains, pairs)


def pressed(mesh: MeshTri, *obstacles: rm.Obstacle, **changes: Any) -> rm.ContactProblem:
    """Blocks on rollers at the bottom and the left, under a pressure of 5 on the top."""
    last = sum(name.startswith("left") for name in mesh.boundaries) - 1
    rollers = [rm.Dirichlet(f"left-{k}", (0.0, None)) for k in range(last + 1)]
    given: dict[str, Any] = {
        "law": STEEL,
        "dirichlet": (rm.Dirichlet("bottom-0", (None, 0.0)), *rollers),
        "tractions": rm.Traction(f"top-{last}", (0.0, -5.0)),
    }
    pairs = tuple(rm.Obstacle.pair(f"bottom-{k + 1}", f"top-{k}") for k in range(last))
    return rm.ContactProblem(mesh=mesh, obstacle=obstacles or pairs, **(given | changes))
