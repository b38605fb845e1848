"""Outer objectives with kinks: ``nested`` and ``mpcc`` on 68 small contact problems, judged alike.

Ten slabs of Example 6.3 with Coulomb friction, four errors of Example 6.1, eight seals whose best edges
just lose contact (``scripts/gallery/seal.py``), problems of random kind, half with Coulomb friction, and
random foundations of five to twelve pads, each of which is best where it just touches. Of
every end that is called stationary all branches of its biactive pairs are searched for a direction of descent
(:mod:`branches`), with none of the code that gave the label.

    python scripts/benchmark_branches.py --out rows.jsonl
    python scripts/benchmark_branches.py --only seal
    python scripts/benchmark_branches.py --read rows.jsonl
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import rmesh_nlp as rm
from branches import steepest
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes import named
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer

SAG = "mean(top, -uy)"

QUANTITIES = (
    SAG,
    "boundary(bottom, (y + uy)**2)",
    "boundary(top, (uy + 0.03)**2)",
    "mean(right, ux)",
    "body(ux**2 + uy**2)",
    "body(uy_y**2 + ux_x**2)",
    "boundary(bottom, y + uy) + 0.5*boundary(top, -uy)",
)
"""Objectives of the random problems."""

COEFFICIENTS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.0, 2.0, 3.0, 5.0)
"""Coulomb's, of the slabs."""

ERRORS = ((4, "error-l2"), (5, "error-h1"), (6, "error-l2"), (6, "contact"))
"""Squares a side and objective."""

SEALS = (
    *((4, 1.2, 0.0), (6, 1.2, 0.0), (4, 2.0, 0.3), (6, 1.5, 0.6)),
    *((8, 1.2, 0.0), (10, 1.5, 0.0), (8, 1.5, 0.3), (10, 1.2, 0.6)),
)
"""Squares over the height, cost of a gap, Coulomb's coefficient."""

RANDOM = 22
"""Number of problems of random kind."""

PADS = tuple((seed, pads, 0.0) for seed in range(2) for pads in range(5, 13)) + tuple(
    (seed, pads, 0.5) for seed in range(2) for pads in range(5, 9)
)
"""Seed, number of pads, Coulomb's coefficient."""


@dataclass(frozen=True)
class Case:
    """A problem and what is minimised."""

    name: str
    problem: ContactProblem
    objective: str


def slab(coulomb: float, n: tuple[int, int]) -> ContactProblem:
    """Example 6.3 with Coulomb's coefficient in the place of its bound."""
    problem = rm.EXAMPLES["6.3"](n=n)
    return replace(problem, obstacle=replace(problem.obstacle, friction=0.0, coulomb=coulomb))


def seal(n: int, coulomb: float) -> ContactProblem:
    """A block on ``2 n`` x ``n`` squares whose lower edge moves up and down in the middle."""
    mesh = named(
        rm.shapes.rectangle(2 * n, n, x=(0, 2)), {"seal": lambda x: (x[1] == 0) & (abs(x[0] - 1) < 0.5)}
    )
    x, y = mesh.p
    moves = (y == 0) & (abs(x - 1) < 0.5)
    free, pinned = (tuple(int(node) for node in np.flatnonzero(which)) for which in (moves, ~moves))
    return rm.ContactProblem(
        mesh=mesh,
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(rm.Dirichlet("left", (0.0, None)),),
        obstacle=replace(rm.Obstacle.graph("bottom", 0.0), coulomb=coulomb),
        motion=rm.Motion((1e-6, 0.02), pinned=pinned, free=free),
        tractions=(rm.Traction("top", (0.0, -10.0)),),
        name="seal",
    )


def pads(seed: int, n: int, coulomb: float) -> Case:
    """A block that sags over a foundation of ``n`` pads, one below each node of its lower edge.

    The heights are design variables. It pays to lift a pad, and costs to carry load: nearly all are best
    where the block just touches them.
    """
    rng = np.random.default_rng(seed)
    mesh = rm.shapes.rectangle(n - 1, 4, x=(0, (n - 1) / 4))
    heights = [rm.DesignVariable(f"h{k}", -0.02, (-0.04, 0.04)) for k in range(n)]

    def height(x: Any, y: Any) -> Any:
        return sum(one.symbol * ca.exp(-((4 * x - k) ** 2) * 4) for k, one in enumerate(heights))

    gains = ", ".join(f"{gain:.3f}" for gain in rng.uniform(0.2, 1.0, n)).split(", ")
    load = (float(rng.uniform(-5.0, 5.0)), float(rng.uniform(-30.0, -5.0)))
    problem = rm.ContactProblem(
        mesh=mesh,
        law=rm.PlaneStrain.from_young(1000.0, 0.3, load),
        dirichlet=(rm.Dirichlet("top", (0.0, 0.0)),),
        obstacle=rm.Obstacle.graph("bottom", height, coulomb=coulomb),
        motion=rm.Motion(0.0),
        design=tuple(heights),
        name="pads",
    )
    lifted = " + ".join(f"{gain}*h{k}" for k, gain in enumerate(gains))
    return Case(f"pads-{seed}-{n}-F{coulomb:g}", problem, f"0.01*resultant(bottom) - design({lifted})")


def cases() -> Iterator[Case]:
    """The 68 problems, the same ones every time."""
    for k, coulomb in enumerate(COEFFICIENTS):
        n, objective = [(6, 4), (12, 6), (8, 4)][k % 3], QUANTITIES[0 if k % 2 == 0 else k % len(QUANTITIES)]
        if k == 6:  # where outer solvers zigzagged for 500 iterations
            n, objective = (12, 6), SAG
        objective = objective.replace("bottom", "contact")
        yield Case(f"slab-{k}-F{coulomb:g}", slab(coulomb, n), objective)
    for n, objective in ERRORS:
        yield Case(f"6.1-{n}-{objective}", rm.EXAMPLES["6.1"](n=n), objective)
    for n, cost, coulomb in SEALS:
        yield Case(
            f"seal-{n}-{cost:g}-F{coulomb:g}", seal(n, coulomb), f"boundary(seal, {cost}*(y + uy) - y)"
        )
    for seed in range(RANDOM):
        rng = np.random.default_rng(1000 + seed)
        problem = random_problem(100 + seed, kind="elastic" if seed % 2 else "rough")
        coulomb = 0.0
        if seed % 2:
            coulomb = float(np.round(np.exp(rng.uniform(np.log(0.1), np.log(5.0))), 2))
            problem = replace(problem, obstacle=replace(problem.obstacle, coulomb=coulomb))
        objective = QUANTITIES[int(rng.integers(len(QUANTITIES)))]
        yield Case(f"random-{seed}-F{coulomb:g}", problem, objective)
    for given in PADS:
        yield pads(*given)


NAMES = (
    *("status", "solver_status", "stationarity", "label", "b_stationary", "biactive_nodes", "descent_rate"),
    *("stationarity_residual", "objective_initial", "objective_value", "outer"),
    *("iterations", "contact_solves", "kkt_factorisations"),
)
"""Entries of the record that rows have."""


def row(case: Case, formulation: str, seconds: float) -> dict[str, Any]:
    """One solve: how it ended, what it cost, and the steepest descent of all branches there.

    ``processor_s`` is the time of the whole solve, assessment and label included, ``search_s`` that of the
    search, which is no part of it.
    """
    found: dict[str, Any] = {"case": case.name, "objective": case.objective, "formulation": formulation}
    began = time.process_time()
    try:
        limits = rm.Limits(seconds=seconds)
        solution = rm.solve(case.problem, formulation, objective=case.objective, limits=limits)
    except Exception as error:  # whatever happens leaves a row
        return {**found, "status": type(error).__name__, "message": str(error)}
    record = solution.record()
    found |= {name: record.get(name) for name in NAMES}
    found["processor_s"] = time.process_time() - began
    outer = Outer.of(case.problem, case.objective)
    steep = steepest(outer, outer.variables(np.asarray(solution.mesh.p), design=solution.design))
    found["search_s"] = time.process_time() - began - found["processor_s"]
    if steep is not None:
        found |= {"searched": steep.branches, "steepest": steep.rate}
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Both formulations of each problem side by side, in Markdown."""
    lines = [
        "| problem | formulation | status | label, biactive nodes | objective | steepest of all branches "
        "| iterations | contact solves | KKT factorisations | processor time [s] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for one in rows:
        if "objective_value" not in one:
            lines.append(f"| {one['case']} | {one['formulation']} | {one['status']}" + " |" * 8)
            continue
        cells = (
            *(one["case"], one["formulation"], one["status"]),
            f"{one['stationarity'] or 'none'}, {len(one['biactive_nodes'] or [])}",
            f"{one['objective_value']:.8g}",
            f"{one['steepest']:.0e} of {one['searched']}" if "steepest" in one else "not searched",
            *(one["iterations"], one["contact_solves"], one["kkt_factorisations"] or 0),
            f"{one['processor_s']:.1f}",
        )
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def main(given: Sequence[str] | None = None) -> int:
    """Solve, or show what was solved."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, help="rows as JSON lines")
    parser.add_argument("--read", type=Path, help="show the rows of a file, and solve nothing")
    parser.add_argument("--only", default="", help="part of the names of the problems")
    parser.add_argument("--formulations", default="nested,mpcc")
    parser.add_argument("--seconds", type=float, default=60.0, help="limit of each solve")
    asked = parser.parse_args(given)
    if asked.read is not None:
        print(table([json.loads(line) for line in asked.read.read_text().splitlines()]))
        return 0
    rows = []
    for case in cases():
        for formulation in asked.formulations.split(",") if asked.only in case.name else ():
            rows.append(row(case, formulation, asked.seconds))
            if asked.out is not None:
                with asked.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    print(table(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
