"""Contact problems of random kind, seeded: for tests, studies and benchmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Expression
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
    PositionFunction,
    Relative,
    Traction,
)


@dataclass(frozen=True)
class Frame:
    """x = turn @ X + shift, and the inverse for functions of position."""

    turn: np.ndarray
    shift: np.ndarray

    def scalar(self, f: PositionFunction) -> PositionFunction:
        """The same function of the material point."""
        return lambda x, y: f(*self._back(x, y))

    def vector(self, f: Callable[..., tuple[Expression, Expression]]) -> tuple[Expression, Expression]:
        """A turned vector field, component by component."""
        return (lambda x, y: self._turned(f, 0, x, y)), (lambda x, y: self._turned(f, 1, x, y))

    def _turned(
        self,
        f: Callable[..., tuple[Expression, Expression]],
        i: int,
        x: Expression,
        y: Expression,
    ) -> Expression:
        values = f(*self._back(x, y))
        return sum(self.turn[i, j] * values[j] for j in range(2))

    def _back(self, x: Expression, y: Expression) -> tuple[Expression, Expression]:
        a, b = x - self.shift[0], y - self.shift[1]
        return (
            self.turn[0, 0] * a + self.turn[1, 0] * b,
            self.turn[0, 1] * a + self.turn[1, 1] * b,
        )


STILL = Frame(np.eye(2), np.zeros(2))


def random_problem(
    seed: int, frame: Frame = STILL, kind: str | None = None, order: int = 1
) -> ContactProblem:
    """A problem of random kind with displacements of an order, seen from a frame."""
    rng = np.random.default_rng(seed)
    nx, ny = rng.integers(3, 6), rng.integers(2, 5)
    mesh = rectangle(int(nx), int(ny), x=(0, 2), diagonal=["rising", "falling"][rng.integers(2)])
    inside, p = mesh.interior_nodes(), mesh.p.copy()
    p[:, inside] += rng.uniform(-0.15, 0.15, (2, inside.size)) / ny
    if rng.integers(2):
        mesh = named(mesh, subdomains={"a": lambda x: x[1] < 0.5, "b": lambda x: x[1] >= 0.5})
    mesh = replace(mesh, doflocs=frame.turn @ p + frame.shift[:, None])
    c, kind = rng.uniform(-1, 1, 12), kind or ["scalar", "membrane", "elastic", "rough"][rng.integers(4)]
    motion = [Motion(Relative(0.3)), Motion((0.05, 0.05)), Motion(None, min_area_fraction=0.2)][
        rng.integers(3)
    ]
    zones = mesh.subdomains is not None
    chosen: dict[str, Any] = {"quadrature": 3 if order == 1 else "auto", "order": order}
    if kind in ("scalar", "membrane"):
        source = frame.scalar(lambda x, y: -3 + 4 * c[0] * ca.sin(3 * x) + c[1] * x * y)
        law: Any = Laplace(source)
        law = {"a": law, "b": replace(law, conductivity=3.0)} if zones else law
        obstacle = (
            Obstacle("right", (1.0,), 0.1 * c[2])
            if kind == "scalar"
            else Obstacle.interior(-0.2 - 0.1 * c[2])
        )
        return ContactProblem(mesh, law, (Dirichlet("left", (0.1 * c[3],)),), obstacle, motion, **chosen)
    force = frame.vector(lambda x, y: (c[0] * x, -1 + c[1] * y * x))
    pressure = frame.vector(lambda x, y: (c[2], -2 + c[3] * x))
    law = [PlaneStrain, PlaneStress][rng.integers(2)](50 + 40 * c[4], 40 + 30 * c[5], force)
    law = {"a": law, "b": replace(law, lame_mu=100.0)} if zones else law
    normal = tuple(frame.turn @ [0, 1])
    height = lambda x, y: -0.01 + 0.005 * c[6] * ca.sin(2 * x)  # noqa: E731
    obstacle = Obstacle(
        "bottom",
        normal,
        frame.scalar(lambda x, y: y - height(x, y)),
        frame.scalar(lambda x, y: 0.5 + 0.3 * x) if kind == "rough" else 0.0,
    )
    given_at_left = tuple(float(v) for v in frame.turn @ [0.01 * c[7], 0.01 * c[8]])
    return ContactProblem(
        mesh,
        law,
        (Dirichlet("left", given_at_left),),
        obstacle,
        motion,
        (Traction("top", pressure),),
        **chosen,
    )
