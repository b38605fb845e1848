"""Relocation under Coulomb friction for the error, where a body sticks, slips and is off the plane.

A block, 2 wide and 1 high, E = 1000, nu = 0.3, plane strain, lies on a rigid plane with the coefficient of
friction F = 0.4. On y = 0 its pressure p, slip s and gap w are chosen, (z)+ = max(z, 0):

    p = 20 (1 - x/1.5)+^2,    s = 0.02 (x - 0.8)+^3,    w = 0.05 (x - 1.5)+^3,
    friction = F p k(x),  k = 1 - (1 - x/0.8)+^2:  below F p for x < 0.8, where s = 0, and F p beyond it,

so that the block sticks for x < 0.8, slips for 0.8 < x < 1.5 and is off the plane beyond. The displacement

    u_x = s + a y,  u_y = w + b y,    mu (a + w') = F p k,    lambda s' + (lambda + 2 mu) b = -p

has these stresses on y = 0, and is in equilibrium with the body force -div sigma(u) and the tractions
sigma n on the right and on the top; it is given on the left. With Coulomb friction there is no energy that
nodes could lower. They are relocated for the error itself, within 0.45 of the shortest edges:

    minimise   integral of |grad (u_h - u)|^2.

    python scripts/gallery/stick_slip.py --n 6 --picture stick_slip.png
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
from common import command_line, exact_errors, save
from designs import SEEDS, Starts, five_starts

import rmesh_nlp as rm
from rmesh_nlp.problem import ExactSolution
from rmesh_nlp.problem.coefficients import PositionFunction
from rmesh_nlp.problem.contact_problem import refined

YOUNG, POISSON, FRICTION = 1000.0, 0.3, 0.4
LAMBDA, MU = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON), YOUNG / 2 / (1 + POISSON)
STICK, OPEN = 0.8, 1.5
"""Where the block begins to slip, and where it leaves the plane."""

REACH = 0.45
"""Move limits in parts of the shortest edge at a node."""

OBJECTIVE = "error-h1"
OTHER = "error-l2"


@dataclass(frozen=True)
class Relocated:
    """The solves, and the errors of the given and of the best mesh, refined 0, 1 and 2 times."""

    given: rm.Solution
    starts: Starts
    errors: list[tuple[float, float]]


def manufactured() -> tuple[ca.Function, ca.Function, ca.Function]:
    """Displacement (2,), stress (2, 2) and body force (2,) as functions of position."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    p = 20 * ca.fmax(1 - x / OPEN, 0) ** 2
    s = 0.02 * ca.fmax(x - STICK, 0) ** 3
    w = 0.05 * ca.fmax(x - OPEN, 0) ** 3
    k = 1 - ca.fmax(1 - x / STICK, 0) ** 2
    a = FRICTION * p * k / MU - ca.jacobian(w, x)
    b = -(p + LAMBDA * ca.jacobian(s, x)) / (LAMBDA + 2 * MU)
    u = ca.vertcat(s + a * y, w + b * y)
    slope = ca.jacobian(u, ca.vertcat(x, y))
    strain = (slope + slope.T) / 2
    stress = LAMBDA * ca.trace(strain) * ca.SX.eye(2) + 2 * MU * strain
    force = -ca.vertcat(*(ca.jacobian(stress[i, 0], x) + ca.jacobian(stress[i, 1], y) for i in range(2)))
    return tuple(ca.Function("exact", [x, y], [part]) for part in (u, stress, force))


def component(function: ca.Function, *index: int) -> PositionFunction:
    """One entry of what a function returns."""

    def value(x: Any, y: Any) -> Any:
        return function(x, y)[index]

    return value


def problem(n: int) -> rm.ContactProblem:
    """The block on ``2 n`` x ``n`` squares."""
    u, stress, force = manufactured()
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(2 * n, n, x=(0, 2)),
        law=rm.PlaneStrain(LAMBDA, MU, (component(force, 0), component(force, 1))),
        dirichlet=(rm.Dirichlet("left", (component(u, 0), component(u, 1))),),
        obstacle=rm.Obstacle("bottom", coulomb=FRICTION),
        motion=rm.Motion(rm.Relative(REACH)),
        tractions=(
            rm.Traction("right", (component(stress, 0, 0), component(stress, 1, 0))),
            rm.Traction("top", (component(stress, 0, 1), component(stress, 1, 1))),
        ),
        exact=ExactSolution(u, float("nan")),
        name="stick and slip",
    )


def errors(ends: Sequence[rm.Solution], objective: str, levels: int = 2) -> list[tuple[float, ...]]:
    """The error of several meshes, refined 0 to ``levels`` times."""
    meshes = [replace(end.problem, mesh=end.mesh) for end in ends]
    result = []
    for _ in range(levels + 1):
        solved = [rm.solve(mesh, "fixed", objective=objective) for mesh in meshes]
        result.append(tuple(float(part.record()["objective_value"]) for part in solved))
        meshes = [refined(mesh) for mesh in meshes]
    return result


def main(n: int = 6, objective: str = OBJECTIVE, seeds: Sequence[int | None] = SEEDS) -> Relocated:
    """Relocate from each start, and compare with the given mesh on refinements of both."""
    block = problem(n)
    given = rm.solve(block, "fixed", objective=objective)
    starts = five_starts(block, objective, seeds)
    pairs = errors((given, starts.best), objective)
    print(f"{objective}, as given: {given.record()['objective_value']:.6g}")
    print(starts.table)
    for level, (before, after) in enumerate(pairs):
        print(f"h/{2**level}: {objective} {before:.5g} -> {after:.5g}, gain {1 - after / before:.1%} of it")
    for which in (OBJECTIVE, OTHER):
        before, after = errors((given, starts.best), which, 0)[0]
        print(f"{which}: {before:.5g} -> {after:.5g}")
    counts = [(end.record()["sticking_nodes"], end.record()["sliding_nodes"]) for end in (given, starts.best)]
    print(f"nodes that stick, and that slip or are open: {counts}")
    return Relocated(given, starts, pairs)


def draw(result: Relocated, path: Path) -> None:
    """The error on the given and on the best mesh, and the stresses on the plane beside the exact ones."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.2), layout="constrained", width_ratios=(1.2, 1.2, 1))
    best = result.starts.best
    densities = []
    for end in (result.given, best):
        x, y = end.mesh.p[:, end.mesh.t]
        areas = np.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) / 2
        densities.append(np.sqrt(exact_errors(end.problem, np.asarray(end.mesh.p), end.displacement) / areas))
    top = float(max(density.max() for density in densities))
    for axis, end, density, name in zip(
        axes, (result.given, best), densities, ("given", "relocated"), strict=False
    ):
        colors = axis.tripcolor(
            *end.mesh.p, end.mesh.t.T, facecolors=density, cmap="viridis", vmin=0, vmax=top
        )
        axis.triplot(*end.mesh.p, end.mesh.t.T, color="white", linewidth=0.3)
        axis.set(title=f"{name} mesh", xlabel="x", ylabel="y", aspect="equal")
    figure.colorbar(colors, ax=axes[:2], label="error, root of the energy density", shrink=0.8)
    at = np.linspace(0, 2, 201)
    _, stress, _ = manufactured()
    exact = np.array([stress(x, 0.0).full() for x in at])
    axes[2].plot(at, -exact[:, 1, 1], color="0.3", label="pressure, exact")
    axes[2].plot(at, exact[:, 0, 1], "--", color="0.3", label="friction, exact")
    nodes = np.unique(best.mesh.facets[:, best.mesh.boundaries["bottom"]])
    for name, values, color in (
        ("pressure", best.pressure, "#0072B2"),
        ("friction", np.abs(best.tangential_stress), "#009E73"),
    ):
        look = {"color": color, "markersize": 4, "label": f"{name}, relocated"}
        axes[2].plot(best.mesh.p[0, nodes], values[nodes], "o", **look)
    for place, name in ((STICK, "slips"), (OPEN, "open")):
        axes[2].axvline(place, color="0.7", linewidth=0.8, linestyle=":")
        axes[2].text(place + 0.02, 15, name, color="0.4")
    axes[2].set(xlabel="x", ylabel="stress", title="on the plane")
    axes[2].legend(frameon=False)
    save(figure, path)


if __name__ == "__main__":
    command_line(main, 6, draw)
