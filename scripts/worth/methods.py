"""What is compared: uniform and h-adaptive meshes, boxes, large moves with and without flips, hr."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import hertz
import numpy as np
from worth.cases import RULE, Case
from worth.rows import Row

from support.formulations import auto, fixed, nested
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.discretisation.validity import least_angles
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.refining import locally_refined
from rmesh_nlp.programs.hr import hr
from rmesh_nlp.programs.refinement import marked
from rmesh_nlp.solving.solution import Solution


def row(case: Case, method: str, size: str, problem: ContactProblem, seconds: float, **more: Any) -> Row:
    """Measure a mesh."""
    angle = float(np.min(least_angles(np.asarray(problem.mesh.p), problem.triangles)))
    nodes = int(problem.mesh.p.shape[1])
    error, units = case.error(problem), seconds / _unit(problem)
    return Row(case.name, method, size, nodes, error, seconds, units, least_angle=angle, **more)


def _unit(problem: ContactProblem) -> float:
    """Processor time of one cold contact solve."""
    model, began = ContactModel(problem), time.process_time()
    for _ in range(3):
        model.solve(problem.mesh.p)
    return (time.process_time() - began) / 3


def uniform(case: Case, size: int) -> Iterator[Row]:
    """The grid as given."""
    problem = case.problem(size)
    began = time.process_time()
    ContactModel(problem).solve(problem.mesh.p)
    seconds = time.process_time() - began
    figures = _contact(case, fixed.solve(problem)) if case.name == "Hertz" else {}
    yield row(case, "uniform", str(size), problem, seconds, figures=figures)


def adaptive(
    case: Case, method: str, indicators: Callable[[ContactProblem], np.ndarray], most: int
) -> Iterator[Row]:
    """Local refinement by some indicators from the coarsest grid on; time is that of all meshes so far."""
    problem, spent = case.problem(case.sizes[0]), 0.0
    while problem.mesh.p.shape[1] <= most:
        began = time.process_time()
        found = indicators(problem)
        spent += time.process_time() - began
        yield row(case, method, str(most), problem, spent)
        began = time.process_time()
        problem = locally_refined(problem, marked(found))
        spent += time.process_time() - began


def boxes(case: Case, size: int) -> Iterator[Row]:
    """Boxes that shrink with the mesh, as in the paper; Example 6.1 only."""
    problem = replace(EXAMPLES["6.1"](n=size), quadrature=RULE)
    began = time.process_time()
    solution = nested.solve(problem, outer="newton")
    yield _relocated(case, "boxes", size, solution, time.process_time() - began)


def large(case: Case, size: int, flips: bool) -> Iterator[Row]:
    """Large moves by a cascade, with or without flips."""
    problem = case.problem(size)
    began = time.process_time()
    solution = auto.solve(problem, flips=flips)
    seconds = time.process_time() - began
    yield _relocated(case, "large moves, flips" if flips else "large moves", size, solution, seconds)


def refined_and_relocated(case: Case, most: int) -> Iterator[Row]:
    """Hr with flips; the time is that of all meshes up to a number of nodes."""
    began = time.process_time()
    stages = hr(case.problem(case.sizes[0]), nodes=most)
    seconds = time.process_time() - began
    total = sum(stage.problem.mesh.p.shape[1] for stage in stages)
    spent = 0.0
    for stage in stages:
        spent += seconds * stage.problem.mesh.p.shape[1] / total
        yield row(case, "hr", str(most), stage.problem, spent)


def _relocated(case: Case, method: str, size: int, solution: Solution, seconds: float) -> Row:
    # the audit, and what a solve is worth, are not part of it
    record = solution.record()
    seconds *= 1 - record["audit_time_s"] / record["wall_time_s"]
    final = replace(solution.problem, mesh=solution.mesh, quadrature=RULE, reference=None)
    figures: dict[str, Any] = {"status": solution.status.value, "success": solution.success}
    reduction = solution.extra.get("error_reduction")
    if reduction:
        figures["claimed"] = round(reduction["factor"], 3)
    levels = record.get("cascade")
    if levels:
        one = _unit(case.problem(size))
        figures["finest"] = round(levels[-1]["seconds"] / one)
        figures["all"] = round(sum(level["seconds"] for level in levels) / one)
        figures["built"] = round(sum(level["build_seconds"] for level in levels) / one)
    figures |= _contact(case, solution)
    area = float(solution.audit.min_area_ratio)
    return row(case, method, str(size), final, seconds, least_area=area, figures=figures)


def _contact(case: Case, solution: Solution) -> dict[str, Any]:
    """Half-width and peak pressure over the analytic ones, where contact is Hertz's."""
    if case.name != "Hertz":
        return {}
    found = hertz.measure(solution)
    return {"half_width": found.half_width, "peak": found.peak}
