"""Solvers of MPCCs: ours, a plain loop, MPECSS and pympcc."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from benchmark_mpcc import as_mpcc, plain_loop_result

from rmesh_nlp import mpcc
from rmesh_nlp.evaluation import Array


def ours_mpcc(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """Our MPCC solver."""
    result = mpcc.solve(as_mpcc(problem), problem["x0"])
    return result.x, result.status.value


def scholtes_loop(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """The plain loop of ``benchmark_mpcc.py``."""
    answer = plain_loop_result(problem)
    return answer["x"].full().ravel(), "ended"


def mpecss(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """MPECSS, given the problem in its own file format."""
    from mpecss.helpers.loaders.macmpec_loader import load_macmpec
    from mpecss.phase_2.mpecss import run_mpecss

    def bounds(key: str) -> list[float | None]:
        return [float(b) if np.isfinite(b) else None for b in problem[key]]

    n = int(problem["G"].shape[0])
    data: dict[str, Any] = {"w0": list(map(float, problem["x0"])), "lbG": [0.0] * n, "lbH": [0.0] * n}
    data |= {"lbw": bounds("lbx"), "ubw": bounds("ubx"), "lbg": bounds("lbg"), "ubg": bounds("ubg")}
    for key in ("f", "g", "G", "H"):
        if problem[key].shape[0]:
            data[f"{key}_fun"] = ca.Function(key, [problem["x"]], [problem[key]]).serialize()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{Path(folder).name}.nl.json"  # what it has built is kept by name
        path.write_text(json.dumps(data), encoding="utf-8")
        result = run_mpecss(load_macmpec(str(path)), z0=np.array(problem["x0"], dtype=float))
    return np.asarray(result["z_final"]), str(result["status"])


def pympcc(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """The package pympcc with its default strategy and the exact derivatives that CasADi gives."""
    import pympcc as peer

    x, g, G, H = problem["x"], problem["g"], problem["G"], problem["H"]
    lower, upper = (np.asarray(problem[key], dtype=float) for key in ("lbg", "ubg"))
    equal = lower == upper
    h = ca.vertcat(*[g[int(i)] - lower[i] for i in np.flatnonzero(equal)], ca.SX(0, 1))
    below = [lower[i] - g[int(i)] for i in np.flatnonzero(~equal & np.isfinite(lower))]
    above = [g[int(i)] - upper[i] for i in np.flatnonzero(~equal & np.isfinite(upper))]
    c = ca.vertcat(*below, *above, ca.SX(0, 1))
    rows = ca.vertcat(c, h, G, H, G * H)
    weights, weight = ca.SX.sym("weights", rows.shape[0]), ca.SX.sym("weight")
    hessian = ca.tril(ca.hessian(weight * problem["f"] + ca.dot(weights, rows), x)[0])
    hessian_at = ca.Function("hessian", [x, weights, weight], [hessian])

    def dense(expression: Any) -> Callable[[Array], Array]:
        function = ca.Function("f", [x], [expression])
        return lambda at: function(at).full()

    def column(expression: Any) -> Callable[[Array], Array]:
        function = dense(expression)
        return lambda at: function(at).ravel()

    def lagrangian(at: Array, multipliers: Array, factor: float) -> Array:
        padded = np.zeros(rows.shape[0])
        padded[: min(len(multipliers), len(padded))] = multipliers[: len(padded)]
        return np.array(hessian_at(at, padded, factor).nonzeros())

    value = column(problem["f"])
    derivatives = {
        "gradient": column(ca.gradient(problem["f"], x)),
        "comp_G": column(G),
        "comp_G_jacobian": dense(ca.jacobian(G, x)),
        "comp_H": column(H),
        "comp_H_jacobian": dense(ca.jacobian(H, x)),
        "lagrangian_hessian": lagrangian,
        "lagrangian_hessian_sparsity": tuple(np.array(part) for part in hessian.sparsity().get_triplet()),
    }
    if c.shape[0]:
        derivatives |= {"ineq_constraints": column(c), "ineq_jacobian": dense(ca.jacobian(c, x))}
    if h.shape[0]:
        derivatives |= {"eq_constraints": column(h), "eq_jacobian": dense(ca.jacobian(h, x))}
    stated = peer.MPCCProblem(
        n=x.shape[0],
        n_comp=G.shape[0],
        x0=np.array(problem["x0"], dtype=float),
        objective=lambda at: float(value(at)[0]),
        xl=np.array(problem["lbx"], dtype=float),
        xu=np.array(problem["ubx"], dtype=float),
        n_ineq=c.shape[0],
        n_eq=h.shape[0],
        **derivatives,
    )
    result = peer.solve(stated)
    return np.asarray(result.x), "converged" if result.success else "not converged"
