"""Biactive nodes: a lower edge cut away until contact is just lost, where the objective has a kink.

An elastic block, 2 wide and 1 high, E = 1000, nu = 0.3, plane strain, stands on a rigid plane under a uniform
pressure of 10 on its top. The middle of its lower edge, 0.5 < x < 1.5, is the seal: its nodes may move up by
0.02 at most, which cuts material away. A gap under the seal leaks. So the outer objective is the leak less
the material saved,

    integral over the seal of  1.2 gap - height,      gap = y + u_y,  height = y.

As long as a node carries pressure, cutting it higher saves material and opens no gap. As soon as it carries
none, the gap opens, and costs more than is saved. The best edge is cut until every node of the seal just
touches without pressure: gap = 0 and pressure = 0 at all of them, strict complementarity fails, and the
objective has a kink there. ``nested`` differentiates with the contact set held, so its outer solver sees one
side of the kink and stalls; the exact finish of the KKT model goes on. ``mpcc`` has gap and pressure as
unknowns. Both end at the best edge with a label.

    python scripts/gallery/seal.py --n 8 --picture seal.png
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from common import command_line, save, shifted
from numpy.typing import NDArray

import rmesh_nlp as rm
from rmesh_nlp.meshes import named
from rmesh_nlp.solving.outer import Outer

OBJECTIVE = "boundary(seal, 1.2*(y + uy) - y)"
"""Leak less the material that is saved."""

HEIGHT = 0.02
"""How far a node of the seal may move up, and down."""

STEP = 1e-4
"""Step of the one-sided differences, in units of ``HEIGHT``."""

LIMITS = rm.Limits(iterations=200)
"""Of ``nested``."""


@dataclass(frozen=True)
class Kink:
    """One-sided derivatives of the objective at one node of the seal, per unit of its height.

    Attributes
    ----------
    x : float
        Position of the node.
    up, down : float
        Rates at which the objective grows as the node is moved up, and as it is moved down.
    gradient : float
        The component of the gradient that ``nested`` uses there, the contact set held.
    """

    x: float
    up: float
    down: float
    gradient: float


def problem(n: int, coulomb: float = 0.0) -> rm.ContactProblem:
    """The block on ``2 n`` x ``n`` squares; only nodes of the seal move, and they up and down."""
    mesh = rm.shapes.rectangle(2 * n, n, x=(0, 2))
    mesh = named(mesh, {"seal": lambda x: (x[1] == 0) & (x[0] > 0.5) & (x[0] < 1.5)})
    x, y = mesh.p
    seal = (y == 0) & (x > 0.5) & (x < 1.5)
    return rm.ContactProblem(
        mesh=mesh,
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(rm.Dirichlet("left", (0.0, None)),),
        obstacle=replace(rm.Obstacle.graph("bottom", 0.0), coulomb=coulomb),
        motion=rm.Motion(
            (1e-6, HEIGHT),
            pinned=tuple(int(node) for node in np.flatnonzero(~seal)),
            free=tuple(int(node) for node in np.flatnonzero(seal)),
        ),
        tractions=(rm.Traction("top", (0.0, -10.0)),),
        name="seal",
    )


def kinks(solution: rm.Solution) -> list[Kink]:
    """One-sided derivatives at every node of the seal, each of two contact solves."""
    outer = Outer.of(solution.problem, OBJECTIVE)
    free, result = outer.relocation.mesh_map, []
    q = free.q_of(np.asarray(solution.mesh.p))
    end = outer.function(q)
    for node in seal_nodes(solution.problem):
        row = free.positions.index[1, node]
        ends = shifted(outer, q, row, (STEP, -STEP))
        up, down = ((point.value - end.value) / (STEP * HEIGHT) for point in ends)
        x = float(solution.problem.mesh.p[0, node])
        result.append(Kink(x, up, down, float(end.gradient[row]) / HEIGHT))
    return result


def along(solution: rm.Solution, node: int, shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """The objective, the gap and the contact force at ``node`` as that node alone is moved by ``shifts``."""
    outer = Outer.of(solution.problem, OBJECTIVE)
    free = outer.relocation.mesh_map
    q, row = free.q_of(np.asarray(solution.mesh.p)), free.positions.index[1, node]
    place = int(np.flatnonzero(outer.contact.contact_nodes == node)[0])
    rows = []
    for point in shifted(outer, q, row, shifts / HEIGHT):
        gap = point.system.normals @ point.equilibrium.u + point.system.offset
        rows.append((point.value, gap[place], point.equilibrium.normal_force[place]))
    return np.array(rows).T


def seal_nodes(block: rm.ContactProblem) -> list[int]:
    """Nodes of the seal from left to right."""
    x, y = block.mesh.p
    inside = np.flatnonzero((y == 0) & (x > 0.5) & (x < 1.5))
    return [int(node) for node in inside[np.argsort(x[inside])]]


def state(solution: rm.Solution) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Height and gap at the nodes of the seal."""
    nodes = seal_nodes(solution.problem)
    height = np.asarray(solution.mesh.p)[1, nodes]
    return height, height + solution.displacement[1, nodes]


def line(name: str, solution: rm.Solution) -> str:
    """One line about a solve."""
    text = f"{name}: {solution.status.value}, objective {solution.record()['objective_value']:.7f}"
    text += f", {solution.iterations} iterations"
    if "label" in solution.record():
        pairs, b = solution.record()["biactive"], solution.record()["b_stationary"]
        text += f", {solution.stationarity}-stationary, B-stationary {b}, {pairs} biactive pairs"
    return text


def main(n: int = 8) -> dict[str, rm.Solution]:
    """Cut the seal by all formulations, and show the kink."""
    block = problem(n)
    solutions = {"mpcc": rm.solve(block, "mpcc", objective=OBJECTIVE)}
    solutions["nested"] = rm.solve(block, "nested", objective=OBJECTIVE, limits=LIMITS)
    solutions["mpcc from the end of nested"] = rm.solve(
        block, "mpcc", objective=OBJECTIVE, start=solutions["nested"]
    )
    for name, solution in solutions.items():
        print(line(name, solution))
    print("at the end of mpcc, per unit of height:   x     up     down   gradient of nested")
    for kink in kinks(solutions["mpcc"]):
        print(f"{kink.x:43.3f} {kink.up:8.4f} {kink.down:8.4f} {kink.gradient:8.4f}")
    return solutions


def draw(solutions: dict[str, rm.Solution], path: Path) -> None:
    """The objective across the kink, and height, gap and pressure of the seal where each formulation ends."""
    best, second = solutions["mpcc"], solutions["nested"]
    nodes = seal_nodes(best.problem)
    middle = nodes[len(nodes) // 2]
    shifts = np.linspace(-2e-3, 2e-3, 81)
    value, gap, force = along(best, middle, shifts)
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    axes[0].plot(1e3 * shifts, 1e3 * value, color="#0072B2")
    axes[0].set(xlabel="height of the middle node [1e-3], from its best", ylabel="objective [1e-3]")
    axes[0].set_title("the objective has a kink")
    axes[1].plot(1e3 * shifts, gap / np.max(gap), color="#D55E00", label="gap")
    axes[1].plot(1e3 * shifts, force / np.max(force), color="#009E73", linestyle="--", label="contact force")
    axes[1].set(xlabel="height of the middle node [1e-3], from its best", ylabel="over the largest")
    axes[1].set_title("where both vanish")
    axes[1].legend(frameon=False)
    x = best.problem.mesh.p[0, nodes]
    height, opened = state(best)
    axes[2].plot(x, 1e3 * height, "o-", color="#0072B2", markersize=5, label="height, mpcc")
    axes[2].plot(x, 1e3 * state(second)[0], "+", color="#D55E00", markersize=11, label="height, nested")
    axes[2].plot(x, 1e3 * opened, "^:", color="0.4", markersize=4, label="gap, both")
    axes[2].set(xlabel="x", ylabel="[1e-3]", title="the seal where they end")
    axes[2].legend(frameon=False)
    save(figure, path)


if __name__ == "__main__":
    command_line(main, 8, draw)
