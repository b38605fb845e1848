"""What the paper prints against what is computed here, each statement with its evidence.

Energies are those of the problem's own rule, as the paper's are. A minimiser is found from the given mesh by
``joint`` and ``nested``, and from random starts by ``joint``. That no start reaches a printed energy is
evidence, not a proof.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from rmesh_nlp.examples import EXAMPLES, PAPER
from rmesh_nlp.examples.paper import PRINTED_DIGITS, truncated
from rmesh_nlp.solving.driver import solve
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.study.frozen_friction import least_energy

MET, PASSED, NOT_MET = "met", "passed", "cannot be met"

STARTS, QUICK_STARTS = 40, 1
"""Random starts under the printed boxes."""

LARGER = {"6.2": (1.5, 2.0), "6.3": (2.0, 4.0)}
"""Factors by which boxes are enlarged where the printed energy is not reached."""

LARGER_STARTS = 5
"""Random starts under enlarged boxes, and with friction weights held fixed."""

USABLE = ("exploited",)
"""Ends other than success whose energy, by the problem's own rule, is that of a valid mesh."""

Say = Callable[[str], object]


@dataclass(frozen=True)
class Statement:
    """A printed value and ours.

    Attributes
    ----------
    example, what : str
    printed, ours : str
    verdict : str
        ``MET`` to the printed digits, ``PASSED`` by a lower energy, or ``NOT_MET``; empty where nothing is
        printed and the statement is evidence for another one.
    evidence : str
    """

    example: str
    what: str
    printed: str
    ours: str
    verdict: str
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
        if example in LARGER and statements[-1].verdict == NOT_MET:
            larger = 0 if quick else LARGER_STARTS
            statements += [_larger(example, factor, larger, say) for factor in LARGER[example]]
    statements.append(_frozen(0 if quick else LARGER_STARTS, say))
    return statements


def _given(example: str) -> list[Statement]:
    paper = PAPER[example]
    solution = solve(EXAMPLES[example](), "fixed")
    met = truncated(solution.energy) == truncated(paper.energy_initial)
    how = f"contact solve on the given mesh, {solution.status.value}"
    found = [
        _statement(example, "initial energy", paper.energy_initial, f"{solution.energy:.6f}", met, how),
    ]
    u = solution.displacement
    for name, printed, ours in (
        ("least initial displacement", paper.u_min_initial, float(u.min())),
        ("largest initial displacement", paper.u_max_initial, float(u.max())),
    ):
        if printed is not None:
            # one unit in the last place: the paper truncates some of its figures and rounds others
            met = abs(ours - printed) < 10.0**-PRINTED_DIGITS
            found.append(_statement(example, name, printed, f"{ours:.6f}", met, how))
    return found


def _statement(example: str, what: str, printed: float, ours: str, met: bool, evidence: str) -> Statement:
    return Statement(example, what, f"{printed:.4f}", ours, MET if met else NOT_MET, evidence)


def _descents(example: str, factor: float, starts: int, say: Say, *, nested: bool) -> dict[str, float]:
    """Energies by where they come from: formulations from the given mesh, then ``joint`` from seeds."""
    dx, dy = PAPER[example].delta
    problem = EXAMPLES[example](delta=(factor * dx, factor * dy))
    energies = {"joint": _energy(solve(problem, "joint"))}
    if nested:
        energies["nested"] = _energy(solve(problem, "nested"))
    for seed in range(1, starts + 1):
        say(f"{example}: boxes times {factor:g}, random start {seed} of {starts}")
        energies[f"seed {seed}"] = _energy(solve(problem, "joint", seed=seed))
    return energies


def _energy(solution: Solution) -> float:
    return solution.energy if solution.success or solution.status.value in USABLE else math.nan


def _final(example: str, energies: dict[str, float], starts: int) -> list[Statement]:
    paper = PAPER[example]
    good = {name: value for name, value in energies.items() if math.isfinite(value)}
    best = min(good, key=good.__getitem__)
    verdict = _reached(good[best], paper.energy_final)
    seeds = [value for name, value in good.items() if name.startswith("seed")]
    given = ", ".join(f"{name} {energies[name]:.6f}" for name in ("joint", "nested") if name in energies)
    evidence = f"lowest of {len(energies)} descents under the printed boxes; from the given mesh: {given}"
    count = f"{len(seeds)} of {starts} random starts ended with a valid mesh"
    spread = f"{min(seeds):.6f}, {median(seeds):.6f}, {max(seeds):.6f}" if seeds else "-"
    return [
        Statement(example, "random starts: least, median, largest", "-", spread, "", f"{count}, joint"),
        Statement(
            example,
            "final energy",
            f"{paper.energy_final:.4f}",
            f"{good[best]:.6f} ({best})",
            verdict,
            evidence,
        ),
    ]


def _reached(ours: float, printed: float) -> str:
    if truncated(ours) == truncated(printed):
        return MET
    return PASSED if truncated(ours) < truncated(printed) else NOT_MET


def _larger(example: str, factor: float, starts: int, say: Say) -> Statement:
    printed = PAPER[example].energy_final
    energies = _descents(example, factor, starts, say, nested=starts > 0)
    best = min(value for value in energies.values() if math.isfinite(value))
    verdict, evidence = _reached(best, printed), f"lowest of {len(energies)} descents"
    meaning = "the paper prints the smaller boxes"
    if verdict != NOT_MET:
        meaning = "the printed energy is within reach of larger boxes than the paper prints"
    return Statement(
        example,
        f"final energy with boxes {factor:g} times as large",
        f"{printed:.4f}",
        f"{best:.6f}",
        verdict,
        f"{evidence}; {meaning}",
    )


def _frozen(starts: int, say: Say) -> Statement:
    problem, printed = EXAMPLES["6.3"](), PAPER["6.3"].energy_final
    energies = []
    for seed in (None, *range(1, starts + 1)):
        say(f"6.3: friction weights held fixed, start {seed or 'given'}")
        energies.append(least_energy(problem, seed))
    best = min(value for value in energies if math.isfinite(value))
    return Statement(
        "6.3",
        "final energy, friction weights wrongly held fixed",
        f"{printed:.4f}",
        f"{best:.6f}",
        _reached(best, printed),
        f"lowest of {len(energies)} descents of an energy whose weights omega_i do not move with the nodes: "
        "not the energy of a contact problem on the final mesh",
    )
