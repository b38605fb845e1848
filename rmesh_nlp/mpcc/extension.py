"""More unknowns, rows and pairs for an MPCC whose derivatives are assembled: what was there keeps them."""

from __future__ import annotations

import itertools
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.optimize.nlp import NLP, Derivatives


def extended_derivatives(
    nlp: NLP, new_x: Any, new_p: Any, f: Any, rows: tuple[Any, Any, Any], sizes: tuple[int, int]
) -> Derivatives | None:
    """Derivatives of the objective plus ``f`` and of ``(g, g', G, G', H, H')``.

    Parameters
    ----------
    nlp : NLP
        The oracle as it was, its constraint column ``(g, G, H)``.
    new_x, new_p : symbols
    f : expression
    rows : tuple of columns
        What is appended to g, G and H.
    sizes : (n_g, n_pairs)
        Lengths as they were.
    """
    longer = nlp.extended(x=new_x, p=new_p, f=f, g=ca.vertcat(*rows)).derivatives
    if longer is None:
        return None
    n_g, n_pairs = sizes
    ends = np.cumsum([0, n_g, n_pairs, n_pairs, *(int(part.shape[0]) for part in rows)])
    parts = [list(range(a, b)) for a, b in itertools.pairwise(ends)]
    order = parts[0] + parts[3] + parts[1] + parts[4] + parts[2] + parts[5]
    back = np.argsort(order).tolist()
    x = ca.MX.sym("x", longer.grad_f.numel_in(0))
    p = ca.MX.sym("p", longer.grad_f.numel_in(1))
    g, jacobian = longer.jac_g(x, p)
    hess_lag = None
    if longer.hess_lag is not None:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(order))
        hess_lag = ca.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [longer.hess_lag(x, p, lam_f, lam_g[back])]
        )
    return Derivatives(
        grad_f=longer.grad_f,
        jac_g=ca.Function("nlp_jac_g", [x, p], [g[order], jacobian[order, :]]),
        hess_lag=hess_lag,
        kernels=longer.kernels,
    )
