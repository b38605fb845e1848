"""What one writes first: a loop of ``nlpsol`` calls over Scholtes' relaxation. A yardstick."""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array, flat
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import residuals

_SOLVED = 1e-6


@dataclass(frozen=True, eq=False)
class PlainResult:
    """End of the loop.

    Attributes
    ----------
    x, f : array, float
    success : bool
        The last NLP converged, and violation and products ``G H`` are at most 1e-6.
    status : str
        Ipopt's word for the last NLP.
    constraint_violation, complementarity, product : float
    iterations : int
    seconds : float
    """

    x: Array
    f: float
    success: bool
    status: str
    constraint_violation: float
    complementarity: float
    product: float
    iterations: int
    seconds: float


def plain_loop(
    mpcc: MPCC,
    x0: ArrayLike,
    p: ArrayLike = (),
    *,
    steps: int = 9,
    time_limit_s: float = np.inf,
    start_time: float | None = None,
) -> PlainResult:
    """Solve with ``G H <= t``, t = 1, 0.1, ... in ``steps`` steps, each from the solution before.

    Ipopt has its default options; nothing else is done. The time includes building the solver.
    """
    began = time.perf_counter() if start_time is None else start_time
    n = mpcc.n_pairs
    t = type(mpcc.x).sym("t")
    nlp = {
        "x": mpcc.x,
        "p": ca.vertcat(mpcc.p, t),
        "f": mpcc.f,
        "g": ca.vertcat(mpcc.g, mpcc.G, mpcc.H, mpcc.G * mpcc.H - t),
    }
    quiet = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False}
    ipopt: dict[str, object] = {"print_level": 0, "sb": "yes"}
    if np.isfinite(time_limit_s):
        ipopt["max_wall_time"] = time_limit_s
    solver = ca.nlpsol("plain", "ipopt", nlp, {"ipopt": ipopt, **quiet})
    lower = np.concatenate([np.asarray(mpcc.lbg), np.zeros(2 * n), np.full(n, -np.inf)])
    upper = np.concatenate([np.asarray(mpcc.ubg), np.full(2 * n, np.inf), np.zeros(n)])
    parameters = mpcc.parameters(p)
    x, iterations = mpcc.start(x0, parameters), 0
    answer: dict[str, ca.DM] = {}
    for k in range(steps):
        answer = solver(
            x0=x, p=np.append(parameters, 10.0**-k), lbx=mpcc.lbx, ubx=mpcc.ubx, lbg=lower, ubg=upper
        )
        x = flat(answer["x"])
        iterations += int(solver.stats().get("iter_count", 0))
        if time.perf_counter() - began > time_limit_s:
            break
    g, G, H = np.split(flat(answer["g"])[: mpcc.n_g + 2 * n], [mpcc.n_g, mpcc.n_g + n])
    res = residuals(mpcc, x, g, G, H)
    stats = solver.stats()
    fine = max(res.constraint_violation, res.product) <= _SOLVED and np.isfinite(float(answer["f"]))
    success = bool(stats["success"] and fine and k == steps - 1)
    return PlainResult(
        x, float(answer["f"]), success, str(stats["return_status"]), res.constraint_violation,
        res.complementarity, res.product, iterations, time.perf_counter() - began,
    )  # fmt: skip
