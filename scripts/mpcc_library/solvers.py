"""Solvers of MPCCs: ours, the loop that one writes first, MPECSS and pympcc."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gallery.mpcc_traps import plain_loop
from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc import Problem, solve


@dataclass(frozen=True)
class End:
    """Where a solver stopped, its own word, and iterations of Ipopt if it counts them."""

    x: Array
    status: str
    iterations: int | None = None


def ours(problem: Problem) -> End:
    """`rmesh_nlp.mpcc` by its defaults."""
    result = solve(problem.mpcc, problem.x0, p=problem.p0)
    return End(result.x, result.status.value, result.counts["ipopt_iterations"])


def plain(problem: Problem) -> End:
    """The loop of relaxations that one writes first."""
    return End(*plain_loop(problem.mpcc, problem.x0, problem.p0))


def mpecss(problem: Problem) -> End:
    """MPECSS, given the problem in its own file format."""
    from mpecss.helpers.loaders.macmpec_loader import load_macmpec
    from mpecss.phase_2.mpecss import run_mpecss

    mpcc = problem.mpcc
    data: dict[str, Any] = {"w0": list(map(float, problem.x0))}
    data |= {name: [0.0] * mpcc.n_pairs for name in ("lbG", "lbH")}
    for theirs, values in (("lbw", mpcc.lbx), ("ubw", mpcc.ubx), ("lbg", mpcc.lbg), ("ubg", mpcc.ubg)):
        data[theirs] = [float(b) if np.isfinite(b) else None for b in np.asarray(values)]
    for key in ("f", "g", "G", "H"):
        expression = getattr(mpcc, key)
        if expression.shape[0]:
            data[f"{key}_fun"] = ca.Function(key, [mpcc.x], [expression]).serialize()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{Path(folder).name}.nl.json"  # what it has built is kept by name
        path.write_text(json.dumps(data), encoding="utf-8")
        result = run_mpecss(load_macmpec(str(path)), z0=np.array(problem.x0, dtype=float))
    return End(np.asarray(result["z_final"]), str(result["status"]))


def pympcc(problem: Problem) -> End:
    """The package pympcc with its default strategy and the exact derivatives that CasADi gives."""
    import pympcc as peer

    mpcc = problem.mpcc
    x, g, G, H = mpcc.x, mpcc.g, mpcc.G, mpcc.H
    lower, upper = np.asarray(mpcc.lbg), np.asarray(mpcc.ubg)
    equal = lower == upper
    h = ca.vertcat(*[g[int(i)] - lower[i] for i in np.flatnonzero(equal)], ca.SX(0, 1))
    below = [lower[i] - g[int(i)] for i in np.flatnonzero(~equal & np.isfinite(lower))]
    above = [g[int(i)] - upper[i] for i in np.flatnonzero(~equal & np.isfinite(upper))]
    c = ca.vertcat(*below, *above, ca.SX(0, 1))
    rows = ca.vertcat(c, h, G, H, G * H)
    weights, weight = ca.SX.sym("weights", rows.shape[0]), ca.SX.sym("weight")
    hessian = ca.tril(ca.hessian(weight * mpcc.f + ca.dot(weights, rows), x)[0])
    hessian_at = ca.Function("hessian", [x, weights, weight], [hessian])

    def dense(expression: Any, flat: bool = False) -> Callable[[Array], Array]:
        function = ca.Function("f", [x], [expression])
        return lambda at: function(at).full().ravel() if flat else function(at).full()

    def lagrangian(at: Array, multipliers: Array, factor: float) -> Array:
        padded = np.zeros(rows.shape[0])
        padded[: min(len(multipliers), len(padded))] = multipliers[: len(padded)]
        return np.array(hessian_at(at, padded, factor).nonzeros())

    value = dense(mpcc.f, flat=True)
    derivatives: dict[str, Any] = {
        "gradient": dense(ca.gradient(mpcc.f, x), flat=True),
        "lagrangian_hessian": lagrangian,
        "lagrangian_hessian_sparsity": tuple(np.array(part) for part in hessian.sparsity().get_triplet()),
    }
    for name, column in {"comp_G": G, "comp_H": H, "ineq": c, "eq": h}.items():
        if column.shape[0] or name.startswith("comp"):
            values = name if name.startswith("comp") else f"{name}_constraints"
            derivatives[values] = dense(column, flat=True)
            derivatives[f"{name}_jacobian"] = dense(ca.jacobian(column, x))
    stated = peer.MPCCProblem(
        n=x.shape[0], n_comp=G.shape[0], n_ineq=c.shape[0], n_eq=h.shape[0],
        x0=np.array(problem.x0, dtype=float), objective=lambda at: float(value(at)[0]),
        xl=np.array(mpcc.lbx, dtype=float), xu=np.array(mpcc.ubx, dtype=float), **derivatives,
    )  # fmt: skip
    result = peer.solve(stated)
    return End(np.asarray(result.x), "converged" if result.success else "not converged")


SOLVERS: dict[str, Callable[[Problem], End]] = {
    "rmesh_nlp.mpcc": ours,
    "plain Scholtes loop": plain,
    "MPECSS": mpecss,
    "pympcc": pympcc,
}
NEEDS = {"MPECSS": ("mpecss",), "pympcc": ("pympcc", "cyipopt")}
"""Modules without which a solver is not installed."""
