"""A node that is about to slide: Example 6.3 with Coulomb friction, where the best mesh lies on a kink.

The slab of Example 6.3 rests on its foundation with Coulomb friction, F = 1. Its nodes move within the boxes
of the example, for the mean deflection of its top. At the end of ``nested`` the slip of one contact node is
zero and its friction is at its bound F p: moved one way along the foundation it sticks, the other way it
slides, and the objective has another slope on each side. There its move limit holds it.

    python scripts/gallery/coulomb_kink.py --n 6 --picture biactive_slab.png
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from common import command_line, save, shifted
from numpy.typing import NDArray

import rmesh_nlp as rm
from rmesh_nlp.solving.outer import Outer

OBJECTIVE = "mean(top, -uy)"

REACH = 0.05
"""How far the node is moved to either side, in units of its move limit."""

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"


@dataclass(frozen=True)
class Across:
    """The objective and the state of one contact node as it is moved along the foundation.

    Attributes
    ----------
    x : array (m,)
        Where the node is; ``best`` is where the solve ended.
    value, slip, reserve : array (m,)
        Objective [m], magnitude of the slip [m], and F p - |friction| at the node [N].
    """

    best: float
    x: NDArray[np.float64]
    value: NDArray[np.float64]
    slip: NDArray[np.float64]
    reserve: NDArray[np.float64]


def problem(n: int, coulomb: float = 1.0) -> rm.ContactProblem:
    """Example 6.3 on ``2 n`` x ``n`` squares, with Coulomb's coefficient in the place of its bound."""
    slab = rm.EXAMPLES["6.3"](n=(2 * n, n))
    return replace(slab, obstacle=replace(slab.obstacle, friction=0.0, coulomb=coulomb))


def main(n: int = 6) -> dict[str, rm.Solution]:
    """Relocate the nodes of the slab by ``nested`` and ``mpcc``, and say how they end."""
    slab = problem(n)
    solutions = {name: rm.solve(slab, name, objective=OBJECTIVE) for name in ("nested", "mpcc")}
    for name, solution in solutions.items():
        record = solution.record()
        first, last = record["objective_initial"], record["objective_value"]
        print(
            f"{name}: {record['status']}, {first:.7g} -> {last:.7g}, {record['label']}, "
            f"nodes {record['biactive_nodes']}, {record['contact_solves']} contact solves, "
            f"{record['kkt_factorisations']} KKT factorisations"
        )
    for side, rate in zip(("left", "right"), slopes(across(solutions["nested"])), strict=True):
        print(f"slope of the objective to the {side} of the kink: {rate:.3e}")
    return solutions


def across(solution: rm.Solution, points: int = 41) -> Across:
    """Contact solutions as the first biactive node of an end is moved, all others held."""
    outer = Outer.of(solution.problem, OBJECTIVE)
    (node, *_), positions = solution.record()["biactive_nodes"], outer.relocation.mesh_map.positions
    row, q = positions.index[0, node], outer.variables(np.asarray(solution.mesh.p))
    place = int(np.flatnonzero(outer.contact.contact_nodes == node)[0])
    x, rows = [], []
    for point in shifted(outer, q, row, np.linspace(-REACH, REACH, points)):
        state, system = point.equilibrium, point.system
        reserve = system.bound(state.normal_force) - np.abs(state.tangential_force)
        x.append(outer.nodes(point.q)[0, node])
        rows.append((point.value, abs((system.tangents @ state.u)[place]), reserve[place]))
    return Across(float(solution.mesh.p[0, node]), np.array(x), *np.array(rows).T)


def slopes(kink: Across) -> tuple[float, float]:
    """Of the objective per unit of length, on either side of where the solve ended."""
    rates = np.diff(kink.value) / np.diff(kink.x)
    middle = len(rates) // 2
    return float(rates[middle - 1]), float(rates[middle])


def draw(solutions: dict[str, rm.Solution], path: Path) -> None:
    """The objective across the kink, slip and reserve of friction there, and the whole contact at the end."""
    end = solutions["nested"]
    kink = across(end)
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    distance = 1e3 * (kink.x - kink.best)
    axes[0].plot(distance, 1e6 * (kink.value - kink.value[len(distance) // 2]), color=BLUE)
    axes[0].set(ylabel="objective, from its end [1e-6 m]", title="the objective has a kink")
    axes[1].plot(distance, kink.slip / kink.slip.max(), color=ORANGE, label="slip")
    reserve = kink.reserve / kink.reserve.max()
    axes[1].plot(distance, reserve, "--", color=GREEN, label=r"$F p - |\tau|$")
    axes[1].set(ylabel="over the largest", title="where slip and reserve vanish")
    axes[1].legend(frameon=False)
    for axis in axes[:2]:
        axis.set_xlabel(f"the node at x = {kink.best:.3f} moved by [1e-3 m]")
        axis.axvspan(0.0, distance[-1], color="0.92", zorder=0)
    axes[0].text(0.75, 0.9, "beyond its\nmove limit", transform=axes[0].transAxes, ha="center", va="top")
    _contact(axes[2], end)
    save(figure, path)


def _contact(axis: plt.Axes, end: rm.Solution) -> None:
    """Bound and size of the friction at every contact node, by state."""
    outer = Outer.of(end.problem, OBJECTIVE)
    point = outer.function(outer.variables(np.asarray(end.mesh.p)))
    state, nodes = point.equilibrium, outer.contact.contact_nodes
    x, order = np.asarray(end.mesh.p)[0, nodes], np.argsort(np.asarray(end.mesh.p)[0, nodes])
    bound, friction = point.system.bound(state.normal_force), np.abs(state.tangential_force)
    biactive = np.isin(nodes, end.record()["biactive_nodes"])
    touches, slides = state.active.touching, state.active.sliding != 0
    axis.plot(x[order], bound[order], color="0.6", label=r"bound $F p$")
    for which, mark, color, label in (
        (touches & ~slides & ~biactive, "o", BLUE, "sticks"),
        (touches & slides & ~biactive, "s", ORANGE, "slides"),
        (~touches & ~biactive, "^", "0.4", "is off"),
        (biactive, "D", GREEN, "about to slide"),
    ):
        if np.any(which):
            axis.plot(x[which], friction[which], mark, color=color, markersize=6, label=label)
    axis.set(xlabel="x [m]", ylabel="friction at the node [N]", title="contact nodes at the end of nested")
    axis.legend(frameon=False)


if __name__ == "__main__":
    command_line(main, 6, draw)
