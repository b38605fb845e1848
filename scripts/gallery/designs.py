"""What every design case does: ``nested`` and ``mpcc`` from five starts, and the gain on finer meshes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from time import process_time

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

import rmesh_nlp as rm
from formulations.mpcc import AllAtOnce
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.report.table import Table

FORMULATIONS: Mapping[str, str | AllAtOnce] = {"nested": "nested", "mpcc": AllAtOnce(twice=False)}
"""One path of ``mpcc`` each: a second one ended at the same designs here, for twice the cost or more."""

SEEDS = (None, 1, 2, 3, 4)
"""The given start, and four that are drawn from the bounds."""

COLORS = ("#D55E00", "#0072B2")
"""Of the first and of the best design."""

FINER = (1, 2, 4)
"""Over how many times as fine meshes the gain is measured again."""


@dataclass(frozen=True)
class Starts:
    """One problem solved by each formulation from each start.

    Attributes
    ----------
    solutions : mapping from (formulation, seed) to Solution
    seconds : mapping from the same to float
        Processor time of each whole solve, its assessment included.
    """

    solutions: Mapping[tuple[str, int | None], rm.Solution]
    seconds: Mapping[tuple[str, int | None], float]

    @property
    def best(self) -> rm.Solution:
        """The successful end with the least objective."""
        ends = [end for end in self.solutions.values() if end.success]
        return min(ends, key=lambda end: float(end.record()["objective_value"]))

    @property
    def table(self) -> str:
        """A row for each solve in Markdown."""
        head = ["formulation", "start", "status", "objective", "stationarity", "biactive pairs"]
        rows = []
        for (formulation, seed), end in self.solutions.items():
            record = end.record()
            proved = [end.stationarity] * bool(end.stationarity) + ["B"] * bool(record.get("b_stationary"))
            counts = record.get("biactive", 0), end.contact_solves, record.get("kkt_factorisations", 0)
            start, objective = "given" if seed is None else f"drawn {seed}", record["objective_value"]
            row = [
                f"`{formulation}`",
                start,
                end.status.value,
                f"{objective:.6g}",
                ", ".join(proved) or "none",
            ]
            rows.append([*row, *map(str, counts), f"{self.seconds[formulation, seed]:.1f}"])
        head += ["contact solves", "KKT factorisations", "seconds"]
        return Table(head, [("", rows)]).markdown()


def five_starts(
    problem: ContactProblem,
    objective: str | Objective,
    seeds: Sequence[int | None] = SEEDS,
) -> Starts:
    """Solve by both formulations from each start; the first seed is None, the start as given."""
    solutions, seconds = {}, {}
    for formulation, seed in product(FORMULATIONS, seeds):
        begin = process_time()
        solved = rm.solve(problem, FORMULATIONS[formulation], objective=objective, seed=seed)
        solutions[formulation, seed], seconds[formulation, seed] = solved, process_time() - begin
    return Starts(solutions, seconds)


def on_finer_meshes(
    problems: Sequence[ContactProblem], objective: str | Objective, design: Mapping[str, float]
) -> list[tuple[rm.Solution, rm.Solution]]:
    """Contact solutions at the first design and at another one, on several meshes of one problem.

    The meshes are made anew and moved by the shapes, so that a face is as smooth as its formula.
    """
    return [
        (
            rm.solve(problem.at_design(), "fixed", objective=objective),
            rm.solve(problem.at_design(design), "fixed", objective=objective),
        )
        for problem in problems
    ]


@dataclass(frozen=True)
class Designed:
    """The solves, and the first and the best design on meshes 1, 2 and 4 times as fine."""

    starts: Starts
    finer: list[tuple[rm.Solution, rm.Solution]]

    @property
    def surviving(self) -> float:
        """The gain on the finest mesh in parts of that on the mesh of the design."""
        return surviving(self.finer)

    def show(self, names: tuple[str, str], figures: Mapping[str, str]) -> None:
        """Print the table of starts, and of both designs on every mesh these entries of the record."""
        best = self.starts.best
        print(self.starts.table)
        print("design:", ", ".join(f"{name} = {value:.5f}" for name, value in best.design.items()))
        for factor, ends in zip(FINER, self.finer, strict=True):
            for name, end in zip(names, ends, strict=True):
                shown = (f"{text} {end.record()[key]:.5g}" for key, text in figures.items())
                print(f"h/{factor}, {name}: {', '.join(shown)}")
        print(f"gain_surviving {best.record()['gain_surviving']:.4f}, on h/4 {self.surviving:.4f}")

    def draw_pressures(self, axis: Axes, names: tuple[str, str]) -> None:
        """The contact pressures of both along ``bottom``, on the mesh of the design and on that of h/4."""
        for ends, style, fine in ((self.finer[0], "o", "h"), (self.finer[-1], "-", "h/4")):
            for end, color, name in zip(ends, COLORS, names, strict=True):
                nodes = along(end)
                x, pressure = np.asarray(end.mesh.p)[0, nodes], end.pressure[nodes]
                axis.plot(x, pressure, style, color=color, markersize=3, label=f"{name}, {fine}")
        axis.set(xlabel="x", ylabel="contact pressure", title="pressure", ylim=(0, None))


def designed(
    problem: Callable[[int, int], ContactProblem],
    n: int,
    order: int,
    objective: str | Objective,
    seeds: Sequence[int | None],
) -> Designed:
    """Design from each start, and measure the gain again on finer meshes."""
    starts = five_starts(problem(n, order), objective, seeds)
    meshes = [problem(factor * n, order) for factor in FINER]
    return Designed(starts, on_finer_meshes(meshes, objective, starts.best.design))


def along(end: rm.Solution, boundary: str = "bottom") -> NDArray[np.int64]:
    """Vertices of a boundary from left to right."""
    nodes = np.unique(end.mesh.facets[:, end.mesh.boundaries[boundary]])
    return np.asarray(nodes[np.argsort(end.mesh.p[0, nodes])])


def surviving(pairs: Sequence[tuple[rm.Solution, rm.Solution]]) -> float:
    """The gain on the last mesh in parts of that on the first one."""
    gains = [float(a.record()["objective_value"] - b.record()["objective_value"]) for a, b in pairs]
    return gains[-1] / gains[0]
