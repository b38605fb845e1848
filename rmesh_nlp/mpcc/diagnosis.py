"""What is wrong at a point, in words that name the unknowns: values that are not finite, large residuals."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, flat
from rmesh_nlp.mpcc.names import in_short, named
from rmesh_nlp.mpcc.problem import MPCC

_FEW = 4  # unknowns that are named


def where_not_finite(mpcc: MPCC, x: Array, p: Array) -> str:
    """The first function that is NaN or infinite at ``x``, with its unknowns, else the first such derivative.

    Nothing if all are finite. With assembled derivatives only functions are looked at.
    """
    oracle = ca.Function("oracle", [mpcc.x, mpcc.p], [ca.vertcat(mpcc.f, mpcc.g, mpcc.G, mpcc.H)])
    rows = ["f", *(f"{part}[{i}]" for part in "gGH" for i in range(getattr(mpcc, part).shape[0]))]
    values = flat(oracle(x, p))
    bad = np.flatnonzero(~np.isfinite(values))
    if mpcc.derivatives is not None:  # of a model whose expressions are long
        return f"{rows[bad[0]]} is {values[bad[0]]}." if bad.size else ""
    if bad.size:
        row = int(bad[0])
        row_of, column_of = (np.asarray(part) for part in oracle.jac_sparsity(0, 0).get_triplet())
        unknowns = column_of[row_of == row]
        at = ", ".join(f"{named(mpcc.x, int(j))} = {x[j]:g}" for j in unknowns[:_FEW])
        return f"{rows[row]} is {values[row]} at {at}{', ...' if unknowns.size > _FEW else ''}."
    jacobian = oracle.jacobian()(x, p, 0)[0]
    nonzeros, triplet = np.array(jacobian.nonzeros()), jacobian.sparsity().get_triplet()
    bad = np.flatnonzero(~np.isfinite(nonzeros))
    if bad.size:
        row, j = (part[bad[0]] for part in triplet)
        return f"The derivative of {rows[row]} is {nonzeros[bad[0]]} at {named(mpcc.x, j)} = {x[j]:g}."
    return ""


def largest_residual(mpcc: MPCC, x: Array, g: Array, G: Array, H: Array) -> str:
    """The constraint or pair that is farthest from holding, with its residual; nothing if all hold."""
    lbx, ubx, lbg, ubg = (np.asarray(bound) for bound in (mpcc.lbx, mpcc.ubx, mpcc.lbg, mpcc.ubg))
    pairs = np.max([-G, -H, np.minimum(np.abs(G), np.abs(H))], axis=0)
    apart = [np.maximum(lbx - x, x - ubx), np.maximum(lbg - g, g - ubg), pairs]
    kind = int(np.argmax([np.max(part, initial=0.0) for part in apart]))
    if np.max(apart[kind], initial=0.0) <= 0.0:
        return ""
    i = int(np.argmax(apart[kind]))
    if kind == 0:
        place = f"the bounds of {named(mpcc.x, i)}"
    elif kind == 1:
        place = f"g[{i}], {in_short(mpcc.g[i])}"
    else:
        place = f"pair {i}, between {in_short(mpcc.G[i])} and {in_short(mpcc.H[i])}"
    return f"The largest residual, {apart[kind][i]:.1e}, is in {place}."
