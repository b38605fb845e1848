"""Shared problems. Small meshes only: large ones belong in the benchmark scripts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PiecewiseLinear, PlaneStrain, Traction

MPCC_COLLECTION = """
import casadi as ca

def names():
    return ["corner", "arms"]

def get(name):
    x = ca.SX.sym("x", 2)
    centre = {"corner": -1.0, "arms": 1.0}[name]
    inf = float("inf")
    return dict(x=x, f=ca.sumsqr(x - centre), g=ca.SX(0, 1), G=x[0], H=x[1], lbx=[-inf] * 2, ubx=[inf] * 2,
                lbg=[], ubg=[], x0=[0.5, 0.2], target={"corner": 2.0, "arms": 0.5}[name])
"""
"""Two MPCCs in the form of a collection that the benchmarks take."""


@pytest.fixture(params=["6.1", "6.2", "6.3"])
def example(request: pytest.FixtureRequest) -> ContactProblem:
    """Each of the paper's examples at the paper's size."""
    return EXAMPLES[request.param]()


@pytest.fixture
def sloped() -> ContactProblem:
    """A block whose lower edge rises in two straight pieces above a flat, rough foundation."""
    return sloped_block()


def sloped_block(friction: float = 60.0) -> ContactProblem:
    alpha = PiecewiseLinear((0.0, 2.0, 4.0), (0.0, 0.02, 0.1))
    mesh = MeshTri.init_tensor(np.linspace(0, 4, 9), np.linspace(0, 1, 4))
    p = mesh.p.copy()
    height = np.interp(p[0], alpha.x, alpha.y)
    p[1] = height + p[1] * (1 - height)
    mesh = replace(mesh, doflocs=p).with_boundaries(
        {
            "left": lambda x: np.isclose(x[0], 0),
            "top": lambda x: np.isclose(x[1], 1),
            "contact": lambda x: (x[1] < 0.11) & (x[0] > 1e-9) & (x[0] < 4 - 1e-9),
        }
    )
    return ContactProblem(
        mesh=mesh,
        law=PlaneStrain(1.15e4, 0.83e4, body_force=(0.0, lambda x, y: -20 * x)),
        dirichlet=("left",),
        obstacle=Obstacle("contact", normal=(0.0, 1.0), offset=alpha, friction=friction),
        motion=Motion((0.1, 0.05)),
        tractions=(Traction("top", (-20.0, lambda x, y: -30 * x)),),
        name="sloped",
    )
