"""Which special rules earn their place: each is switched off in turn, on problems that chose none of them.

``python scripts/ablation.py --out DIR`` solves the problems as they are and then without each rule, adds a
row for each solve (a run that was stopped goes on), and prints a table: change of the gain, failures, and
cost. The problems are random ones of seeds that no other script has, meshes of gmsh and random designs. A
rule is a number or a table of options in a module, beside the plain value that takes its place.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd

import rmesh_nlp as rm
from random_designs import random_design
from rmesh_nlp.examples.random_problems import random_problem
from rows import Row, Store, command_line, markdown

SEEDS, DESIGN_SEEDS = range(91_000, 91_012), range(92_000, 92_008)
SECONDS = 60.0
"""Of each solve."""


@dataclass(frozen=True)
class Rule:
    """What is switched off: ``module:NAME`` with the plain value, or settings of the formulation."""

    name: str
    formulations: tuple[str, ...]
    kinds: tuple[str, ...]
    values: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)


def moving(problem: rm.ContactProblem, part: float | None) -> rm.ContactProblem:
    """With move limits in parts of the shortest edge; without any a rule that moves do not exploit."""
    if part is None:
        return replace(problem, motion=replace(problem.motion, delta=None), quadrature=8)
    return replace(problem, motion=replace(problem.motion, delta=rm.Relative(part)))


def shaped() -> dict[str, rm.ContactProblem]:
    """Meshes of gmsh: a corner, a hole in a plate on a foundation, a wedge."""
    law, down = rm.PlaneStress.from_young(1.0, 0.3), rm.Traction("top", (0.0, lambda x, y: -0.02 - 0.006 * x))
    plate, block = rm.shapes.plate_with_hole(1.8), rm.shapes.wedge_block(0.4)
    return {
        "corner": rm.ContactProblem(rm.shapes.l_shape(0.3), rm.Laplace(1.0), ("corner", "outer")),
        "hole": rm.ContactProblem(plate, law, ("left",), rm.Obstacle("bottom"), tractions=(down,)),
        "wedge": rm.ContactProblem(block, law, ("left",), tractions=(down,)),
    }


def problems() -> dict[str, tuple[str, rm.ContactProblem, str]]:
    """Kind, problem and objective by name; of a design its own objective."""
    cases: dict[str, tuple[str, rm.ContactProblem, str]] = {}
    for seed in SEEDS:
        problem = random_problem(seed, order=1 + (seed % 4 == 3))
        cases[f"limits {seed}"] = "limits", moving(problem, 0.3 + 0.5 * (seed % 2)), "energy"
        cases[f"free {seed}"] = "free", moving(problem, None), "energy"
        cases[f"error {seed}"] = "other", moving(random_problem(seed), 0.3), "compliance"
    for name, problem in shaped().items():
        cases[f"limits {name}"] = "limits", moving(problem, 0.5), "energy"
        cases[f"free {name}"] = "free", moving(problem, None), "energy"
    cases["fine 40"] = "fine", rm.EXAMPLES["6.1"](40), "energy"
    for seed in DESIGN_SEEDS:
        drawn = random_design(seed)
        cases[f"design {seed}"] = "design", drawn.problem, drawn.objective
    return cases


LIMITED, FREE, OTHERS = ("limits", "fine"), ("free",), ("other", "design")
ENERGY, ALL = (*LIMITED, *FREE), (*LIMITED, *OTHERS)
JOINT, MPCC, NESTED, AUTO, CONTACT = "joint", "mpcc", "nested", "auto", ("fixed", "nested")
WARM = {"formulations.outer_solvers:WARM_BARRIER": 0.1, "formulations.outer_solvers:WARM_PUSH": 0.01}
ABOVE = {"formulations.joint:is_above": lambda *_: False}
ACTIVE_SET = "rmesh_nlp.contact.active_set"

RULES = (
    Rule(
        "joint: units of displacements far from one",
        (JOINT,),
        ENERGY,
        {"formulations.ipopt:ORDINARY": (0.0, np.inf)},
    ),
    Rule("joint, mpcc: again where the end is above the start", (JOINT, MPCC), ENERGY, ABOVE),
    Rule("mpcc: barrier that falls slowly", (MPCC,), LIMITED, {"formulations.mpcc:SLOW": {}}),
    Rule("mpcc: second path of designs", (MPCC,), ("design",), settings={"twice": False}),
    Rule("nested: warm barrier", (NESTED,), ALL, WARM),
    Rule(
        "Newton: all products at once up to 200 variables",
        (NESTED, AUTO),
        ENERGY,
        {"rmesh_nlp.models.second_derivatives:DENSE": 0},
    ),
    Rule("contact: patience with blocks", CONTACT, ALL, {f"{ACTIVE_SET}:PATIENCE": 10**6}),
)


@contextmanager
def without(rule: Rule) -> Iterator[None]:
    """The plain values in every module that has the rule's."""
    with ExitStack() as stack:
        for place, plain in rule.values.items():
            module, name = place.split(":")
            value = getattr(importlib.import_module(module), name)
            for other in list(sys.modules.values()):
                of_package = other.__name__.startswith(("rmesh_nlp", "formulations"))
                if of_package and vars(other).get(name) is value:
                    stack.enter_context(patch.object(other, name, plain))
        yield


PLAIN = Rule("as it is", ("fixed", "joint", "mpcc", "nested", "auto"), (*LIMITED, *FREE, *OTHERS))
NOT_FOR = {("joint", "other"), ("joint", "design"), ("auto", "limits"), ("auto", "fine"), ("fixed", "free")}


def solved(rule: Rule, formulation: str, problem: rm.ContactProblem, objective: str) -> Iterator[Row]:
    """Gain in what is minimised, success and cost in contact solves and factorisations."""
    how = {"objective": objective, "limits": rm.Limits(SECONDS), **rule.settings}
    with without(rule), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        record = rm.solve(problem, formulation, **how).record()
    before, after = record["energy_initial_audited"], record["energy_audited"]
    if objective != "energy":
        before, after = record.get("objective_initial"), record["objective_value"]
    gain = (before - after) if None not in (before, after) else 0.0
    cost = record["contact_solves"] + record.get("kkt_factorisations", 0)
    yield {"success": record["success"], "status": record["status"], "gain": gain, "cost": cost}


def table(rows: Sequence[Row]) -> str:
    """Per rule: cases, median and least gain over that with the rule, how many ended otherwise, and cost."""
    frame = pd.DataFrame(rows)
    frame["success"] = frame.success.eq(True)  # what raised an error has none
    plain = frame[frame.rule == PLAIN.name]
    pairs = frame.merge(plain, on=["formulation", "case"], suffixes=("", "_before"))
    lines = []
    for rule, own in pairs[pairs.rule != PLAIN.name].groupby("rule", sort=False):
        both = own[own.success & own.success_before & (own.gain_before > 0)]
        line = {"rule": rule, "solves": len(own)}
        ratios = both.gain / both.gain_before
        line |= {"median gain without": f"{ratios.median():.4f}", "least": f"{ratios.min():.3f}"}
        for name, before, now in (
            ("successes", own.success_before, own.success),
            ("converged", own.status_before == "converged", own.status == "converged"),
        ):
            line[f"{name} lost, won"] = f"{(before & ~now).sum()}, {(now & ~before).sum()}"
        line["cost"] = f"{both.cost.sum() / max(both.cost_before.sum(), 1):.2f}"
        lines.append(line)
    return markdown(pd.DataFrame(lines))


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve what is missing and print the table."""
    parser = command_line(__doc__, out="results/ablation")
    options = parser.parse_args(arguments)
    store, cases = Store(options.out / "rows.jsonl"), problems()
    for rule in (PLAIN, *RULES):
        for name, (kind, problem, objective) in cases.items():
            for formulation in rule.formulations if kind in rule.kinds else ():
                key = {"rule": rule.name, "formulation": formulation, "case": name}
                if (formulation, kind) not in NOT_FOR:
                    store.measure(key, partial(solved, rule, formulation, problem, objective))
    print(table(store.rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
