"""Where a function or a derivative is not finite, in words that name the unknowns."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.names import named
from rmesh_nlp.mpcc.problem import MPCC

_FEW = 4  # unknowns that are named


def where_not_finite(mpcc: MPCC, x: Array, p: Array) -> str:
    """The first function that is NaN or infinite at ``x``, with its unknowns, else the first such derivative.

    Nothing if all are finite.
    """
    oracle = ca.Function("oracle", [mpcc.x, mpcc.p], [ca.vertcat(mpcc.f, mpcc.g, mpcc.G, mpcc.H)])
    rows = ["f", *(f"{part}[{i}]" for part in "gGH" for i in range(getattr(mpcc, part).shape[0]))]
    values = np.asarray(oracle(x, p)).ravel()
    row_of, column_of = (np.asarray(part) for part in oracle.jac_sparsity(0, 0).get_triplet())
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        row = int(bad[0])
        unknowns = column_of[row_of == row]
        at = ", ".join(f"{named(mpcc.x, int(j))} = {x[j]:g}" for j in unknowns[:_FEW])
        return f"{rows[row]} is {values[row]} at {at}{', ...' if unknowns.size > _FEW else ''}"
    if mpcc.derivatives is not None:
        return ""
    nonzeros = np.asarray(oracle.jacobian()(x, p, 0)[0].nonzeros())
    bad = np.flatnonzero(~np.isfinite(nonzeros))
    if bad.size:
        row, j = int(row_of[bad[0]]), int(column_of[bad[0]])
        return f"the derivative of {rows[row]} is {nonzeros[bad[0]]} at {named(mpcc.x, j)} = {x[j]:g}"
    return ""
