"""Reduced energies of small problems with every kind of contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import gain_estimate, regularised
from rmesh_nlp.problem import ContactProblem
from support.contact_geometry import block_sliding_on_a_circle
from support.problems import no_move_limits, sloped_block

CONTACTS: dict[str, Callable[[], ContactProblem]] = {
    "6.1": lambda: EXAMPLES["6.1"](4),
    "6.2": lambda: EXAMPLES["6.2"]((6, 4)),
    "6.3": lambda: EXAMPLES["6.3"]((6, 4)),
    "sloped, stick and slip": sloped_block,
    "curved foundation, stick and slip": block_sliding_on_a_circle,
}
FREE: dict[str, Callable[[], ContactProblem]] = {
    "6.1": lambda: replace(no_move_limits(EXAMPLES["6.1"](n=4)), quadrature=4),
    "6.3": lambda: no_move_limits(EXAMPLES["6.3"]((6, 3))),
    "sloped, stick and slip": lambda: no_move_limits(sloped_block()),
}
"""Without move limits."""


def reduced(problem: ContactProblem, objective: str = "energy") -> ReducedEnergy:
    """The energy with terms in the positions, as a function of the outer variables."""
    return ReducedEnergy.of(ContactSolver(problem), parse_objective(objective))


def with_distortion(problem: ContactProblem, weight: float = 0.01) -> ReducedEnergy:
    """The energy with a distortion, weighted relative to what is to be gained."""
    objective = regularised(gain_estimate(problem).value, weight)
    return ReducedEnergy.of(ContactSolver(problem), objective)
