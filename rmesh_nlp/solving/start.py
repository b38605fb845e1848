"""Where a solve starts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.evaluation import Array
from rmesh_nlp.solving.formulation import GIVEN, first
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.relocated import Relocated

Start = str | Array | Relocated | None
"""Node positions (2, nodes), "given", the name of a formulation, a Solution; None for the usual start."""


def beginning(outer: Outer, start: Start, seed: int | None, monitor: Monitor) -> tuple[Outer, Array, str]:
    """The outer problem, told whether the start is near a minimiser, admissible outer variables, and a name.

    None is the mesh as given, or with a seed random outer variables. The name of a formulation runs it first,
    from where ``seed`` says; its time and contact solves count. The name for the record is "given", "random",
    "positions", that of a formulation, or "solution of" it.
    """
    if start is None and seed is not None:
        return outer, outer.variables(seed=seed), "random"
    if (before := first(start)) is not None:
        outcome = monitor.run(before, outer, outer.variables(seed=seed))
        return outer.near(), outcome.q, before.name
    if start is None or isinstance(start, str):
        return outer, outer.variables(), GIVEN
    if isinstance(start, Relocated):
        q = outer.variables(positions(outer, start.mesh.p), design=start.design)
        with monitor.budget.during("build"):
            return outer.near(), q, f"solution of {start.formulation}"
    return outer, outer.variables(positions(outer, start)), "positions"


def positions(outer: Outer, nodes: ArrayLike) -> Array:
    """Node positions as an array, checked to be those of the problem's mesh."""
    wanted = outer.problem.mesh.p.shape
    try:
        positions_of = np.asarray(nodes, dtype=float)
    except (TypeError, ValueError):
        said = f"got {one_line(repr(nodes))[:60]}"
        raise BadInputError(f"start must be a name, positions (2, nodes) or a Solution, {said}") from None
    if positions_of.ndim != 2 or positions_of.shape[0] != 2:
        raise BadInputError(
            f"start must hold positions (2, nodes), got an array of shape {positions_of.shape}"
        )
    if positions_of.shape != wanted:
        raise BadInputError(f"the start has {positions_of.shape[1]} nodes, the problem {wanted[1]}")
    if (lost := np.argwhere(~np.isfinite(positions_of))).size:
        raise BadInputError(f"start: node {int(lost[0][1])} has no finite position")
    return positions_of
