"""AMPL's ``.sol`` files, which AMPL, Pyomo and JuMP read after a solve.

A file has a message, the numbers of the first line of the ``.nl`` file, four counts, a dual value for each
row, a value for each unknown, and ``objno 0 CODE`` (D. M. Gay, Hooking your solver to AMPL, 2017; ASL's
``writesol.c``). CODE says how the solve ended, in hundreds: solved, solved with a doubt, infeasible,
unbounded, a limit, a failure.

The dual of a row is the derivative of the objective with respect to its right-hand side, for minima and
maxima alike: non-negative for an active ``>=`` of a minimum. The same derivative with respect to the bounds
of an unknown stands in the suffixes ``ipopt_zL_out`` and ``ipopt_zU_out``, whose names JuMP and Pyomo know
from Ipopt. A complementarity row and the bound of its unknown have the multipliers of the pair. Then

    gradient of f = sum of dual_i times gradient of row_i + zL + zU.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rmesh_nlp import __version__
from rmesh_nlp.evaluation import Array, is_finite
from rmesh_nlp.mpcc.nl import Rows
from rmesh_nlp.mpcc.reading import Problem, rows_of
from rmesh_nlp.mpcc.result import MPCCResult
from rmesh_nlp.optimize.status import Status

_CODES = {
    Status.CONVERGED: 0, Status.ACCEPTABLE: 100, Status.INFEASIBLE: 200, Status.UNBOUNDED: 300,
    Status.ITERATION_LIMIT: 400, Status.TIME_LIMIT: 401, Status.INTERRUPTED: 402,
    Status.EVALUATION_ERROR: 501, Status.STALLED: 502, Status.INACCURATE: 503,
}  # fmt: skip
_OPTIONS = ("3", "1", "1", "0")  # where the .nl file has none


def solve_code(status: Status) -> int:
    """AMPL's ``solve_result_num``; 500 for a failure that has no number of its own."""
    return _CODES.get(status, 500)


def message(problem: Problem, result: MPCCResult) -> str:
    """What AMPL shows after a solve."""
    counts, seconds = result.counts, result.seconds["total"]
    return (
        f"rmesh-mpcc {__version__}: {result.message}\n"
        f"objective {problem.sign * result.f:.12g}, stationarity {result.label}\n"
        f"violation {result.constraint_violation:.1e}, min(G, H) {result.complementarity:.1e}; "
        f"{counts['ipopt_iterations']} iterations in {counts['nlp_solves']} NLPs, {seconds:.2f} s"
    )


def write_sol(path: Path, problem: Problem, result: MPCCResult) -> None:
    """Write the ``.sol`` file of a problem that was read from a ``.nl`` file, whole or not at all."""
    rows = problem.rows
    if rows is None:
        raise ValueError(f"{problem.name} was not read from an .nl file: there is no .sol file of it")
    x = result.x[: rows.x.shape[0]]
    duals, reduced = _duals(rows, result)
    lines = [
        message(problem, result),
        "",
        *_options(rows, duals.size),
        *map(repr, (*duals.tolist(), *x.tolist())),
    ]
    lines += [f"objno 0 {solve_code(result.status)}", *_bound_suffixes(rows, x, reduced), ""]
    try:
        path.write_text("\n".join(lines), encoding="utf-8")
    except OSError as error:
        if path.is_file():
            path.unlink()
        raise OSError(error.errno, error.strerror, str(path)) from error


def _duals(rows: Rows, result: MPCCResult) -> tuple[Array, Array]:
    """The dual of each row and the reduced cost of each unknown; none where there are no multipliers."""
    multipliers = np.concatenate([result.lam_g, result.lam_G, result.lam_H])
    n, m = rows.x.shape[0], len(rows.bodies)
    if not (is_finite(multipliers) and is_finite(result.lam_x)):
        return np.zeros(0), np.zeros(n)
    duals = rows_of(rows)[1].T @ multipliers
    return -rows.sign * duals[:m], -rows.sign * (duals[m : m + n] + result.lam_x[:n])


def _options(rows: Rows, n_duals: int) -> list[str]:
    """The section ``Options``: as in the ``.nl`` file, then the counts of rows, duals, unknowns, values."""
    options = list(rows.options if rows.options[0] not in ("", "0") else _OPTIONS)
    k = int(options[0])
    tolerance = options[k + 1 : k + 2] if options[2:3] == ["3"] else []  # of basic variables
    if tolerance:
        options[0] = str(k + 2)
    n = rows.x.shape[0]
    counts = [len(rows.bodies), n_duals, n, n]
    return ["Options", *options[: k + 1], *map(str, counts), *tolerance]


def _bound_suffixes(rows: Rows, x: Array, reduced: Array) -> list[str]:
    """Reduced costs as suffixes of the unknowns, each at the bound that is nearer."""
    lower = np.isfinite(rows.lbx) & ~(rows.ubx - x < x - rows.lbx)
    lines: list[str] = []
    for name, bound in (("ipopt_zL_out", lower), ("ipopt_zU_out", ~lower)):
        places = np.flatnonzero(bound & (reduced != 0.0))
        lines += [f"suffix 4 {places.size} {len(name) + 1} 0 0", name]
        lines += [f"{j} {float(reduced[j])!r}" for j in places]
    return lines
