"""What the labels of stationarity tell apart: five programs, one corner, four labels.

All are programs in x and y (and z) with the pair 0 <= x _|_ y >= 0, looked at where x = y = 0, see
docs/biactive.md. "M, minimum" is Example 3 of Scheel and Scholtes, Math. Oper. Res. 25 (2000). In the C-trap
the relaxations x y <= t have a minimum at x = y = sqrt(t): a plain loop of them ends in the trap, and would
be called converged.

    python scripts/gallery/mpcc_traps.py
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import rmesh_nlp as rm

STEPS = 9
"""Of the plain loop: t = 1, 0.1, ..., 1e-8."""

NEAR = 1e-3
"""Distance up to which a point counts as the corner: relaxed solutions are sqrt(t) = 1e-4 away from it."""

Ends = tuple[rm.mpcc.MPCCResult, np.ndarray, rm.mpcc.MPCCResult]
"""The label of a corner, where the plain loop ends, and the solver that starts in the corner."""


def programs() -> dict[str, rm.MPCC]:
    """The programs by name."""
    x, y, z = (ca.SX.sym(name) for name in "xyz")
    rows = ca.vertcat(z - 4 * x, z - 4 * y)
    both, none = ca.vertcat(x, y), ca.SX(0, 1)
    return {
        "S": rm.MPCC(both, (x + 1) ** 2 + (y + 1) ** 2, none, [x], [y]),
        "M, minimum": rm.MPCC(ca.vertcat(x, y, z), x + y - z, rows, [x], [y], lbg=-np.inf, ubg=0),
        "M, trap": rm.MPCC(both, x**2 + (y - 1) ** 2, none, [x], [y]),
        "C, trap": rm.MPCC(both, 300 * (x - y) ** 2 - (x + y), none, [x], [y]),
        "W, trap": rm.MPCC(both, (x + 1) ** 2 + (y - 1) ** 2, none, [x], [y]),
    }


def plain_loop(program: rm.MPCC, x: Any, parameters: Any = None) -> tuple[np.ndarray, str, int]:
    """One ``nlpsol`` with ``G H <= t``, each solve started from the one before; Ipopt by its defaults.

    Returns where it ended, Ipopt's last word, and its iterations.
    """
    n, t = program.n_pairs, type(program.x).sym("t")
    g = ca.vertcat(program.g, program.G, program.H, program.G * program.H - t)
    nlp = {"x": program.x, "p": ca.vertcat(program.p, t), "f": program.f, "g": g}
    quiet = {"print_time": False, "error_on_fail": False, "show_eval_warnings": False}
    solver = ca.nlpsol("plain", "ipopt", nlp, {"ipopt": {"print_level": 0, "sb": "yes"}, **quiet})
    bounds = {"lbx": program.lbx, "ubx": program.ubx}
    bounds["lbg"] = np.concatenate([program.lbg, np.zeros(2 * n), np.full(n, -np.inf)])
    bounds["ubg"] = np.concatenate([program.ubg, np.full(2 * n, np.inf), np.zeros(n)])
    p = program.parameters(parameters)
    x, iterations = program.start(x, p), 0
    for k in range(STEPS):
        x = solver(x0=x, p=np.append(p, 10.0**-k), **bounds)["x"]
        iterations += int(solver.stats()["iter_count"])
    return x.full().ravel(), str(solver.stats()["return_status"]), iterations


def main() -> dict[str, Ends]:
    """Label the corners, solve from there, and print a line each."""
    found: dict[str, Ends] = {}
    for name, program in programs().items():
        n = program.x.shape[0]
        corner, (plain, _, _) = rm.mpcc.classify(program, np.zeros(n)), plain_loop(program, np.full(n, 0.5))
        found[name] = corner, plain, rm.solve_mpcc(program, np.zeros(n))
        label = f"{corner.stationarity}, {'B' if corner.b_stationary else 'not B'}"
        trapped, end = ", trapped" * is_trapped(found[name]), found[name][2]
        print(f"{name}: {label}; plain loop {plain[:2].round(4)}{trapped}; ", end="")
        print(f"solver from the corner {end.x[:2].round(4)} {end.label}")
    return found


def is_trapped(ends: Ends) -> bool:
    """Whether the plain loop ended in a corner that is no minimum."""
    corner, plain, _ = ends
    return bool(np.max(np.abs(plain)) < NEAR) and not corner.b_stationary


if __name__ == "__main__":
    main()
