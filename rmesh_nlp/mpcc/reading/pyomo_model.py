"""Pyomo models with ``pyomo.mpec`` complementarity blocks.

The members of every condition are written as ordinary rows into a ``.nl`` file of a copy of the model, and
paired again when it is read: Pyomo's own writer leaves mixed pairs out.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.reading.nl import read_rows
from rmesh_nlp.mpcc.reading.problem import Problem

_BLOCK = "rmesh_nlp_mpcc_rows"


def read_pyomo(model: Any) -> Problem:
    """Read a concrete Pyomo model; it is not changed.

    Raises
    ------
    ImportError
        If Pyomo is not installed.
    ValueError
        If a condition is no pair of expressions, or the model has integer variables.
    """
    import pyomo.environ as pe
    from pyomo.core.expr import RelationalExpression
    from pyomo.mpec import Complementarity

    copy = model.clone()
    rows = pe.Block(concrete=True)
    copy.add_component(_BLOCK, rows)
    pairs: list[tuple[str, str]] = []
    for condition in list(copy.component_data_objects(Complementarity, active=True, descend_into=True)):
        names = []
        for side, member in enumerate(_members(condition)):
            name = f"pair{len(pairs)}_{side}"
            if isinstance(member, RelationalExpression):
                rows.add_component(name, pe.Constraint(expr=member))
            else:  # a bare expression: free, and equal to a new variable
                free = pe.Var(initialize=0.0)
                rows.add_component(f"{name}_value", free)
                rows.add_component(f"{name}_is", pe.Constraint(expr=free == member))
            names.append(f"{_BLOCK}.{name}")
        pairs.append((names[0], names[1]))
        condition.deactivate()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.nl"
        options = {
            "symbolic_solver_labels": True,
            "linear_presolve": False,
            "skip_trivial_constraints": False,
        }
        copy.write(str(path), format="nl", io_options=options)
        read = read_rows(path)
        row_names = path.with_suffix(".row").read_text().split("\n")
        column_names = path.with_suffix(".col").read_text().split("\n")
    row = {name: i for i, name in enumerate(row_names)}
    column = {name: i for i, name in enumerate(column_names)}
    members: list[list[Any]] = [[], []]
    bounds: list[list[float]] = [[], [], [], []]
    for pair in pairs:
        for side, name in enumerate(pair):
            if name in row:
                i = row[name]
                body, lower, upper = read.bodies[i], read.lower[i], read.upper[i]
            else:
                body, lower, upper = read.x[column[f"{name}_value"]], -np.inf, np.inf
            members[side].append(body)
            bounds[2 * side].append(float(lower))
            bounds[2 * side + 1].append(float(upper))
    paired = {row[name] for pair in pairs for name in pair if name in row}
    kept = [i for i in range(len(read.bodies)) if i not in paired]
    sign = -1.0 if read.maximise else 1.0
    mpcc = MPCC.mixed(
        read.x, sign * read.f, [read.bodies[i] for i in kept] or None, members[0], members[1],
        lbG=bounds[0], ubG=bounds[1], lbH=bounds[2], ubH=bounds[3], lbx=read.lbx, ubx=read.ubx,
        lbg=read.lower[kept], ubg=read.upper[kept],
    )  # fmt: skip
    return Problem(str(model.name), mpcc, read.x0, sign=sign)


def _members(condition: Any) -> tuple[Any, Any]:
    """The two sides of a condition; a tuple or a relation stands for itself."""
    sides = getattr(condition, "_args", None)
    if sides is None or len(sides) != 2:
        raise ValueError(f"the condition {condition.name} is not a pair")
    return sides[0], sides[1]
