"""The factor that ``rmesh advise`` predicts, beside the measured one, on random problems held out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from best_mesh.cases import REFERENCE_NODES, RULE, reference
from best_mesh.methods import by_default
from best_mesh.rows import GIVEN, NEAR, REMESHED, Row, of
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.advice import advise

PREDICTED = "predicted"
FIRST_SEED, COUNT, CLOSE = 90_000, 20, 0.2
"""Of problems that nothing was chosen on; how many; the relative difference that counts as agreement."""

SIZES, KNOWN = (200, 1500), 0.05
"""Least and most nodes; largest part of the error after relocation that the reference may be wrong by."""


def drawn(seed: int) -> ContactProblem:
    """A random problem without move limits, refined until it is large enough."""
    problem = replace(random_problem(seed), motion=Motion(None), quadrature=RULE)
    while problem.mesh.p.shape[1] < SIZES[0]:
        problem = refined(problem)
    return problem


def measured(seed: int) -> Iterator[Row]:
    """Errors of the given and the final mesh, and the predicted factor; none where errors are not known."""
    problem, name = drawn(seed), f"random {seed}"
    fine = reference(problem, REFERENCE_NODES)
    began = time.process_time()
    predicted = float(getattr(advise(problem), "predicted_factor", np.nan))
    seconds = time.process_time() - began
    final, spent, status = by_default(problem, remesh=True)
    before, after = (admissible(one).energy - fine.limit for one in (problem, final))
    if fine.doubt > KNOWN * after or before < 1e-9 * abs(fine.limit):
        status = f"not known: {fine.doubt:.1e}"
    counts = [int(one.mesh.p.shape[1]) for one in (problem, final)]
    yield Row(name, GIVEN, seed, counts[0], before)
    yield Row(name, REMESHED, seed, counts[1], after, spent, status)
    yield Row(name, PREDICTED, seed, counts[0], predicted, seconds)


def summary(rows: Sequence[Row]) -> str:
    """Predicted and measured factors in Markdown, and how many are close."""
    lines = ["| problem | nodes | error | predicted | measured | over |", "|:--|--:|--:|--:|--:|--:|"]
    ratios = []
    for case in dict.fromkeys(r.case for r in rows):
        found = [of(rows, case, name) for name in (GIVEN, REMESHED, PREDICTED)]
        if not all(found) or found[1][0].status.startswith("not known"):
            continue
        given, moved, said = (one[0] for one in found)
        factor = given.error / moved.error * given.nodes / moved.nodes
        ratios.append(said.error / factor)
        cells = f"{given.error:.3g} | {said.error:.3g} | {factor:.3g} | {ratios[-1]:.2f}"
        lines.append(f"| {case} | {given.nodes} | {cells} |")
    close = sum(abs(ratio - 1) <= CLOSE + NEAR for ratio in ratios)
    return "\n".join([*lines, f"\n{close} of {len(ratios)} within {CLOSE:.0%}\n"])
