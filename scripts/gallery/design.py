"""A design in a problem file: the start and the best one on finer meshes, and their contact pressures.

    python scripts/gallery/design.py scripts/gallery/level_punch.toml --picture design_punch.png

The best design is that of ``nested`` from the start of the file. Other starts and ``mpcc``::

    rmesh compare FILE --formulations nested,mpcc --set twice=false --seed 1 --seed 2 --verbose
"""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fit import Measurements, read_measurements
from rmesh_nlp.io.problem_file import load_problem, read_table
from rmesh_nlp.problem.contact_problem import refined

LOOKS = {"start": "#D55E00", "best": "#0072B2"}
SHOWN = ("objective_value", "peak_pressure", "resultant", "contact_length")

Pair = tuple[rm.Solution, rm.Solution]


def main(file: Path, edge: str = "bottom", picture: Path | None = None) -> tuple[rm.Solution, list[Pair]]:
    """Design, and measure the gain again on meshes two and four times as fine; the picture has an edge."""
    problem, objective = load_problem(file), read_table(file).solve.objective
    best = rm.solve(problem, "nested", objective=objective)
    print(f"{best.status.value}:", ", ".join(f"{name} = {value:.5g}" for name, value in best.design.items()))
    pairs: list[Pair] = []
    for factor in (1, 2, 4):
        designs = problem.at_design(), problem.at_design(best.design)
        first, last = (rm.solve(one, "fixed", objective=objective) for one in designs)
        pairs.append((first, last))
        for name, end in zip(LOOKS, pairs[-1], strict=True):
            print(f"h/{factor}, {name}:", ", ".join(f"{key} {end.record()[key]:.5g}" for key in SHOWN))
        problem = refined(problem)
    print(f"of the gain on h {surviving(pairs):.1%} is left on h/4")
    if picture is not None:
        measured = re.search(r"fit\((.*?)\)", objective)
        draw(pairs, edge, read_measurements(Path(measured[1])) if measured else None, picture)
    return best, pairs


def surviving(pairs: list[Pair]) -> float:
    """The gain on the last mesh in parts of that on the first one."""
    gains = [float(a.record()["objective_value"] - b.record()["objective_value"]) for a, b in pairs]
    return gains[-1] / gains[0]


def along(end: rm.Solution, edge: str) -> Array:
    """Vertices of a boundary from left to right."""
    nodes = np.unique(end.mesh.facets[:, end.mesh.boundaries[edge]])
    return nodes[np.argsort(end.mesh.p[0, nodes])]


def draw(pairs: list[Pair], edge: str, measured: Measurements | None, path: Path) -> None:
    """An edge, deformed, beside what was measured of it, and pressures on the meshes h and h/4."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    for ends, style, fine in ((pairs[0], "o", "h"), (pairs[-1], "-", "h/4")):
        for (name, color), end in zip(LOOKS.items(), ends, strict=True):
            look = {"color": color, "markersize": 3, "label": f"{name}, {fine}"}
            for axis, boundary in zip(axes, (edge, "bottom"), strict=True):
                nodes = along(end, boundary)
                x, y = end.mesh.p[:, nodes]
                height = y + end.displacement[1, nodes]
                axis.plot(x, height if axis is axes[0] else end.final.pressure[nodes], style, **look)
    if measured is not None:
        places = measured.points[1] + measured.values[1]
        axes[0].plot(measured.points[0], places, "k+", markersize=8, label="measured")
    axes[0].set(xlabel="x", ylabel="y", title=f"{edge}, deformed")
    axes[1].set(xlabel="x", ylabel="contact pressure", title="pressure", ylim=(0, None))
    for axis in axes:
        axis.legend(frameon=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    typer.run(main)
