"""The factor that ``rmesh advise`` predicts, beside the measured one, on random problems held out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from best_mesh.cases import RULE
from best_mesh.methods import by_default
from best_mesh.rows import GIVEN, NEAR, REMESHED, Row, of
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.models.remeshing import Solved, metric_start
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.advice import advise

PREDICTED, ADVISED, UNKNOWN = "predicted", "as advised", ", not known"
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
    start, found = Solved.of(problem), []
    for nodes in FINE_NODES:
        start = metric_start(start, nodes).solved
        found.append((_nodes(start.problem), admissible(start.problem).energy))
    (before, higher), (last, least) = found
    doubt = (higher - least) * before / (last - before)
    return least - doubt, abs(doubt)


def measured(seed: int) -> Iterator[Row]:
    """Errors of the given mesh, remeshed and relocated, and as advised; the predicted factor."""
    problem, name = drawn(seed), f"random {seed}"
    began = time.process_time()
    advice = advise(problem)
    seconds = time.process_time() - began
    limit, doubt = reference(problem)
    way = getattr(advice, "recommended", "remesh")
    remeshed = by_default(problem, remesh=True)
    advised = {
        "remesh": lambda: remeshed,
        "relocate": lambda: by_default(problem, remesh=False),
        "refine": lambda: (refined(problem), np.nan, ""),
    }[way]()
    given = admissible(problem).energy - limit
    is_known = given > ROUNDING * abs(limit)
    yield Row(name, GIVEN, seed, _nodes(problem), given)
    for method, (final, spent, status) in ((REMESHED, remeshed), (ADVISED, advised)):
        error = admissible(final).energy - limit
        is_known = is_known and doubt < KNOWN * error
        yield Row(name, method, seed, _nodes(final), error, spent, status)
    factor = float(getattr(advice, "predicted_factor", np.nan))
    yield Row(name, PREDICTED, seed, _nodes(problem), factor, seconds, way if is_known else way + UNKNOWN)


def known(rows: Sequence[Row]) -> int:
    """How many problems can be compared."""
    return sum(r.method == PREDICTED and not r.status.endswith(UNKNOWN) for r in rows)


def _nodes(problem: ContactProblem) -> int:
    return int(problem.mesh.p.shape[1])


def summary(rows: Sequence[Row]) -> str:
    """Predicted and measured factors in Markdown, and how many are close; what failed or is not known."""
    lines = ["| problem | nodes | error | advised | predicted | measured | over | remeshed, relocated |"]
    lines.append("|:--|--:|--:|:--|--:|--:|--:|--:|")
    ratios, left = [], []
    for case in dict.fromkeys(r.case for r in rows):
        found = [of(rows, case, name) for name in (GIVEN, REMESHED, ADVISED, PREDICTED)]
        if not all(found) or found[3][0].status.endswith(UNKNOWN):
            left.append(case)
            continue
        given, remeshed, advised, said = (one[0] for one in found)
        equal = {"refine": given.nodes}.get(said.status, advised.nodes)  # with four times as many
        factor = given.error / advised.error * given.nodes / equal
        ratios.append(said.error / factor)
        numbers = f"{said.error:.3g} | {factor:.3g} | {ratios[-1]:.2f}"
        other = given.error / remeshed.error * given.nodes / remeshed.nodes
        lines.append(
            f"| {case} | {given.nodes} | {given.error:.3g} | {said.status} | {numbers} | {other:.3g} |"
        )
    close = sum(abs(ratio - 1) <= CLOSE + NEAR for ratio in ratios)
    ending = f"\n{close} of {len(ratios)} within {CLOSE:.0%}; not compared: {', '.join(left) or 'none'}\n"
    return "\n".join([*lines, ending])
