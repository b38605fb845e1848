"""Contact problems of random kind, seeded: for tests, studies and benchmarks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    PlaneStress,
    Relative,
    Traction,
)


def random_problem(seed: int, kind: str | None = None, order: int = 1) -> ContactProblem:
    """A problem of random kind with displacements of an order."""
    rng = np.random.default_rng(seed)
    nx, ny = rng.integers(3, 6), rng.integers(2, 5)
    mesh = rectangle(int(nx), int(ny), x=(0, 2), diagonal=["rising", "falling"][rng.integers(2)])
    inside, p = mesh.interior_nodes(), mesh.p.copy()
    p[:, inside] += rng.uniform(-0.15, 0.15, (2, inside.size)) / ny
    if rng.integers(2):
        mesh = named(mesh, subdomains={"a": lambda x: x[1] < 0.5, "b": lambda x: x[1] >= 0.5})
    mesh = replace(mesh, doflocs=p)
    c, kind = rng.uniform(-1, 1, 12), kind or ["scalar", "membrane", "elastic", "rough"][rng.integers(4)]
    motion = [Motion(Relative(0.3)), Motion((0.05, 0.05)), Motion(None, min_area_fraction=0.2)][
        rng.integers(3)
    ]
    zones = mesh.subdomains is not None
    chosen: dict[str, Any] = {"quadrature": 3 if order == 1 else "auto", "order": order}
    if kind in ("scalar", "membrane"):
        law: Any = Laplace(lambda x, y: -3 + 4 * c[0] * ca.sin(3 * x) + c[1] * x * y)
        law = {"a": law, "b": replace(law, conductivity=3.0)} if zones else law
        obstacle = (
            Obstacle("right", (1.0,), 0.1 * c[2])
            if kind == "scalar"
            else Obstacle.interior(-0.2 - 0.1 * c[2])
        )
        return ContactProblem(mesh, law, (Dirichlet("left", (0.1 * c[3],)),), obstacle, motion, **chosen)
    force = (lambda x, y: c[0] * x), (lambda x, y: -1 + c[1] * y * x)
    pressure = c[2], lambda x, y: -2 + c[3] * x
    law = [PlaneStrain, PlaneStress][rng.integers(2)](50 + 40 * c[4], 40 + 30 * c[5], force)
    law = {"a": law, "b": replace(law, lame_mu=100.0)} if zones else law
    obstacle = Obstacle.graph(
        "bottom",
        lambda x, y: -0.01 + 0.005 * c[6] * ca.sin(2 * x),
        friction=(lambda x, y: 0.5 + 0.3 * x) if kind == "rough" else 0.0,
    )
    return ContactProblem(
        mesh,
        law,
        (Dirichlet("left", (0.01 * c[7], 0.01 * c[8])),),
        obstacle,
        motion,
        (Traction("top", pressure),),
        **chosen,
    )
