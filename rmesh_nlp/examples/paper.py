"""The paper's Examples 6.1, 6.2 and 6.3 and the figures that they are compared with.

Haslinger, Neittaanmäki, Salmenjoki, "On FE-grid relocation in solving unilateral boundary
value problems by FEM", Applications of Mathematics 37 (1992) 105-122, section 6.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Integral

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError, require, unknown
from rmesh_nlp.evaluation import Expression
from rmesh_nlp.meshes.curves import Two
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    ExactSolution,
    Laplace,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    PositionFunction,
    Traction,
    Units,
)
from rmesh_nlp.problem.coefficients import POSITION, as_tuple

Size = int | tuple[int, int] | str
"""``8``, ``(12, 6)`` or ``"12x6"``, columns by rows."""

Delta = float | Two | str
"""``0.02``, ``(0.02, 0.01)``, ``"0.02,0.01"`` along x and y, or ``"none"``."""


@dataclass(frozen=True)
class PaperValues:
    """Figures printed in section 6 (truncated there, not rounded), and the paper's settings.

    ``enlarged``: where no start reaches ``energy_final`` within the move limits, factors by which
    ``rmesh reproduce`` enlarges them.
    """

    size: tuple[int, int]
    delta: Two
    energy_initial: float
    energy_final: float
    u_min_initial: float | None = None
    u_max_initial: float | None = None
    enlarged: tuple[float, ...] = ()


PAPER = {
    "6.1": PaperValues((8, 8), (0.0275, 0.0275), -1.1246, -1.4445, -0.4549, 0.4753),
    "6.2": PaperValues((12, 6), (0.15667, 0.07333), -4.8541, -4.9188, enlarged=(1.5, 2.0)),
    "6.3": PaperValues((12, 6), (0.08333, 0.04166), -0.6099, -0.6211, enlarged=(2.0, 4.0)),
}

PRINTED_DIGITS = 4
"""Decimals of the paper's figures; it truncates, so that -1.124602 is printed as -1.1246."""

EXACT_ENERGY_61 = -(625 / 2016 + 125 * np.pi**2 / 202752 + 125 * (220 + 7 * np.pi**2) / 22176)
"""J(u) of Example 6.1, -1.9456096613, as printed in closed form in section 6."""

RULES: dict[int, str] = {1: "midpoint", 2: "auto"}
"""Quadrature rules by the order of displacements: the paper's is too coarse for quadratic ones."""

MATERIAL = PlaneStrain(lame_lambda=1.15e4, lame_mu=0.83e4)
LOAD = 57.5


def truncated(value: float) -> int:
    """The value in units of the last printed digit, cut off toward zero."""
    # a printed value such as -1.1246 is not a binary fraction: nudge before cutting
    return math.trunc(value * 10**PRINTED_DIGITS + math.copysign(1e-6, value))


def exact_displacement_61(x: Expression, y: Expression) -> Expression:
    """The exact solution (6.2); 2 x_2^3 - 2 x_2^2 + x_2 / 2 is written as 2 x_2 (1/2 - x_2)^2."""
    quartic = ((0.5 - y) ** 2) ** 2  # squares are products to CasADi, fourth powers call pow
    lower = 200 * y * quartic * ca.sin(2 * np.pi * x)
    upper = 100 * (1 - y) * quartic * ca.sin(np.pi * x / 2)
    return ca.if_else(y <= 0.5, lower, upper)


def negative_laplacian(u: PositionFunction) -> PositionFunction:
    """``-Laplace(u)`` by symbolic differentiation, as a function of position."""
    x, y = POSITION
    value = u(x, y)
    return ca.Function(
        "source", [x, y], [-ca.jacobian(ca.jacobian(value, x), x) - ca.jacobian(ca.jacobian(value, y), y)]
    )


def example_61(n: Size = 8, delta: Delta | None = None, order: int = 1) -> ContactProblem:
    """Example 6.1: -Laplace(u) = f on the unit square, u >= 0 on x_1 = 1, u = 0 elsewhere.

    Parameters
    ----------
    n : int, (int, int) or "12x6"
        Squares per side, each cut from lower left to upper right.
    delta : float, (float, float) or "none", optional
        Half-widths of the move limits, in units of length; by default the paper's, scaled with the mesh
        width.
    order : 1 or 2
        Of the displacements; the paper's are linear, 1.

    Notes
    -----
    The printed source (6.1) is misprinted; f is derived from the exact solution (6.2).
    """
    nx, ny = as_size(n)
    mesh = rectangle(nx, ny, diagonal="rising")
    names = {"left": "left", "bottom": "bottom", "top": "top", "contact": "right"}
    mesh = replace(mesh, _boundaries={name: mesh.boundaries[side] for name, side in names.items()})
    return ContactProblem(
        mesh=mesh,
        law=Laplace(source=negative_laplacian(exact_displacement_61)),
        dirichlet=("left", "bottom", "top"),
        obstacle=Obstacle("contact", normal=(1.0,)),
        motion=Motion(_delta(delta, "6.1", (nx, ny))),
        exact=ExactSolution(exact_displacement_61, EXACT_ENERGY_61),
        quadrature=RULES.get(order, "auto"),
        name="6.1",
        size=f"{nx}" if nx == ny else f"{nx}x{ny}",
        order=order,
    )


def example_62(n: Size = (12, 6), delta: Delta | None = None, order: int = 1) -> ContactProblem:
    """Example 6.2: elastic body (0,4) x (0.05,1) above a rigid foundation, no friction.

    Held on x_1 = 0, pressed down by 57.5 N/m^2 on the top where x_1 > 2; initial distance
    alpha = 0.05. The grid is the uniform one of (0,4) x (0,1) with its bottom row moved up, so it
    must have fewer than 20 rows of squares.
    """
    return _elastic("6.2", n, delta, order, bottom=0.05, traction=(0.0, -LOAD), friction=0.0)


def example_63(n: Size = (12, 6), delta: Delta | None = None, order: int = 1) -> ContactProblem:
    """Example 6.3: as 6.2 on (0,4) x (0,1), in contact from the start, with Tresca friction g = 10."""
    return _elastic("6.3", n, delta, order, bottom=0.0, traction=(-LOAD, -LOAD), friction=10.0)


def _elastic(
    name: str,
    n: Size,
    delta: Delta | None,
    order: int,
    bottom: float,
    traction: Two,
    friction: float,
) -> ContactProblem:
    nx, ny = as_size(n)
    if nx % 2:
        raise BadInputError(
            f"{name}: the load begins at x = 2, so the number of columns must be even, got {nx}"
        )
    if bottom * ny >= 1:
        raise BadInputError(
            f"{name}: the bottom row is moved up to {bottom}, beyond the next one of {ny} rows"
        )
    grid = rectangle(nx, ny, x=(0, 4), diagonal="falling")
    p = np.where([[False], [True]] & (grid.p == 0), bottom, grid.p)
    sides, top = grid.boundaries, grid.boundaries["top"]
    names = {
        **{name: sides[name] for name in ("left", "right", "top")},
        "load": top[p[0, grid.facets[:, top]].mean(axis=0) > 2],
        "contact": sides["bottom"],
    }
    mesh = replace(grid, doflocs=p, _boundaries=names)
    alpha = PiecewiseLinear((0.0, 4.0), (bottom, bottom))
    return ContactProblem(
        mesh=mesh,
        law=MATERIAL,
        dirichlet=("left",),
        obstacle=Obstacle("contact", normal=(0.0, 1.0), offset=alpha, friction=friction),
        motion=Motion(_delta(delta, name, (nx, ny)), pinned=("top",)),
        tractions=(Traction("load", traction),),
        quadrature=RULES.get(order, "auto"),
        name=name,
        size=f"{nx}x{ny}",
        units=Units("m", "N"),
        order=order,
    )


class _Examples(dict[str, Callable[..., ContactProblem]]):
    def __missing__(self, name: str) -> Callable[..., ContactProblem]:
        if not isinstance(name, str):
            raise BadInputError(f"the name of an example must be a text, got {name!r}")
        raise BadInputError(
            f"{unknown('example', name, self)}, or a problem file, as {name}.toml (of a mesh: "
            "rmesh new my.toml --mesh MESH writes one)",
            "example",
        )


EXAMPLES = _Examples({"6.1": example_61, "6.2": example_62, "6.3": example_63})
"""The paper's examples by number; each takes ``n``, ``delta`` and ``order``."""


def as_size(n: Size) -> tuple[int, int]:
    """Columns and rows of ``8``, ``(12, 6)`` or ``"12x6"``."""
    pair = as_tuple(n.lower().split("x") if isinstance(n, str) else n)
    pair = tuple(int(part) if isinstance(part, str) and part.isdecimal() else part for part in pair)
    if len(pair) > 2 or any(not isinstance(k, Integral) or k < 2 for k in pair):
        raise BadInputError(
            f"the size must be a whole number of at least 2, or two such as 12x6, got {n!r}", "n"
        )
    return int(pair[0]), int(pair[-1])


def _delta(delta: Delta | None, name: str, size: tuple[int, int]) -> Two | None:
    if delta == "none":
        return None
    paper = PAPER[name]
    if delta is None:
        return (paper.delta[0] * paper.size[0] / size[0], paper.delta[1] * paper.size[1] / size[1])
    try:
        numbers = [float(value) for value in as_tuple(delta.split(",") if isinstance(delta, str) else delta)]
    except (TypeError, ValueError):
        numbers = []
    require(len(numbers) in (1, 2), "delta", "be a number, two of them, or none", delta)
    return numbers[0], numbers[-1]
