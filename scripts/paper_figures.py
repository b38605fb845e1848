"""The paper's Figures 3.1, 3.2 and 6.1: both geometries with their boundary parts, and the exact solution.

    python scripts/paper_figures.py --out figures

All is drawn from the problems themselves: their meshes, named boundaries, loads, foundations and the exact
solution (6.2). Figures 6.2 to 6.7, grids and stresses before and after, are those of ``rmesh compare``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import matplotlib as mpl
import numpy as np

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

POINTS = 121
"""Points per side at which the exact solution is drawn."""

GIVEN, CONTACT, LOADED = "#0072B2", "#D55E00", "#009E73"


def figure_61(path: Path) -> tuple[float, float]:
    """Surface and contours of the exact solution; returns its extremes at the points that are drawn."""
    problem = EXAMPLES["6.1"]()
    assert problem.exact is not None
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    solution = ca.Function("u", [x, y], [problem.exact.value(x, y)])
    line = np.linspace(0, 1, POINTS)
    at_x, at_y = np.meshgrid(line, line, indexing="ij")
    u = solution(at_x.reshape(1, -1), at_y.reshape(1, -1)).full().reshape(at_x.shape)
    figure = plt.figure(figsize=(8, 3.6), layout="constrained")
    surface = figure.add_subplot(1, 2, 1, projection="3d")
    surface.plot_surface(at_x, at_y, u, cmap="viridis", rcount=60, ccount=60, linewidth=0)
    surface.set(xlabel="$x_1$", ylabel="$x_2$", title="the solution $u$ of (3.1)")
    surface.view_init(elev=28, azim=-130)
    flat = figure.add_subplot(1, 2, 2)
    drawn = flat.contourf(at_x, at_y, u, 16, cmap="viridis")
    flat.contour(at_x, at_y, u, 16, colors="black", linewidths=0.3)
    touching = u[-1] <= 1e-12
    flat.plot(np.ones(touching.sum()), line[touching], ".", color=CONTACT, label="contact on $\\Gamma_2$")
    flat.set(xlabel="$x_1$", ylabel="$x_2$", aspect="equal")
    flat.legend(loc="upper left", fontsize="small")
    figure.colorbar(drawn, ax=flat, shrink=0.8)
    figure.savefig(path, dpi=150)
    plt.close(figure)
    return float(u.min()), float(u.max())


def figure_31(path: Path) -> None:
    """Case 1: the membrane, held on Gamma_1, one-sided on Gamma_2."""
    problem = EXAMPLES["6.1"]()
    figure, axis = plt.subplots(figsize=(3.4, 3.2), layout="constrained")
    _body(axis, problem, "$\\Omega$")
    for name in problem.mesh.boundaries:
        contact = name == problem.obstacle.boundary
        label = "$\\Gamma_2$: $u \\geq 0$" if contact else "$\\Gamma_1$: $u = 0$"
        _part(axis, problem, name, CONTACT if contact else GIVEN, label)
    _finish(axis, figure, path)


def figure_32(path: Path, example: str = "6.2") -> None:
    """Case 2: the elastic body, its support, its load and the rigid foundation."""
    problem = EXAMPLES[example]()
    figure, axis = plt.subplots(figsize=(6.4, 2.8), layout="constrained")
    _body(axis, problem, "$\\Omega$")
    for support in problem.supports:
        _part(axis, problem, str(support.boundary), GIVEN, "$\\Gamma_D$: $u = 0$")
    for traction in problem.tractions:
        _part(axis, problem, str(traction.boundary), LOADED, "$\\Gamma_P$: $T(u) = P$")
        ends = _ends(problem, str(traction.boundary))
        force = np.array([float(value) for value in traction.value])
        step = 0.3 * force / np.linalg.norm(force)
        for point in np.linspace(ends[:, 0], ends[:, 1], 9):
            tail = point - step
            arrow = {"arrowstyle": "->", "color": LOADED}
            axis.annotate("", xy=tuple(point), xytext=tuple(tail), arrowprops=arrow)
        axis.update_datalim([ends.max(axis=1) - step, ends.min(axis=1) - step])
    _part(axis, problem, str(problem.obstacle.boundary), CONTACT, "$\\Gamma_C$: $u_2 \\geq -\\alpha$")
    left, right = problem.mesh.p[0].min(), problem.mesh.p[0].max()
    axis.fill_between([left, right], -0.12, 0.0, color="0.85", hatch="///", edgecolor="0.5", linewidth=0)
    axis.text((left + right) / 2, -0.2, "rigid foundation $x_2 = 0$", ha="center", va="top", fontsize="small")
    axis.update_datalim([(left, -0.35)])
    _finish(axis, figure, path)


def _body(axis: Axes, problem: ContactProblem, name: str) -> None:
    x, y = problem.mesh.p
    axis.fill([x.min(), x.max(), x.max(), x.min()], [y.min(), y.min(), y.max(), y.max()], color="0.95")
    axis.text(x.mean(), y.mean(), name, ha="center", va="center", fontsize="large")


def _ends(problem: ContactProblem, boundary: str) -> np.ndarray:
    """(2, 2): the ends of a straight boundary, column by column."""
    nodes = problem.mesh.p[:, np.unique(problem.mesh.facets[:, problem.mesh.boundaries[boundary]])]
    order = np.lexsort(nodes)
    return nodes[:, order[[0, -1]]]


def _part(axis: Axes, problem: ContactProblem, boundary: str, colour: str, label: str) -> None:
    ends = _ends(problem, boundary)
    known = axis.get_legend_handles_labels()[1]
    axis.plot(ends[0], ends[1], color=colour, linewidth=3, label=None if label in known else label)


def _finish(axis: Axes, figure: plt.Figure, path: Path) -> None:
    axis.autoscale_view()
    axis.set(xlabel="$x_1$", ylabel="$x_2$", aspect="equal")
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> list[Path]:
    """Draw all; returns the files."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else "")
    parser.add_argument("--out", type=Path, default=Path("figures"))
    folder = parser.parse_args(arguments).out
    folder.mkdir(parents=True, exist_ok=True)
    low, high = figure_61(folder / "figure-6.1.png")
    figure_31(folder / "figure-3.1.png")
    figure_32(folder / "figure-3.2.png")
    print(f"exact solution of 6.1 between {low:.4f} and {high:.4f}")
    files = sorted(folder.glob("figure-*.png"))
    print("wrote", ", ".join(str(file) for file in files))
    return files


if __name__ == "__main__":
    main()
