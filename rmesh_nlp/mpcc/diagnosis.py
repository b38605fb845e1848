"""What is wrong at a point, in words that name the unknowns: values that are not finite, large residuals."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, flat, is_finite
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.names import FEW, in_short, named
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import beyond


def where_not_finite(lifted: Lifted, x: Array, p: Array) -> str:
    """The first function that is NaN or infinite at ``x``, with its unknowns, else the first such derivative.

    Nothing if all are finite.
    """
    mpcc, base = lifted.source, lifted.base
    f, gradient = base.grad_f(x, p)
    column, jacobian = base.jac_g(x, p)
    places = ["f", *(f"{part}[{i}]" for part in "gGH" for i in range(getattr(mpcc, part).shape[0]))]
    values, derivatives = flat(ca.vertcat(f, column)), ca.vertcat(gradient.T, jacobian)
    rows, columns = (np.asarray(part) for part in derivatives.sparsity().get_triplet())
    slopes = np.asarray(derivatives.nonzeros())
    if not is_finite(values):
        row = int(np.argmin(np.isfinite(values)))
        unknowns = columns[(rows == row) & (slopes != 0)]
        at = ", ".join(f"{named(mpcc.x, int(j))} = {x[j]:g}" for j in unknowns[:FEW])
        return f"{places[row]} is {values[row]} at {at}{', ...' if unknowns.size > FEW else ''}."
    if not is_finite(slopes):
        k = int(np.argmin(np.isfinite(slopes)))
        j = int(columns[k])
        return f"The derivative of {places[rows[k]]} is {slopes[k]} at {named(mpcc.x, j)} = {x[j]:g}."
    return ""


@np.errstate(invalid="ignore")
def largest_residual(mpcc: MPCC, x: Array, g: Array, G: Array, H: Array) -> str:
    """The constraint or pair that is farthest from holding, with its residual; nothing if all hold."""
    pairs = np.max([-G, -H, np.minimum(np.abs(G), np.abs(H))], axis=0)
    apart = [beyond(x, mpcc.lbx, mpcc.ubx), beyond(g, mpcc.lbg, mpcc.ubg), pairs]
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
