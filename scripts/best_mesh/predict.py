"""The factor that ``rmesh advise`` predicts, beside the measured one, on random problems held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from best_mesh.cases import RULE, extrapolated
from best_mesh.methods import by_default, unknowns
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.models.remeshing import Solved, metric_start
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.advice import advise
from rows import Row, Store, markdown

COUNT, SEEDS, CLOSE = 20, range(90_020, 90_080), 0.2
"""How many problems whose errors are known; seeds, on which nothing was chosen, that are tried in turn; the
relative difference that counts as agreement."""

LEAST_NODES, FINE_NODES = 200, (4_000, 12_000)
"""Of the problems, which have up to four times as many, and of the meshes of their references."""

KNOWN, ROUNDING = 0.2, 1e-9
"""Largest part of an error that is extrapolated; errors, in parts of the energy, that are none."""


def drawn(seed: int) -> ContactProblem:
    """A random problem without move limits, refined until it is large enough."""
    problem = replace(random_problem(seed), motion=Motion(None), quadrature=RULE)
    while problem.mesh.p.shape[1] < LEAST_NODES:
        problem = refined(problem)
    return problem


def reference(problem: ContactProblem) -> tuple[float, float]:
    """The energy that meshes for the solution tend to, and how far it is extrapolated.

    Many of these solutions vary in one direction only: locally refined meshes come less near.
    """
    start, meshes = Solved.of(problem), []
    for nodes in FINE_NODES:
        start = metric_start(start, nodes).solved
        meshes.append((unknowns(start.problem), admissible(start.problem).energy))
    return extrapolated(*meshes)


def compared(seed: int) -> Row:
    """Predicted factor, and measured ones at equal nodes: as advised, and by remeshing and relocation.

    They are missing where the reference does not know the errors. Refining has four times as many nodes.
    """
    problem = drawn(seed)
    advice, (limit, doubt) = advise(problem), reference(problem)
    advised = getattr(advice, "recommended", "remesh")
    remeshed = by_default(problem, remesh=True)[0]
    final = {
        "remesh": lambda: remeshed,
        "relocate": lambda: by_default(problem, remesh=False)[0],
        "refine": lambda: refined(problem),
    }[advised]()
    nodes, error = unknowns(problem), admissible(problem).energy - limit
    row: Row = {"seed": seed, "nodes": nodes, "error": error, "advised": advised}
    row["predicted"] = float(getattr(advice, "predicted_factor", np.nan))
    errors = [admissible(end).energy - limit for end in (final, remeshed)]
    if error > ROUNDING * abs(limit) and doubt < KNOWN * min(errors):
        counts = [nodes if advised == "refine" else unknowns(final), unknowns(remeshed)]
        factors = [error / left * nodes / count for left, count in zip(errors, counts, strict=True)]
        row |= dict(zip(("measured", "remeshed, relocated"), factors, strict=True))
    return row


def measured(store: Store) -> list[Row]:
    """Rows of as many problems as are wanted; what fails is a row."""
    for seed in SEEDS:
        if sum("measured" in row for row in store.rows) < COUNT and not store.has(seed=seed):
            try:
                store.add(compared(seed))
            except Exception as error:
                store.add({"seed": seed, "status": f"{type(error).__name__}: {error}"})
            print(store.rows[-1], flush=True)
    return store.rows


def summary(rows: Sequence[Row]) -> str:
    """Predicted and measured factors in Markdown, and how many are close; seeds that are not known."""
    columns = ["seed", "nodes", "error", "advised", "predicted", "measured", "over", "remeshed, relocated"]
    frame = pd.DataFrame([row for row in rows if "measured" in row], columns=columns)
    frame["over"] = frame.predicted / frame.measured
    close = int(np.sum(np.abs(frame.over - 1) <= CLOSE))
    unknown = ", ".join(str(row["seed"]) for row in rows if "measured" not in row) or "none"
    return f"{markdown(frame)}\n{close} of {len(frame)} within {CLOSE:.0%}; not compared: {unknown}\n"
