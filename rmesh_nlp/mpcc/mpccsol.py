"""The call shape of CasADi's ``nlpsol`` for MPCCs.

>>> import casadi as ca
>>> x = ca.SX.sym("x", 2)
>>> solver = mpccsol("solver", "scholtes", {"x": x, "f": ca.sumsqr(x - 1), "G": x[0], "H": x[1]})
>>> answer = solver(x0=[0.5, 0.2])
>>> float(answer["f"])
1.0
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.relaxations import relaxation
from rmesh_nlp.mpcc.result import MPCCResult
from rmesh_nlp.mpcc.solver import MPCCSolver

_KEYS = ("x", "f", "g", "G", "H", "p")


class MPCCFunction:
    """What :func:`mpccsol` returns: called with numbers, it gives a dict of ``DM``."""

    def __init__(self, name: str, problem: Mapping[str, Any], options: Options) -> None:
        self.name = name
        self._problem, self._options = dict(problem), options
        self._solvers: dict[tuple[bytes, ...], MPCCSolver] = {}
        self._result: MPCCResult | None = None
        self._solver((-np.inf, np.inf, -np.inf, np.inf))  # a malformed problem is refused now

    def __call__(
        self,
        *,
        x0: ArrayLike = 0.0,
        p: ArrayLike = (),
        lbx: ArrayLike = -np.inf,
        ubx: ArrayLike = np.inf,
        lbg: ArrayLike = -np.inf,
        ubg: ArrayLike = np.inf,
    ) -> dict[str, ca.DM]:
        """Solve; the keys are ``x f g G H lam_x lam_g lam_G lam_H``, signs of multipliers as in nlpsol.

        New bounds make a new solver; it is kept for calls with the same bounds.
        """
        self._result = result = self._solver((lbx, ubx, lbg, ubg))(x0, p=p)
        names = ("x", "f", "g", "G", "H", "lam_x", "lam_g", "lam_G", "lam_H")
        return {name: ca.DM(getattr(result, name)) for name in names}

    def stats(self) -> dict[str, Any]:
        """Status, label, residuals and counts of the last call."""
        if self._result is None:
            raise RuntimeError(f"{self.name} has not been called yet")
        r = self._result
        return {
            "success": r.success, "return_status": r.status.value, "message": r.message,
            "stationarity": r.stationarity, "b_stationary": r.b_stationary, "n_biactive": r.n_biactive,
            "constraint_violation": r.constraint_violation, "complementarity": r.complementarity,
            "iter_count": r.counts["ipopt_iterations"], "n_nlp": r.counts["nlp_solves"],
            "t_wall_total": r.seconds["total"],
        }  # fmt: skip

    def _solver(self, bounds: tuple[ArrayLike, ...]) -> MPCCSolver:
        key = tuple(np.asarray(bound, dtype=float).tobytes() for bound in bounds)
        if key not in self._solvers:
            names = ("lbx", "ubx", "lbg", "ubg")
            fields: dict[str, Any] = {name: self._problem.get(name) for name in _KEYS}
            limits: dict[str, Any] = {
                name: np.array(bound, dtype=float) for name, bound in zip(names, bounds, strict=True)
            }
            self._solvers[key] = MPCCSolver(MPCC(**fields, **limits), self._options)
        return self._solvers[key]


def mpccsol(
    name: str, plugin: str, problem: Mapping[str, Any], options: Mapping[str, Any] | None = None
) -> MPCCFunction:
    """Return a solver of ``min f, lbg <= g <= ubg, 0 <= G _|_ H >= 0`` with the call shape of nlpsol.

    Parameters
    ----------
    name : str
    plugin : str
        A relaxation, see ``RELAXATIONS``.
    problem : mapping
        ``x`` and ``f``, perhaps ``g``, ``G``, ``H``, ``p``: CasADi expressions.
    options : mapping, optional
        Fields of :class:`rmesh_nlp.mpcc.Options`; ``{"ipopt": {...}}`` holds for relaxations and branches.

    Raises
    ------
    ValueError
        If the relaxation, a key of the problem or an option is unknown.
    """
    relaxation(plugin)
    unknown = set(problem) - set(_KEYS)
    if unknown:
        raise ValueError(f"unknown key {sorted(unknown)[0]!r} of the problem; there are {', '.join(_KEYS)}")
    settings = dict(options or {})
    ipopt = settings.pop("ipopt", None)
    if ipopt is not None:
        settings = {"ipopt_relaxed": ipopt, "ipopt_exact": ipopt, **settings}
    stray = set(settings) - set(Options.__dataclass_fields__)
    if stray:
        raise ValueError(f"unknown option {sorted(stray)[0]!r}; see rmesh_nlp.mpcc.Options")
    return MPCCFunction(name, problem, Options(**{**settings, "relaxation": plugin}))
