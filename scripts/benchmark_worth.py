"""Is relocation worth it? Error of the energy against nodes and time.

Uniform grids, h-adaptive meshes, boxes, large moves, large moves with flips, hr.

On Example 6.1, whose energy is known exactly. Every error is that of a rule of degree 10; programs use
degree 6.
Writes DIR/worth.json, DIR/worth.md and DIR/worth.png.

    python scripts/benchmark_worth.py                       8, 16, 32 squares a side, two minutes
    python scripts/benchmark_worth.py --sizes 8 16 32 64 128 224 --out results/worth
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from formulations import auto, nested
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.discretisation.validity import least_angles
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objectives import error_energy
from rmesh_nlp.problem import ContactProblem, Motion, signed_areas
from rmesh_nlp.programs.hr import hr
from rmesh_nlp.programs.refinement import locally_refined, marked, residual_indicators

RULE, JUDGE = 6, 10


@dataclass(frozen=True)
class Row:
    """One mesh: method, nodes, error of the energy, seconds of processor time, least area ratio and angle."""

    method: str
    nodes: int
    error: float
    seconds: float
    units: float
    least_area: float
    least_angle: float
    note: str = ""


def stated(n: int) -> ContactProblem:
    """Example 6.1 without boxes."""
    return replace(EXAMPLES["6.1"](n=n), motion=Motion(None), quadrature=RULE)


def error(problem: ContactProblem) -> float:
    """Error of the energy on a mesh."""
    assert problem.exact is not None
    return (
        ContactModel(replace(problem, quadrature=JUDGE)).solve(problem.mesh.p).energy - problem.exact.energy
    )


def unit(problem: ContactProblem) -> float:
    """Processor time of one cold contact solve."""
    model, began = ContactModel(problem), time.process_time()
    for _ in range(3):
        model.solve(problem.mesh.p)
    return (time.process_time() - began) / 3


def row(
    method: str, problem: ContactProblem, seconds: float, areas: Array | None = None, note: str = ""
) -> Row:
    """Measure a mesh."""
    now = signed_areas(problem.mesh.p, problem.triangles)
    least = float(np.min(now / areas)) if areas is not None else float("nan")
    angle = float(np.min(least_angles(np.asarray(problem.mesh.p), problem.triangles)))
    nodes = int(problem.mesh.p.shape[1])
    return Row(method, nodes, error(problem), seconds, seconds / unit(problem), least, angle, note)


def uniform(sizes: list[int]) -> Iterator[Row]:
    """The grids as given."""
    for n in sizes:
        problem = stated(n)
        began = time.process_time()
        ContactModel(problem).solve(problem.mesh.p)
        yield row("uniform", problem, time.process_time() - began)


def adaptive(method: str, indicators: Callable[[ContactProblem], Array], most: int) -> Iterator[Row]:
    """Local refinement by some indicators from the coarsest grid on; time is that of all meshes so far."""
    problem, spent = stated(8), 0.0
    while problem.mesh.p.shape[1] <= most:
        began = time.process_time()
        found = indicators(problem)
        spent += time.process_time() - began
        yield row(method, problem, spent)
        began = time.process_time()
        problem = locally_refined(problem, marked(found))
        spent += time.process_time() - began


def oracle(problem: ContactProblem) -> Array:
    """The exact error of each element."""
    model = ContactModel(problem)
    values = model.displacement.values(model.solve(problem.mesh.p).u)
    fields = (constant_field(problem.mesh.p), constant_field(values), constant_field(values))
    return element_values(error_energy(problem, *fields))(np.zeros(0))[0]


def boxes(sizes: list[int]) -> Iterator[Row]:
    """Boxes that shrink with the mesh, as in the paper."""
    for n in sizes:
        problem = replace(EXAMPLES["6.1"](n=n), quadrature=RULE)
        began = time.process_time()
        solution = nested.solve(problem, outer="newton")
        seconds = time.process_time() - began
        yield row("boxes", _moved(problem, solution.mesh.p), seconds, _areas(problem))


def large(sizes: list[int], flips: bool) -> Iterator[Row]:
    """Large moves by a cascade, with or without flips."""
    for n in sizes:
        problem = stated(n)
        began = time.process_time()
        solution = auto.solve(problem, flips=flips)
        seconds = time.process_time() - began
        final = replace(solution.problem, mesh=solution.mesh, quadrature=RULE)
        levels = solution.record()["cascade"]
        one = unit(problem)
        finest = levels[-1]["seconds"] / one
        whole = sum(level["seconds"] for level in levels) / one
        built = sum(level["build_seconds"] for level in levels) / one
        note = f"finest {finest:.0f}, all meshes {whole:.0f}, statement of the programs {built:.0f} units"
        name = "large moves, flips" if flips else "large moves"
        yield row(name, final, seconds, solution.initial_areas, note)


def refined_and_relocated(most: int) -> Iterator[Row]:
    """Hr with flips; the time is that of all meshes up to a number of nodes."""
    began = time.process_time()
    stages = hr(stated(8), nodes=most // 2)
    seconds = time.process_time() - began
    total = sum(stage.problem.mesh.p.shape[1] for stage in stages)
    spent = 0.0
    for stage in stages:
        spent += seconds * stage.problem.mesh.p.shape[1] / total
        yield row("hr", stage.problem, spent)


def _moved(problem: ContactProblem, nodes: Array) -> ContactProblem:
    return replace(problem, mesh=replace(problem.mesh, doflocs=np.asarray(nodes)))


def _areas(problem: ContactProblem) -> Array:
    return signed_areas(problem.mesh.p, problem.triangles)


def table(rows: list[Row]) -> str:
    """Markdown; the factor compares with a uniform grid of as many nodes, by interpolation."""
    grid = [one for one in rows if one.method == "uniform"]
    slope = np.polyfit(np.log([g.nodes for g in grid[-2:]]), np.log([g.error for g in grid[-2:]]), 1)

    def same(nodes: int) -> float:
        inside = nodes <= grid[-1].nodes
        x, y = np.log([g.nodes for g in grid]), np.log([g.error for g in grid])
        return float(np.exp(np.interp(np.log(nodes), x, y) if inside else np.polyval(slope, np.log(nodes))))

    lines = [
        "| method | nodes | error of the energy | times less than uniform | seconds | units | "
        "least area ratio | least angle | |",
        "|---|--:|--:|--:|--:|--:|--:|--:|---|",
    ]
    for one in rows:
        area = f"{one.least_area:.4f}" if np.isfinite(one.least_area) else ""
        lines.append(
            f"| {one.method} | {one.nodes} | {one.error:.5f} | {same(one.nodes) / one.error:.2f} | "
            f"{one.seconds:.2f} | {one.units:.0f} | {area} | {one.least_angle:.2f} | {one.note} |"
        )
    return "\n".join(lines) + "\n"


def picture(rows: list[Row]) -> Figure:
    """Error against nodes and against time."""
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    axes = figure.subplots(1, 2)
    for method in dict.fromkeys(one.method for one in rows):
        part = [one for one in rows if one.method == method]
        for axis, x in zip(axes, ("nodes", "seconds"), strict=True):
            axis.loglog(
                [getattr(o, x) for o in part], [o.error for o in part], "o-", markersize=4, label=method
            )
    axes[0].set(xlabel="nodes", ylabel="error of the energy")
    axes[1].set(xlabel="processor time in seconds, statement of the programs included")
    for axis in axes:
        axis.grid(which="both", alpha=0.25)
    axes[0].legend(fontsize=8)
    return figure


def main(sizes: list[int], out: Path) -> list[Row]:
    """Measure, and write as each method ends."""
    most = (max(sizes) + 1) ** 2
    methods = (
        lambda: uniform(sizes),
        lambda: adaptive("h-adaptive, oracle", oracle, most),
        lambda: adaptive("h-adaptive, residual estimator", residual_indicators, most),
        lambda: boxes([n for n in sizes if n <= 32]),
        lambda: large(sizes, False),
        lambda: large(sizes, True),
        lambda: refined_and_relocated(most),
    )
    rows: list[Row] = []
    out.mkdir(parents=True, exist_ok=True)
    for method in methods:
        for one in method():
            rows.append(one)
            figures = f"{one.nodes:6} nodes  error {one.error:.5f}  {one.seconds:8.2f} s"
            print(f"{one.method:32} {figures}  {one.note}", flush=True)
        (out / "worth.json").write_text(json.dumps([asdict(one) for one in rows], indent=1) + "\n")
        (out / "worth.md").write_text(table(rows))
        picture(rows).savefig(out / "worth.png", dpi=110)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16, 32], help="squares a side")
    parser.add_argument("--out", type=Path, default=Path("results/worth"), help="folder")
    given = parser.parse_args()
    main(sorted(given.sizes), given.out)
