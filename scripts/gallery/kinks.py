"""Biactive nodes: at the best shape contact is about to change, and the objective has a kink.

A seal whose edge is cut until its nodes just touch, and a slab with a node that is about to slide, as
docs/biactive.md shows them.

    python scripts/gallery/kinks.py seal --n 8 --picture biactive.png
    python scripts/gallery/kinks.py slab --n 6 --picture biactive_slab.png
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes import named
from rmesh_nlp.solving.outer import Outer

HEIGHT = 0.02
"""How far a node of the seal may move up, and down."""

STEP, REACH = 1e-4, 0.05
"""Of one-sided differences, and how far a node is moved for the picture, in units of its move limit."""

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"


def seal(n: int, coulomb: float = 0.0) -> rm.ContactProblem:
    """The block on ``2 n`` x ``n`` squares; only nodes of the seal move, and they up and down."""
    mesh = rm.shapes.rectangle(2 * n, n, x=(0, 2))
    mesh = named(mesh, {"seal": lambda x: (x[1] == 0) & (x[0] > 0.5) & (x[0] < 1.5)})
    x, y = mesh.p
    is_seal = (y == 0) & (x > 0.5) & (x < 1.5)
    return rm.ContactProblem(
        mesh=mesh,
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(rm.Dirichlet("left", (0.0, None)),),
        obstacle=replace(rm.Obstacle.graph("bottom", 0.0), coulomb=coulomb),
        motion=rm.Motion(
            (1e-6, HEIGHT),
            pinned=tuple(int(node) for node in np.flatnonzero(~is_seal)),
            free=tuple(int(node) for node in np.flatnonzero(is_seal)),
        ),
        tractions=(rm.Traction("top", (0.0, -10.0)),),
        name="seal",
    )


def slab(n: int, coulomb: float = 1.0) -> rm.ContactProblem:
    """Example 6.3 on ``2 n`` x ``n`` squares, with Coulomb's coefficient in the place of its bound."""
    given = rm.EXAMPLES["6.3"](n=(2 * n, n))
    return replace(given, obstacle=replace(given.obstacle, friction=0.0, coulomb=coulomb))


CASES = {
    "seal": (seal, "boundary(seal, 1.2*(y + uy) - y)", 1, ("gap", "contact force")),
    "slab": (slab, "mean(top, -uy)", 0, ("slip", r"$F p - |\tau|$")),
}
"""Problem, objective, the axis along which its nodes are moved, and what vanishes on either side."""


@dataclass(frozen=True)
class Across:
    """The objective and the contact of one node that alone is moved along an axis.

    ``first`` and ``second`` are gap and contact force; along the foundation slip and what friction leaves of
    its bound. ``gradient`` is the derivative that ``nested`` uses where it ended, the contact set held.
    """

    shift: Array
    value: Array
    first: Array
    second: Array
    gradient: float

    @property
    def slopes(self) -> tuple[float, float]:
        """Of the objective, before and after the end."""
        rates, middle = np.diff(self.value) / np.diff(self.shift), len(self.shift) // 2
        return float(rates[middle - 1]), float(rates[middle])


def across(end: rm.Solution, case: str, node: int, reach: float = REACH, points: int = 41) -> Across:
    """Contact solutions as a node of an end is moved, all others held."""
    _, objective, axis, _ = CASES[case]
    outer = Outer.of(end.problem, objective)
    q, positions = outer.variables(np.asarray(end.mesh.p)), outer.relocation.parts.mesh_map.positions
    row, limit = positions.index[axis, node], positions.scale[axis, node]
    place = int(np.flatnonzero(outer.contact.contact_nodes == node)[0])
    rows = []
    for step in np.linspace(-reach, reach, points):
        moved = q.copy()
        moved[row] += step
        point = outer.function(moved)
        state, system = point.equilibrium, point.system
        if axis == 1:
            contact = system.normals @ state.u + system.offset, state.normal_force
        else:
            slip, friction = np.abs(system.tangents @ state.u), np.abs(state.tangential_force)
            contact = slip, system.bound(state.normal_force) - friction
        rows.append((limit * step, point.value, *(each[place] for each in contact)))
    return Across(*np.array(rows).T, float(outer.function(q).gradient[row] / limit))


def main(case: str, n: int = 6, picture: Path | None = None) -> dict[str, rm.Solution]:
    """Solve by ``nested`` and ``mpcc``, say how they end, and show the kinks at the end of ``nested``."""
    make, objective, axis, names = CASES[case]
    problem = make(n)
    ends = {name: rm.solve(problem, name, objective=objective) for name in ("nested", "mpcc")}
    ends["mpcc from there"] = rm.solve(problem, "mpcc", objective=objective, start=ends["nested"])
    for name, end in ends.items():
        record = end.record()
        print(
            f"{name}: {record['status']}, {record['objective_initial']:.7g} -> "
            f"{record['objective_value']:.7g}, {record['label']}, {end.trace.iterations} iterations, "
            f"{record['contact_solves']} contact solves, {record['kkt_factorisations']} KKT factorisations"
        )
    end = ends["nested"]
    nodes = sorted(end.record()["biactive_nodes"], key=lambda node: end.mesh.p[0, node])
    print("x, slopes of the objective before and after, gradient of nested")
    for node in nodes:
        kink = across(end, case, node, STEP, 3)
        before, after = kink.slopes
        print(f"{end.mesh.p[0, node]:.3f} {before:+.4g} {after:+.4g} {kink.gradient:+.4g}")
    if picture is not None:
        node = nodes[len(nodes) // 2]
        draw(
            across(end, case, node), f"{'xy'[axis]} of the node at {end.mesh.p[0, node]:.3f}", names, picture
        )
    return ends


def draw(kink: Across, node: str, names: tuple[str, str], path: Path) -> None:
    """The objective across a kink, and what vanishes on either side of it."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
    axes[0].plot(1e3 * kink.shift, kink.value, color=BLUE)
    axes[0].set(ylabel="objective", title="the objective has a kink")
    looks = ((kink.first, ORANGE, "-"), (kink.second, GREEN, "--"))
    for name, (values, color, style) in zip(names, looks, strict=True):
        axes[1].plot(1e3 * kink.shift, values / values.max(), style, color=color, label=name)
    axes[1].set(ylabel="over the largest", title="where both vanish")
    axes[1].legend(frameon=False)
    for axis in axes:
        axis.set_xlabel(f"{node}, from its end [1e-3]")
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    typer.run(main)
