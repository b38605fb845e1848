"""What the paper prints against what is computed here, each statement with its evidence.

Energies are those of the problem's own rule, as the paper's are. A minimiser is found from the given mesh by
``joint`` and ``nested``, and from random starts by ``joint``. That no start reaches a printed energy is
evidence, not a proof.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

import casadi as ca
import numpy as np

from rmesh_nlp.examples import EXAMPLES, PAPER
from rmesh_nlp.examples.paper import PRINTED_DIGITS, truncated
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.driver import solve
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.solution import Solution

MET, PASSED, NOT_MET = "met", "passed", "cannot be met"

STARTS, QUICK_STARTS = 40, 1
"""Random starts under the printed move limits."""

LARGER_STARTS = 5  # random starts under enlarged move limits, and with friction weights held fixed
USABLE = ("exploited",)
"""Ends other than success whose energy, by the problem's own rule, is that of a valid mesh."""

Say = Callable[[str], object]


@dataclass(frozen=True)
class Statement:
    """A printed value and ours.

    The outcome is ``MET`` to the printed digits, ``PASSED`` by a lower energy, or ``NOT_MET``; empty where
    nothing is printed and the statement is evidence for another one.
    """

    example: str
    what: str
    printed: str
    ours: str
    outcome: str
    evidence: str


def reproduce(*, quick: bool = False, say: Say = lambda text: None) -> list[Statement]:
    """All statements about the three examples; some two minutes, ``quick`` some seconds."""
    starts = QUICK_STARTS if quick else STARTS
    statements: list[Statement] = []
    for example in EXAMPLES:
        say(f"{example}: given mesh")
        statements += _given(example)
        energies = _descents(example, 1.0, starts, say, nested=not quick)
        statements += _final(example, energies, starts)
        if statements[-1].outcome == NOT_MET:
            larger = 0 if quick else LARGER_STARTS
            statements += [_larger(example, factor, larger, say) for factor in PAPER[example].enlarged]
    statements.append(_frozen(0 if quick else LARGER_STARTS, say))
    return statements


def _given(example: str) -> list[Statement]:
    """Energy, least and largest displacement on the given mesh, as far as the paper prints them."""
    paper, solution, statements = PAPER[example], solve(EXAMPLES[example](), "fixed"), []
    u, evidence = solution.displacement, f"contact solve on the given mesh, {solution.status.value}"
    computed = solution.energy, float(u.min()), float(u.max())
    figures = {
        "initial energy": paper.energy_initial,
        "least initial displacement": paper.u_min_initial,
        "largest initial displacement": paper.u_max_initial,
    }
    for (what, printed), ours in zip(figures.items(), computed, strict=True):
        if printed is None:
            continue
        # of displacements one unit in the last place: the paper truncates some figures and rounds others
        near = abs(ours - printed) < 10.0**-PRINTED_DIGITS
        met = truncated(ours) == truncated(printed) if what == "initial energy" else near
        outcome = MET if met else NOT_MET
        statements.append(Statement(example, what, f"{printed:.4f}", f"{ours:.6f}", outcome, evidence))
    return statements


def _descents(example: str, factor: float, starts: int, say: Say, *, nested: bool) -> dict[str, float]:
    """Energies by where they come from: formulations from the given mesh, then ``joint`` from seeds."""
    dx, dy = PAPER[example].delta
    problem = EXAMPLES[example](delta=(factor * dx, factor * dy))
    energies = {"joint": _energy(solve(problem, "joint"))}
    if nested:
        energies["nested"] = _energy(solve(problem, "nested"))
    for seed in range(1, starts + 1):
        say(f"{example}: move limits times {factor:g}, random start {seed} of {starts}")
        energies[f"seed {seed}"] = _energy(solve(problem, "joint", seed=seed))
    return energies


def _energy(solution: Solution) -> float:
    return solution.energy if solution.success or solution.status.value in USABLE else math.nan


def _final(example: str, energies: dict[str, float], starts: int) -> list[Statement]:
    printed = PAPER[example].energy_final
    good = {name: value for name, value in energies.items() if math.isfinite(value)}
    best = min(good, key=good.__getitem__)
    seeds = [value for name, value in good.items() if name.startswith("seed")]
    given = ", ".join(f"{name} {energies[name]:.6f}" for name in ("joint", "nested") if name in energies)
    evidence = (
        f"lowest of {len(energies)} descents under the printed move limits; from the given mesh: {given}"
    )
    count = f"{len(seeds)} of {starts} random starts ended with a valid mesh, joint"
    spread = f"{min(seeds):.6f}, {median(seeds):.6f}, {max(seeds):.6f}" if seeds else "-"
    ours, outcome = f"{good[best]:.6f} ({best})", reached(good[best], printed)
    return [
        Statement(example, "random starts: least, median, largest", "-", spread, "", count),
        Statement(example, "final energy", f"{printed:.4f}", ours, outcome, evidence),
    ]


def reached(ours: float, printed: float) -> str:
    """The outcome for an energy: what is compared are the printed digits, which the paper truncates."""
    if truncated(ours) == truncated(printed):
        return MET
    return PASSED if truncated(ours) < truncated(printed) else NOT_MET


def _larger(example: str, factor: float, starts: int, say: Say) -> Statement:
    printed = PAPER[example].energy_final
    energies = _descents(example, factor, starts, say, nested=starts > 0)
    best = min(value for value in energies.values() if math.isfinite(value))
    outcome, meaning = reached(best, printed), "the paper prints the smaller move limits"
    if outcome != NOT_MET:
        meaning = "the printed energy is within reach of larger move limits than the paper prints"
    what = f"final energy with move limits {factor:g} times as large"
    evidence = f"lowest of {len(energies)} descents; {meaning}"
    return Statement(example, what, f"{printed:.4f}", f"{best:.6f}", outcome, evidence)


def _frozen(starts: int, say: Say) -> Statement:
    problem, printed = EXAMPLES["6.3"](), PAPER["6.3"].energy_final
    energies = []
    for seed in (None, *range(1, starts + 1)):
        say(f"6.3: friction weights held fixed, start {seed or 'given'}")
        energies.append(least_energy_with_frozen_friction(problem, seed))
    best = min(value for value in energies if math.isfinite(value))
    evidence = (
        f"lowest of {len(energies)} descents of an energy whose weights omega_i do not move with the nodes: "
        "not the energy of a contact problem on the final mesh"
    )
    what = "final energy, friction weights wrongly held fixed"
    return Statement("6.3", what, f"{printed:.4f}", f"{best:.6f}", reached(best, printed), evidence)


def least_energy_with_frozen_friction(problem: ContactProblem, seed: int | None = None) -> float:
    """Local minimum over positions and displacement of J with omega_i wrongly those of the given mesh.

    To see whether the paper did that. NaN if none is found. Only for contact along a straight horizontal
    boundary and a constant friction bound, as in 6.3.
    """
    outer = Outer.of(problem)
    program = outer.relocation
    nlp = program.nlp.extended(f=_difference(problem, program))
    q = outer.variables(seed=seed)
    solver = Solver(nlp)
    result = solver(outer.energy.unknowns(q, outer.energy(q).equilibrium.u))
    return result.f if result.converged else float("nan")


def _difference(problem: ContactProblem, program: Relocation) -> ca.MX:
    """Friction with the weights of the given mesh less friction with those of the moved one."""
    (part,) = problem.contact_sets
    bound = float(part.obstacle.friction)  # type: ignore[arg-type]
    nodes = problem.boundary_nodes(str(part.obstacle.boundary))  # held ends too: edges end there
    order = nodes[np.argsort(problem.mesh.p[0, nodes])]
    positions, slip, x = program.parts.mesh_map.positions, program.slip, program.nlp.x

    def place(node: int) -> ca.MX:
        index = int(positions.index[0, node])
        return positions.offset[0, node] + (positions.scale[0, node] * x[index] if index >= 0 else 0.0)

    difference = ca.MX(0)
    for a, b in pairwise(order):
        grown = place(b) - place(a) - (problem.mesh.p[0, b] - problem.mesh.p[0, a])
        for index in (int(slip.index[part.number, node]) for node in (a, b)):
            if index >= 0:
                difference -= 0.5 * bound * grown * x[index]
    return difference
