"""Relocation under Coulomb friction for the error, where a body sticks, slips and is off the plane.

docs/relocation_friction.md has the problem, whose exact solution is made by :func:`manufactured`: pressure p,
slip s, gap w and friction are chosen on the plane, and loads follow from the displacement.

    python scripts/gallery/stick_slip.py --n 6 --picture stick_slip.png
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import typer

import rmesh_nlp as rm
from formulations.mpcc import AllAtOnce
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import Fields, constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import signed_areas
from rmesh_nlp.problem.coefficients import PositionFunction
from rmesh_nlp.problem.contact_problem import refined

YOUNG, POISSON, FRICTION = 1000.0, 0.3, 0.4
LAMBDA, MU = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON), YOUNG / 2 / (1 + POISSON)
STICK, OPEN = 0.8, 1.5
"""Where the block begins to slip, and where it leaves the plane."""

REACH = 0.45
"""Move limits in parts of the shortest edge at a node."""


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
        exact=rm.ExactSolution(u, float("nan")),
        name="stick and slip",
    )


def main(
    n: int = 6, objective: str = "error-h1", starts: int = 5, picture: Path | None = None
) -> tuple[list[rm.Solution], list[tuple[float, float]]]:
    """Relocate from the given and from drawn starts, and refine the given and the best mesh."""
    block, ends = problem(n), []
    formulations = {"nested": "nested", "mpcc": AllAtOnce(twice=False)}
    for (name, formulation), seed in product(formulations.items(), (None, *range(1, starts))):
        began = process_time()
        end = rm.solve(block, formulation, objective=objective, seed=seed)
        record = end.record()
        print(
            f"{name}, start {seed or 'given'}: {end.status.value}, {record['objective_value']:.6g}, "
            f"{record['label']}, {end.trace.work.contact_solves} contact solves, "
            f"{record['kkt_factorisations']} KKT factorisations, {process_time() - began:.1f} s"
        )
        ends.append(end)
    best = min((end for end in ends if end.success), key=lambda end: end.record()["objective_value"])
    meshes, errors = [block, replace(best.problem, mesh=best.mesh)], []
    for factor in (1, 2, 4):
        solved = [rm.solve(mesh, "fixed", objective=objective) for mesh in meshes]
        before, after = (float(end.record()["objective_value"]) for end in solved)
        print(f"h/{factor}: {objective} {before:.5g} -> {after:.5g}, gain {1 - after / before:.1%} of it")
        errors.append((before, after))
        meshes = [refined(mesh) for mesh in meshes]
    if picture is not None:
        draw(rm.solve(block, "fixed"), best, picture)
    return ends, errors


def densities(end: rm.Solution) -> Array:
    """Root of the mean energy density of the error on each triangle."""
    values = constant_field(end.displacement)
    fields = Fields(DisplacementSpace(end.problem), constant_field(np.asarray(end.mesh.p)), values, values)
    squares = element_values(parse_objective("error-energy").on(fields).groups)(np.zeros(0))[0]
    return np.sqrt(squares / np.abs(signed_areas(np.asarray(end.mesh.p), end.mesh.t)))


def draw(given: rm.Solution, best: rm.Solution, path: Path) -> None:
    """The error on the given and on the best mesh, and the stresses on the plane beside the exact ones."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.2), layout="constrained", width_ratios=(1.2, 1.2, 1))
    top = max(float(densities(end).max()) for end in (given, best))
    for axis, end, name in zip(axes, (given, best), ("given", "relocated"), strict=False):
        colors = axis.tripcolor(*end.mesh.p, end.mesh.t.T, facecolors=densities(end), vmin=0, vmax=top)
        axis.triplot(*end.mesh.p, end.mesh.t.T, color="white", linewidth=0.3)
        axis.set(title=f"{name} mesh", xlabel="x", ylabel="y", aspect="equal")
    figure.colorbar(colors, ax=axes[:2], label="error, root of the energy density", shrink=0.8)
    at = np.linspace(0, 2, 201)
    exact = np.array([manufactured()[1](x, 0.0).full() for x in at])
    nodes = np.unique(best.mesh.facets[:, best.mesh.boundaries["bottom"]])
    for name, values, stress, color in (
        ("pressure", best.final.pressure, -exact[:, 1, 1], "#0072B2"),
        ("friction", np.abs(best.final.tangential_stress), exact[:, 0, 1], "#009E73"),
    ):
        axes[2].plot(at, stress, color=color, linewidth=0.8, label=f"{name}, exact")
        look = {"color": color, "markersize": 4, "label": f"{name}, relocated"}
        axes[2].plot(best.mesh.p[0, nodes], values[nodes], "o", **look)
    for place, name in ((STICK, "slips"), (OPEN, "open")):
        axes[2].axvline(place, color="0.7", linewidth=0.8, linestyle=":")
        axes[2].text(place + 0.02, 15, name, color="0.4")
    axes[2].set(xlabel="x", ylabel="stress", title="on the plane")
    axes[2].legend(frameon=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    typer.run(main)
