"""What every gallery case does: solve by several formulations, check, draw."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import Fields, constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.solution import Solution

AGREEMENT = 1e-4
"""Largest relative difference of energy between joint and nested."""

Error = Callable[[Solution], float]


@dataclass(frozen=True)
class Case:
    """One gallery case, solved.

    Attributes
    ----------
    before, after, nested : Solution
        On the grid as given, relocated by joint, relocated by nested.
    error_before, error_after : float
        Of the energy, or of the solution in the energy norm squared over two.
    """

    before: Solution
    after: Solution
    nested: Solution
    error_before: float
    error_after: float

    def __str__(self) -> str:
        before, after, problem = self.before, self.after, self.before.problem
        audited = [solution.energy_audited for solution in (before, after)]
        return (
            f"{problem.name}: {np.sum(~problem.held[0])} unknowns\n"
            f"  energy       {before.energy:.8g} -> {after.energy:.8g} (joint), "
            f"{self.nested.energy:.8g} (nested)\n"
            f"  audited      {audited[0]:.8g} -> {audited[1]:.8g}\n"
            f"  error        {self.error_before:.4g} -> {self.error_after:.4g}\n"
            f"  least area   {after.assessment.final.min_area_ratio:.3g} of the initial one"
        )


def run(problem: ContactProblem, error: Error) -> Case:
    """Solve on the grid as given and relocated, and check.

    Raises
    ------
    AssertionError
        If a solve does not succeed, an element is inverted, the energy rises, or the
        formulations disagree.
    """
    solutions = [rm.solve(problem, name) for name in ("fixed", "joint", "nested")]
    for solution in solutions:
        assert solution.success, f"{solution.formulation}: {solution.status.message}"
        assert solution.assessment.final.min_area_ratio > 0
    # of the continuous problem: one of them may have been solved again by a safe discretisation
    given, best, second = (solution.energy_audited for solution in solutions)
    assert best <= given
    difference = abs(best - second) / max(abs(best), 1e-300)
    assert difference <= AGREEMENT, f"joint and nested differ by {difference:.1e}"
    before, after, nested = solutions
    return Case(before, after, nested, error(before), error(after))


def energy_above(reference: float) -> Error:
    """Audited energy above a reference."""
    return lambda solution: solution.energy_audited - reference


def exact_errors(problem: ContactProblem, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(elements,) half the squared energy norm of the error of nodal values against the exact solution."""
    fields = Fields(DisplacementSpace(problem), *(constant_field(each) for each in (nodes, values, values)))
    return element_values(parse_objective("error-energy").on(fields).groups)(np.zeros(0))[0]


def energy_norm(solution: Solution) -> float:
    """I1 of (4.1), half the squared energy norm of the error against the exact solution."""
    return float(exact_errors(solution.problem, np.asarray(solution.mesh.p), solution.displacement).sum())


def shifted(outer: Outer, q: np.ndarray, row: int, shifts: Iterable[float]) -> Iterator[ReducedPoint]:
    """The points that ``outer.function`` has as one outer variable is changed."""
    for shift in shifts:
        moved = q.copy()
        moved[row] += shift
        yield outer.function(moved)


def draw(case: Case, path: Path) -> None:
    """The meshes before and after, coloured by the displacement or the von Mises stress."""
    solutions = (case.before, case.after)
    axes = rm.plot(*solutions, what="displacement" if case.before.problem.components == 1 else "stress")
    for axis, solution, title in zip(axes, solutions, ("as given", "relocated"), strict=True):
        axis.triplot(*solution.mesh.p, solution.problem.triangles.T, linewidth=0.3, color="black")
        axis.set(title=f"{title}: J = {solution.energy:.6g}")
    save(axes[0].figure, path)


def save(figure: Any, path: Path) -> None:
    """Write a figure and forget it."""
    figure.savefig(path, dpi=150)
    plt.close(figure)


def command_line(main: Callable[[int], Any], n: int, draw: Callable[[Any, Path], None] = draw) -> None:
    """Run a case from the command line, and draw what it found."""
    parser = argparse.ArgumentParser(description=(main.__doc__ or "").splitlines()[0])
    parser.add_argument("--n", type=int, default=n, help=f"size of the grid (default {n})")
    parser.add_argument("--picture", type=Path, help="file to draw to")
    options = parser.parse_args()
    result = main(options.n)
    if isinstance(result, Case):
        print(result)
    if options.picture is not None:
        draw(result, options.picture)
