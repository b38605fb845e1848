"""Assessments whose figures a test chooses: by default those of a success in every respect."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import rmesh_nlp as rm
from rmesh_nlp.assessment.measures import EXPLOITS, ContactResiduals
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.state import State
from support.endings import ended

HOLDS, BROKEN = ContactResiduals(1e-9, 1e-9), ContactResiduals(1e-2, 1e-2)


@cache
def unmoved() -> Assessment:
    """The mesh as given, assessed."""
    outer = rm.Outer.of(rm.EXAMPLES["6.2"]((4, 2)))
    return ended(outer, np.zeros(outer.n))


def with_energies(state: State, energy: float, audited: float, **changes: Any) -> State:
    """A state with other energies, by the problem's own rules and of the continuous problem."""
    equilibrium = replace(state.equilibrium, energy=energy)
    return replace(
        state, equilibrium=equilibrium, continuous=replace(state.continuous, energy=audited), **changes
    )


def compared(
    said: rm.Status = rm.Status.CONVERGED,
    *,
    gain: float = 0.1,
    gain_audited: float = 0.1,
    audited_above: float = 0.0,
    decrease: float = 0.1,
    size: float = 1.0,
    is_energy: bool = True,
    stationary: bool = True,
    contact: rm.Status = rm.Status.CONVERGED,
    min_area_ratio: float = 0.5,
    residuals: ContactResiduals = HOLDS,
    own: ContactResiduals = HOLDS,
    corrections: Mapping[str, float] | None = None,
) -> Assessment:
    """An assessment with these figures; ``audited_above``: the audited less the own energy at the end."""
    found, zero = unmoved(), dict.fromkeys(EXPLOITS, 0.0)
    given = with_energies(
        found.given,
        gain,
        audited_above + gain_audited,
        objective_audited=decrease,
        size=size,
        violation=0.0,
        corrections=zero,
    )
    final = with_energies(
        found.final,
        0.0,
        audited_above,
        objective_audited=0.0,
        size=size,
        violation=0.0,
        corrections=corrections or zero,
        residuals=residuals,
        min_area_ratio=min_area_ratio,
    )
    final = replace(final, equilibrium=replace(final.equilibrium, status=contact))
    return replace(
        found,
        given=given,
        final=final,
        solver_status=said,
        own_residuals=own,
        objective=parse_objective("energy" if is_energy else "mean(top, -uy)"),
        first_order=replace(found.first_order, is_stationary=stationary),
    )
