"""What every gallery case does: solve by several formulations, check, draw."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.problem import ContactProblem
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
    unknowns : int
        Displacement unknowns.
    """

    before: Solution
    after: Solution
    nested: Solution
    error_before: float
    error_after: float
    unknowns: int

    def report(self) -> str:
        """A few lines for people."""
        lines = [
            f"{self.before.problem.name}: {self.unknowns} unknowns",
            f"  energy       {self.before.energy:.8g} -> {self.after.energy:.8g} (joint), "
            f"{self.nested.energy:.8g} (nested)",
            f"  audited      {self.before.audit.energy_audited:.8g} -> {self.after.audit.energy_audited:.8g}",
            f"  error        {self.error_before:.4g} -> {self.error_after:.4g}",
            f"  least area   {self.after.audit.min_area_ratio:.3g} of the initial one",
        ]
        return "\n".join(lines)


def run(
    problem: ContactProblem,
    error: Error,
    **nested_options: object,
) -> Case:
    """Solve on the grid as given and relocated, and check.

    Raises
    ------
    AssertionError
        If a solve does not succeed, an element is inverted, the energy rises, or the
        formulations disagree.
    """
    before, after = rm.solve(problem, "fixed"), rm.solve(problem, "joint")
    other = rm.solve(problem, "nested", **nested_options)
    for solution in (before, after, other):
        assert solution.success, f"{solution.formulation}: {solution.status.message}"
        assert solution.audit.min_area_ratio > 0
    # of the continuous problem: one of them may have been solved again by a safe discretisation
    given, best, second = (one.audit.energy_audited for one in (before, after, other))
    assert best <= given
    difference = abs(best - second) / max(abs(best), 1e-300)
    assert difference <= AGREEMENT, f"joint and nested differ by {difference:.1e}"
    return Case(before, after, other, error(before), error(after), unknowns(problem))


def unknowns(problem: ContactProblem) -> int:
    """Displacement components that are not given."""
    return int(np.sum(~problem.held()[0]))


def energy_above(reference: float) -> Error:
    """Audited energy above a reference."""
    return lambda solution: solution.audit.energy_audited - reference


def energy_norm(solution: Solution) -> float:
    """I1 of (4.1), half the squared energy norm of the error against the exact solution."""
    nodes, nothing = np.asarray(solution.mesh.p), ca.MX.sym("x", 1)
    groups = parse_objective("error-energy").groups(
        solution.problem,
        constant_field(nodes),
        constant_field(solution.displacement),
        constant_field(np.zeros((1, nodes.shape[1]))),
    )
    value = Assembled(groups, nothing, ca.MX(0, 1), 0).f
    return float(ca.Function("error", [nothing], [value])(0))


def draw(case: Case, path: Path) -> None:
    """The meshes before and after, coloured by the displacement or the von Mises stress."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    for axis, solution, title in zip(axes, (case.before, case.after), ("as given", "relocated"), strict=True):
        x, y = solution.mesh.p
        t = solution.problem.triangles.T
        if solution.problem.components == 1:
            image = axis.tripcolor(x, y, t, solution.displacement[0], shading="gouraud")
            label = "u"
        else:
            stress = stresses(solution.problem, np.asarray(solution.mesh.p), solution.displacement)
            image = axis.tripcolor(x, y, t, facecolors=von_mises(stress))
            label = "von Mises stress, N/m$^2$"
        axis.triplot(x, y, t, linewidth=0.3, color="black")
        axis.set(title=f"{title}: J = {solution.energy:.6g}", aspect="equal")
        figure.colorbar(image, ax=axis, label=label, shrink=0.7)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def command_line(main: Callable[[int], Case], n: int) -> None:
    """Run a case from the command line."""
    parser = argparse.ArgumentParser(description=(main.__doc__ or "").splitlines()[0])
    parser.add_argument("--n", type=int, default=n, help=f"size of the grid (default {n})")
    parser.add_argument("--picture", type=Path, help="file to draw to")
    options = parser.parse_args()
    case = main(options.n)
    print(case.report())
    if options.picture is not None:
        draw(case, options.picture)
