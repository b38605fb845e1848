"""Outer objectives with kinks: ``nested`` and ``mpcc`` on small contact problems and random designs.

    python scripts/benchmark_branches.py                     68 problems with kinks, from the given mesh
    python scripts/benchmark_branches.py --only seal
    python scripts/benchmark_branches.py --designs 200 300   design problems of these seeds, from two starts
    python scripts/benchmark_branches.py --out rows          keeps DIR/rows.jsonl, and solves what it lacks

The 68 are ten slabs of Example 6.3 with Coulomb friction, four errors of Example 6.1, eight seals whose best
edges just lose contact (``gallery/seal.py``), problems of random kind, half with Coulomb friction, and
random foundations of five to twelve pads, each of which is best where it just touches. Design problems are
those of :mod:`random_designs`, solved from the design as given and from a random one. Of every end that is
called stationary all branches of its biactive pairs are searched for a direction of descent
(:mod:`branches`), with none of the code that gave the label. Prints a row for each solve, and counts by
formulation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pandas as pd

import rmesh_nlp as rm
from branches import MOST, steepest
from gallery import coulomb_kink, seal
from random_designs import random_design
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from rows import Row, Store, command_line, markdown, timed

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

DESIGN_WORK = 6_000
"""Branches times outer variables of a design beyond which no branch is searched."""

REACHED, OF_GAIN = 1e-4, 1e-6
"""An end has reached the best if it is above it by less than these parts of its value and of the gain."""


@dataclass(frozen=True)
class Case:
    """A problem, what is minimised, seeds of its starts (None is the given one), and branches to search."""

    name: str
    problem: ContactProblem
    objective: str
    seeds: tuple[int | None, ...] = (None,)
    branches: int = MOST


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

    gains = [f"{gain:.3f}" for gain in rng.uniform(0.2, 1.0, n)]
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
        n, objective = [3, 6, 4][k % 3], QUANTITIES[0 if k % 2 == 0 else k % len(QUANTITIES)]
        if k == 6:  # where outer solvers zigzagged for 500 iterations
            n, objective = 6, SAG
        slab = coulomb_kink.problem(n, coulomb)
        yield Case(f"slab-{k}-F{coulomb:g}", slab, objective.replace("bottom", "contact"))
    for n, objective in ERRORS:
        yield Case(f"6.1-{n}-{objective}", rm.EXAMPLES["6.1"](n=n), objective)
    for n, cost, coulomb in SEALS:
        objective = f"boundary(seal, {cost}*(y + uy) - y)"
        yield Case(f"seal-{n}-{cost:g}-F{coulomb:g}", seal.problem(n, coulomb), objective)
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


def designs(first: int, last: int) -> Iterator[Case]:
    """Random design problems, from the given design and from a random one."""
    for seed in range(first, last):
        drawn = random_design(seed)
        work = DESIGN_WORK // Outer.of(drawn.problem, drawn.objective).n
        yield Case(f"design-{seed}", drawn.problem, drawn.objective, (None, 1), work)


NAMES = ("status", "valid", "success", "stationarity", "b_stationary", "stationarity_residual", "iterations")
COUNTS = ("objective_initial", "objective_value", "contact_solves", "kkt_factorisations", "biactive")
"""Entries of the record that rows have."""


def row(case: Case, formulation: str, seed: int | None, seconds: float) -> Row:
    """One solve: how it ended, what it cost, and the steepest descent of all branches there.

    ``processor_s`` is the time of the whole solve, assessment and label included, without that of the search.
    """
    key: Row = {"case": case.name, "formulation": formulation, "seed": seed}
    how = {"objective": case.objective, "seed": seed, "limits": rm.Limits(seconds=seconds)}
    try:
        solution, spent = timed(rm.solve, case.problem, formulation, **how)
    except Exception as error:  # whatever happens leaves a row
        return {**key, "status": type(error).__name__, "message": str(error), "valid": False}
    record = solution.record()
    key |= {name: record.get(name) for name in (*NAMES, *COUNTS)} | {"processor_s": spent}
    outer = Outer.of(case.problem, case.objective)
    q = outer.variables(np.asarray(solution.mesh.p), design=solution.design)
    searched = steepest(outer, q, case.branches) if key["b_stationary"] else None
    return key | ({"steepest": searched.rate, "branches": searched.branches} if searched else {})


def table(rows: Sequence[Row]) -> str:
    """Both formulations of each problem side by side, in Markdown."""
    columns = ["case", "formulation", "seed", "status", "stationarity", "biactive", "objective_value"]
    columns += ["steepest", "branches", "iterations", "contact_solves", "kkt_factorisations", "processor_s"]
    frame = pd.DataFrame(rows, columns=columns)
    digits = {"objective_value": "{:.8g}", "steepest": "{:.0e}", "processor_s": "{:.1f}"}
    digits |= dict.fromkeys((*columns[8:12], "seed", "biactive"), "{:.0f}")
    for name, form in digits.items():
        frame[name] = [form.format(value) if pd.notna(value) else None for value in frame[name]]
    return markdown(frame)


def best_reached(frame: pd.DataFrame) -> pd.DataFrame:
    """By problem and formulation: whether the better of its ends reaches the best of all of the problem."""
    valid = frame[frame.valid.astype(bool)]
    ends = valid.pivot_table(values="objective_value", index="case", columns="formulation", aggfunc="min")
    best, first = ends.min(axis=1), valid.groupby("case").objective_initial.first()
    return ends.le(best + REACHED * best.abs() + OF_GAIN * (first - best).abs(), axis=0)


def counts(rows: Sequence[Row]) -> str:
    """How the solves of each formulation ended, and what they cost, in Markdown."""
    frame = pd.DataFrame(rows, columns=["case", "formulation", "steepest", "processor_s", *NAMES, *COUNTS])
    groups, reached = frame.groupby("formulation", sort=False), best_reached(frame).sum()
    lines = []
    for name, own in groups:
        kinks = own[(own.biactive.astype(float) > 0) & (own.b_stationary == True)]  # noqa: E712
        lines.append(
            {
                "formulation": name,
                "solves": len(own),
                "valid": int(own.valid.sum()),
                "successes": int((own.success == True).sum()),  # noqa: E712
                "S": int((own.stationarity == "S").sum()),
                "best end, of problems": f"{reached.get(name, 0)} of {own.case.nunique()}",
                "ends at kinks, searched": f"{len(kinks)}, {kinks.steepest.notna().sum()}",
                "steepest descent": own.steepest.astype(float).min(),
                "median iterations": own.iterations.median(),
                "median contact solves": own.contact_solves.median(),
                "median processor time [s]": own.processor_s.median(),
            }
        )
    return markdown(pd.DataFrame(lines))


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve what no row is kept of, and print the tables."""
    parser = command_line(__doc__, out="results/branches")
    parser.add_argument("--designs", type=int, nargs=2, metavar=("FIRST", "LAST"), help="seeds of designs")
    parser.add_argument("--only", default="", help="part of the names of the problems")
    parser.add_argument("--formulations", nargs="+", default=["nested", "mpcc"])
    parser.add_argument("--seconds", type=float, default=60.0, help="limit of each solve")
    options = parser.parse_args(arguments)
    store = Store(options.out / "rows.jsonl")
    chosen = designs(*options.designs) if options.designs else cases()
    for case in (case for case in chosen if options.only in case.name):
        for formulation in options.formulations:
            for seed in case.seeds:
                if not store.has(case=case.name, formulation=formulation, seed=seed):
                    store.add(row(case, formulation, seed, options.seconds))
    print(f"{table(store.rows)}\n{counts(store.rows)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
