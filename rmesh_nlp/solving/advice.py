"""What to do with a mesh before anything moves: relocate, refine locally, or refine uniformly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.assessment.error_reduction import ErrorReduction, error_reduction
from rmesh_nlp.display import figure
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.models.cascade import CascadeSettings, cascade
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined

WORTHWHILE = 1.5
"""Factor by which an error must fall for relocation to be recommended."""

RATES = (0.2, 1.5)
"""Rates that are believed; what two refinements show beyond is the coarseness of the mesh."""

SMOOTH = 0.85
"""Rate of the error of the energy, in powers of the number of nodes, from which on local refinement is not
recommended: 1 for a smooth solution."""


@dataclass(frozen=True)
class Advice:
    """What ``rmesh advise`` finds.

    Attributes
    ----------
    relocation : ErrorReduction or None
        On this mesh by a map found on a coarse one, with one iteration on this one; None where nothing can
        be claimed.
    rate : float
        The error falls like (number of nodes)^-rate under uniform refinement; 1 if the solution is smooth.
    error : float
        Of the energy, extrapolated with this rate.
    recommendation : str
    """

    relocation: ErrorReduction | None
    rate: float
    error: float
    recommendation: str

    def rows(self) -> list[tuple[str, str]]:
        """As (label, value) for people."""
        moved = "nothing can be claimed" if self.relocation is None else self.relocation.text()
        return [
            ("error of the energy, extrapolated", figure(self.error)),
            ("rate under uniform refinement", f"N^-{self.rate:.2f}"),
            ("relocation, coarse map only", moved),
            ("recommendation", self.recommendation),
        ]


def advise(problem: ContactProblem, settings: CascadeSettings | Mapping[str, Any] | None = None) -> Advice:
    """Relocate on the coarsest mesh, prolong the map, refine uniformly twice; recommend what to do.

    Costs about the contact solves of two uniform refinements. Move limits are not regarded; over curved
    foundations gaps hold along edges, as in ``auto``.
    """
    chosen = CascadeSettings.of(settings)
    given = replace(with_edge_gaps(problem), motion=replace(problem.motion, delta=None))
    finer = refined(given)
    found = [admissible(grid) for grid in (given, finer, refined(finer))]
    first, second = found[0].energy - found[1].energy, found[1].energy - found[2].energy
    rate = float(np.clip(np.log2(first / second) / 2, *RATES)) if first > 0 and second > 0 else 1.0
    error = max(first / (1 - 4**-rate), 0.0)
    last = cascade(given, replace(chosen, brief=1, brief_unnested=1))
    moved = admissible(given, last.energy.relocation.nodes(last.q), found[0].state.active)
    solves = sum(level.contact_solves for level in last.levels)
    relocation, _ = error_reduction(found[0], moved, solves)
    factor = 1.0 if relocation is None else relocation.factor
    return Advice(relocation, rate, error, recommended(factor, rate))


def recommended(factor: float, rate: float) -> str:
    """What to do, from the least factor of relocation and the rate under uniform refinement."""
    move, refine = factor >= WORTHWHILE, rate < SMOOTH
    if move and refine:
        return "both: relocate (rmesh solve), then refine where the error is (--remesh)"
    if move:
        return "relocate: rmesh solve"
    if refine:
        return "refine locally: relocation alone gains little here"
    return "refine uniformly: the mesh suits the solution already"
