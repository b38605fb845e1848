"""The solver as a CasADi Function, with the conventions of ``nlpsol``.

>>> import casadi as ca
>>> x = ca.SX.sym("x", 2)
>>> solver = mpccsol("solver", "scholtes", {"x": x, "f": ca.sumsqr(x - 1), "G": x[0], "H": x[1]})
>>> answer = solver(x0=[0.5, 0.2])
>>> float(answer["f"])
1.0
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.errors import unknown
from rmesh_nlp.evaluation import Array, flat
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import Duals, MPCCResult
from rmesh_nlp.mpcc.solver import MPCCSolver
from rmesh_nlp.optimize.callbacks import PythonFunction
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import ByName, Values

_COLUMNS = ["f", "g", "G", "H"]
_KEYS = ("x", *_COLUMNS, "p")
_OF_PAIRS = ("lbG", "ubG", "lbH", "ubH", "switches")
_BOUNDS = {"lbx": -np.inf, "ubx": np.inf, "lbg": -np.inf, "ubg": np.inf}
_INPUTS = (*ca.nlpsol_in(), "lam_G0", "lam_H0")
_OUTPUTS = (*ca.nlpsol_out(), "G", "H", "lam_G", "lam_H")
_STATS = (
    "success", "message", "stationarity", "b_stationary", "n_biactive", "constraint_violation",
    "complementarity", "curvature",
)  # fmt: skip
_UNIFIED = {
    Status.CONVERGED: "SUCCESS", Status.ACCEPTABLE: "SUCCESS", Status.INFEASIBLE: "INFEASIBLE",
    Status.ITERATION_LIMIT: "LIMITED", Status.TIME_LIMIT: "LIMITED", Status.EVALUATION_ERROR: "NAN",
}  # fmt: skip
_OF_FUNCTIONS = (
    "enable_fd", "enable_forward", "enable_reverse", "fd_method", "fd_options",
    "verbose", "print_in", "print_out",
)  # fmt: skip
"""Options of any CasADi Function."""
_KEPT = 8  # solvers with bounds of their own

_alive: dict[int, ca.Callback] = {}
"""Callbacks in expressions: CasADi does not own them, and they must live as long as the expression."""


class MPCCFunction(ca.Function):
    """What :func:`mpccsol` returns: a CasADi Function with the inputs and outputs of ``nlpsol``, and more.

    More inputs are ``lam_G0`` and ``lam_H0``, more outputs ``G``, ``H``, ``lam_G``, ``lam_H``.
    Multipliers have CasADi's signs, ``lam_p`` is minus the derivative of the optimal value; all are NaN where
    there are none. Arguments that are MX give MX. A Function made of this one by ``map`` needs it alive.
    """

    def __init__(self, name: str, solve: _Solve) -> None:
        inputs = [ca.MX.sym(key, solve.sizes[key]) for key in _INPUTS]
        defaults = [_BOUNDS.get(key, 0.0) for key in _INPUTS]
        outputs = solve.call(inputs)
        super().__init__(ca.Function(name, inputs, outputs, _INPUTS, _OUTPUTS, {"default_in": defaults}))
        self._solve = solve

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Solve; by place or by name, numbers or MX, as nlpsol.

        Raises
        ------
        ValueError
            If a number is not finite, or bounds leave no value.
        RuntimeError
            If CasADi refuses the arguments, or with ``error_on_fail`` if the solve did not succeed.
        """
        solve = self._solve
        solve.error, solve.is_called = None, True
        try:
            answer = super().__call__(*arguments, **keywords)
        finally:
            solve.is_called = False
        if solve.error is not None:
            raise solve.error
        if isinstance(next(iter(answer.values() if isinstance(answer, dict) else answer)), ca.MX):
            _alive[id(solve)] = solve
        return answer

    def stats(self) -> Values:
        """Status, label, residuals and counts of the last solve; with the keys of nlpsol that apply."""
        result = self._solve.result
        if result is None:
            raise RuntimeError(f"{self.name()} has not been called yet")
        unified = _UNIFIED.get(result.status, "UNKNOWN")
        return {name: getattr(result, name) for name in _STATS} | {
            "return_status": result.status.value, "unified_return_status": f"SOLVER_RET_{unified}",
            "iter_count": result.counts["ipopt_iterations"], "n_nlp": result.counts["nlp_solves"],
            "t_wall_total": result.seconds["total"],
        }  # fmt: skip


class _Solve(PythonFunction):
    """The solver as a callback on numbers."""

    def __init__(
        self, name: str, mpcc: MPCC, n_g: int, options: Options, error_on_fail: bool, own: Values
    ) -> None:
        self._mpcc, self._name, self._options, self._error_on_fail = mpcc, name, options, error_on_fail
        sums = {"gamma": _COLUMNS}
        weights = [f"lam:{column}" for column in _COLUMNS]
        self._slope = mpcc.oracle.factory("slope", ["x", "p", *weights], ["grad:gamma:p"], sums)
        self._solver = lru_cache(_KEPT)(self._made)
        self.result: MPCCResult | None = None
        self.error: BaseException | None = None
        self.is_called = False  # by a user with numbers, who is shown the error itself
        # unknowns and rows that split pairs come after the user's, who does not see them
        sizes = {part: getattr(mpcc, part).shape[0] for part in _KEYS} | {"x": mpcc.n_own, "g": n_g}
        self.sizes = {
            name.format(part): sizes[part]
            for part in _KEYS
            for name in ("{}", "{}0", "lb{}", "ub{}", "lam_{}", "lam_{}0")
        }
        inputs, outputs = (
            [ca.Sparsity.dense(self.sizes[key], 1) for key in keys] for keys in (_INPUTS, _OUTPUTS)
        )
        super().__init__(f"{name}_solve", inputs, outputs, own)

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        """Solve for numbers."""
        given = {name: flat(value) for name, value in zip(_INPUTS, arguments, strict=True)}
        try:
            return [ca.DM(value) for value in self._answers(given)]
        except (Exception, KeyboardInterrupt) as error:
            if not self.is_called:
                raise
            self.error = error  # CasADi would print it and lose its kind
            return [ca.DM.nan(self.sizes[name], 1) for name in _OUTPUTS]

    def _answers(self, given: dict[str, Array]) -> list[Any]:
        fill = {name: getattr(self._mpcc, name) for name in _BOUNDS}
        fill |= {"lam_x0": np.zeros(self._mpcc.n_x), "lam_g0": np.zeros(self._mpcc.n_g)}
        given |= {name: np.append(given[name], rest[given[name].size :]) for name, rest in fill.items()}
        duals = Duals(*(given[f"lam_{part}0"] for part in ("x", "g", "G", "H")))
        is_warm = any(np.any(np.nan_to_num(values)) for values in vars(duals).values())
        solver = self._solver(*(given[name].tobytes() for name in _BOUNDS))
        self.result = result = solver(given["x0"], p=given["p"], start=duals if is_warm else None)
        if self._error_on_fail and not result.success:
            raise RuntimeError(f"{self._name}: {result.message}")
        lam_p = -self._slope(result.x, given["p"], 1, result.lam_g, result.lam_G, result.lam_H)
        answers = {**vars(result), "lam_p": flat(lam_p)}
        return [np.ravel(answers[name])[: self.sizes[name]] for name in _OUTPUTS]

    def _made(self, *bounds: bytes) -> MPCCSolver:
        """The solver for these bounds; CasADi's derivatives are shared with those before."""
        values: Values = dict(zip(_BOUNDS, map(np.frombuffer, bounds), strict=True))
        solver = MPCCSolver(replace(self._mpcc, **values), self._options)
        self._mpcc = replace(self._mpcc, derivatives=solver.nlps.lifted.base)
        return solver


def mpccsol(name: str, plugin: str, problem: ByName, options: ByName | None = None) -> MPCCFunction:
    """Return a solver of ``min f, lbg <= g <= ubg, 0 <= G _|_ H >= 0`` as ``nlpsol`` does for NLPs.

    Parameters
    ----------
    name : str
        Of the CasADi Function.
    plugin : str
        A relaxation, see ``RELAXATIONS``.
    problem : mapping
        ``x`` and ``f``, perhaps ``g``, ``G``, ``H``, ``p``: CasADi expressions. Bounds ``lbG``, ``ubG``,
        ``lbH``, ``ubH`` of the pairs, as of :meth:`MPCC.mixed`, and ``switches``: the Function's G and H are
        then those of the pairs they become.
    options : mapping, optional
        Fields of :class:`rmesh_nlp.mpcc.Options`. ``"ipopt.tol"``, or ``"ipopt": {"tol": ...}``, holds for
        relaxations and branches. ``cc_pairs``: pairs (i, j) of unknowns, as CasADi's interface of CCOpt has
        them. Of nlpsol's: ``expand`` (SX in place of MX), ``error_on_fail``, and options
        of any Function.

    Raises
    ------
    ValueError
        If the relaxation, a key of the problem or an option is unknown.
    """
    for key in problem:
        if key not in (*_KEYS, *_OF_PAIRS):
            raise unknown("key", key, (*_KEYS, *_OF_PAIRS))
    settings = dict(options or {})
    pairs = np.array(settings.pop("cc_pairs", []), dtype=int).reshape(-1, 2)
    own = {key: settings.pop(key) for key in _OF_FUNCTIONS if key in settings}
    fails, expand = bool(settings.pop("error_on_fail", False)), bool(settings.pop("expand", False))
    settings.pop("print_time", None)  # nothing is printed
    dotted = [key for key in settings if key.startswith("ipopt.")]
    ipopt = {key.removeprefix("ipopt."): settings.pop(key) for key in dotted}
    settings["ipopt"] = {**settings.get("ipopt", {}), **ipopt}
    changed = Options().having({**settings, "relaxation": plugin})
    parts: Values = {key: problem.get(key) for key in _KEYS}
    given = MPCC(**parts)
    for key, places in zip("GH", pairs.T, strict=True):
        parts[key] = ca.vertcat(getattr(given, key), *(given.x[int(place)] for place in places))
    bounds = {key: problem[key] for key in _OF_PAIRS if key in problem}
    mpcc = (MPCC.mixed if bounds.keys() - {"switches"} else MPCC)(**parts, **bounds)
    if expand:
        x, p = ca.SX.sym("x", mpcc.n_x), ca.SX.sym("p", mpcc.p.shape[0])
        columns = mpcc.oracle.expand().call([x, p])
        mpcc = replace(mpcc, x=x, p=p, **dict(zip(_COLUMNS, columns, strict=True)))
    return MPCCFunction(name, _Solve(name, mpcc, given.n_g, changed, fails, own))
