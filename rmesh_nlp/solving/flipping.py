"""Strategies with edge flips between relocations, and a solution that refers to the mesh as given."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from rmesh_nlp.assessment.verdict import verdict
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.programs.energy_flips import Round, flips_and_moves, mean_around
from rmesh_nlp.programs.regularisation import gain_estimate
from rmesh_nlp.solving.clock import solving
from rmesh_nlp.solving.solution import Given, Solution, counted


def check_flips(problem: ContactProblem) -> None:
    """Raise if flips cannot be combined with what the problem asks for.

    Raises
    ------
    BadInputError
        With boxes, which are around positions in the mesh as given.
    """
    if problem.motion.delta is not None:
        raise BadInputError('flips need a problem without boxes: delta = "none"')


def solve_with_flips(solve: Callable[..., Solution], problem: ContactProblem, **options: Any) -> Solution:
    """Solve by a strategy, then flip edges by energy and solve again, until neither gains.

    Parameters
    ----------
    solve : callable
        A strategy.
    problem : ContactProblem
        Without boxes.
    options
        Keywords of the strategy, for each solve.
    """
    check_flips(problem)
    began = time.perf_counter()
    solutions = [solve(problem, **options)]
    again = {**options, "start": None, "seed": None}
    if options.get("regularisation") is not None:  # its final weight is relative to the mesh as given
        again |= {"regularisation": None, "objective": solutions[0].objective}

    def relocate(flipped: ContactProblem) -> ContactProblem:
        solutions.append(solve(flipped, **again))
        return replace(flipped, mesh=solutions[-1].mesh)

    moved = replace(problem, mesh=solutions[0].mesh)
    last, rounds = flips_and_moves(moved, gain_estimate(problem).value, relocate, given=problem)
    final = solutions[-1]
    if not (rounds and _same(final, last)):
        final = solve(last, **{**again, "max_iterations": 1})
        solutions.append(final)
    found = with_flips(problem, solutions[0], final, rounds, solutions)
    seconds = solving(time.perf_counter() - began, found.build_time_s, found.audit_time_s)
    return replace(found, solve_time_s=seconds)


def _same(solution: Solution, problem: ContactProblem) -> bool:
    return np.array_equal(solution.mesh.p, problem.mesh.p) and np.array_equal(solution.mesh.t, problem.mesh.t)


def with_flips(
    problem: ContactProblem,
    first: Solution,
    final: Solution,
    rounds: Sequence[Round],
    all_solutions: Sequence[Solution] = (),
) -> Solution:
    """A solution on flipped edges that refers to the mesh as given: gain, initial positions, areas.

    A triangle that the mesh as given does not have is compared with the mean of the given ones around
    its vertices.
    """
    given, triangles = problem.mesh, final.problem.triangles
    areas = given_areas(problem, triangles)
    ratio = float(np.min(signed_areas(final.mesh.p, triangles) / areas))
    before = {tuple(t) for t in np.sort(problem.triangles, axis=0).T}
    changed = sum(tuple(t) not in before for t in np.sort(triangles, axis=0).T)
    solutions = all_solutions or (final,)
    extra = {
        **first.extra,
        **final.extra,
        **counted(solutions),
        "flips": sum(one.flips for one in rounds),
        "changed_triangles": changed,
        "flip_rounds": [asdict(one) for one in rounds],
    }
    if problem.motion.curves:
        extra["domain_area_change"] = (
            signed_areas(final.mesh.p, triangles).sum() / signed_areas(given.p, problem.triangles).sum() - 1
        )
    return replace(
        _judged_as_a_whole(first, final),
        given=Given(np.array(given.p), areas),
        assessed=None
        if first.assessed is None or final.assessed is None
        else (first.assessed[0], final.assessed[1]),
        energy_initial=first.energy_initial,
        energy_initial_audited=first.energy_initial_audited,
        audit=replace(final.audit, min_area_ratio=ratio),
        iterations=sum(s.iterations for s in solutions),
        contact_solves=sum(s.contact_solves for s in solutions) + 3 * len(rounds),
        build_time_s=sum(s.build_time_s for s in solutions),
        solve_time_s=sum(s.solve_time_s for s in solutions),
        audit_time_s=sum(s.audit_time_s for s in solutions),
        extra=extra,
    )


def _judged_as_a_whole(first: Solution, final: Solution) -> Solution:
    """The last solution with the verdict on the gain of all rounds: its own gain is that of the last one.

    With an objective other than the energy the verdict is that of the last round.
    """
    one, last = first.measured, final.measured
    if one is None or last is None or not last.is_energy:
        return final
    audited = first.energy_initial_audited - final.audit.energy_audited
    whole = replace(
        last,
        gain=first.energy_initial - final.energy,
        gain_audited=audited,
        decrease=audited,
        size=max(one.size, last.size),
        corrections={
            name: last.corrections.get(name, 0.0) + value for name, value in one.corrections.items()
        },
    )
    judged = verdict(final.solver_status or final.status, whole)
    return replace(
        final,
        status=judged.status,
        success=judged.success,
        valid=judged.valid,
        improved=judged.improved,
        detail="" if judged.status is not final.status else final.detail,
        measured=whole,
    )


def given_areas(problem: ContactProblem, triangles: np.ndarray) -> np.ndarray:
    """(elements,) areas in the mesh as given of triangles (3, elements), some of which it may not have."""
    own = problem.triangles
    areas = signed_areas(problem.mesh.p, own)
    around = mean_around(own, areas, problem.mesh.p.shape[1])[triangles].mean(axis=0)
    known = {tuple(t): a for t, a in zip(np.sort(own, axis=0).T.tolist(), areas, strict=True)}
    sought = np.sort(triangles, axis=0).T.tolist()
    return np.array([known.get(tuple(t), mean) for t, mean in zip(sought, around, strict=True)])
