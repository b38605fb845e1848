"""Other ways to call the solver: from many starts, and in the call shape of CasADi's ``nlpsol``.

>>> import casadi as ca
>>> x = ca.SX.sym("x", 2)
>>> solver = mpccsol("solver", "scholtes", {"x": x, "f": ca.sumsqr(x - 1), "G": x[0], "H": x[1]})
>>> answer = solver(x0=[0.5, 0.2])
>>> float(answer["f"])
1.0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.relaxations import relaxation
from rmesh_nlp.mpcc.result import MPCCResult
from rmesh_nlp.mpcc.run import Progress
from rmesh_nlp.mpcc.solver import MPCCSolver

_KEYS = ("x", "f", "g", "G", "H", "p")
_ANSWERS = ("x", "f", "g", "G", "H", "lam_x", "lam_g", "lam_G", "lam_H")
_STATS = (
    "success", "message", "stationarity", "b_stationary", "n_biactive", "constraint_violation",
    "complementarity",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class MultiStart:
    """Results of all starts, in their order; the first is from the given start."""

    results: tuple[MPCCResult, ...]
    starts: tuple[Array, ...]
    seed: int

    @property
    def best(self) -> MPCCResult:
        """The lowest successful result; if none succeeded, the most nearly feasible one."""
        return min(
            self.results,
            key=lambda r: (not r.success, r.f if r.success else r.constraint_violation + r.complementarity),
        )

    @property
    def spread(self) -> tuple[float, float]:
        """Lowest and highest objective of the successful results (NaN if there are none)."""
        values = [r.f for r in self.results if r.success] or [float("nan")]
        return min(values), max(values)

    def __str__(self) -> str:
        (low, high), n = self.spread, f"{sum(r.success for r in self.results)} of {len(self.results)}"
        return f"{n} starts succeeded, f from {low:.8g} to {high:.8g}; best: {self.best}"


def multistart(
    mpcc: MPCC,
    x0: ArrayLike,
    *,
    n: int = 10,
    seed: int = 0,
    p: ArrayLike = (),
    options: Options | None = None,
    progress: Progress | bool = False,
    **changes: object,
) -> MultiStart:
    """Solve from ``x0`` and from ``n - 1`` seeded random starts around it.

    Starts are uniform between the bounds where both are near enough, else normal around ``x0``, clipped to
    the bounds. Parameters are those of :func:`rmesh_nlp.mpcc.solve`, and ``n`` and ``seed``: the same
    seed gives the same starts.
    """
    if n < 1:
        raise ValueError(f"n = {n} starts: at least 1 is needed")
    solver = MPCCSolver(mpcc, options, **changes)
    centre = mpcc.start(x0, p)
    lower, upper, unit = np.asarray(mpcc.lbx), np.asarray(mpcc.ubx), 1 + np.abs(centre)
    near = (upper - lower) <= 20 * unit
    random = np.random.default_rng(seed)
    starts = [centre]
    for _ in range(n - 1):
        share = random.uniform(size=centre.size)
        spread = 10.0 ** random.uniform(-1, 1.5)
        around = np.clip(centre + spread * unit * random.normal(size=centre.size), lower, upper)
        inside = np.where(near, lower, 0.0) + share * np.where(near, upper - lower, 0.0)
        starts.append(np.where(near, inside, around))
    return MultiStart(tuple(solver(start, p=p, progress=progress) for start in starts), tuple(starts), seed)


class MPCCFunction:
    """What :func:`mpccsol` returns: called with numbers, it gives a dict of ``DM``."""

    def __init__(self, name: str, problem: Mapping[str, Any], options: Options) -> None:
        self.name = name
        self._problem: dict[str, Any] = {key: problem.get(key) for key in _KEYS}
        self._options = options
        self._solvers: dict[tuple[bytes, ...], MPCCSolver] = {}
        self._result: MPCCResult | None = None
        self._solver(lbx=-np.inf, ubx=np.inf, lbg=-np.inf, ubg=np.inf)  # refuses a malformed problem now

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
        self._result = result = self._solver(lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)(x0, p=p)
        return {name: ca.DM(getattr(result, name)) for name in _ANSWERS}

    def stats(self) -> dict[str, Any]:
        """Status, label, residuals and counts of the last call."""
        if self._result is None:
            raise RuntimeError(f"{self.name} has not been called yet")
        r = self._result
        return {name: getattr(r, name) for name in _STATS} | {
            "return_status": r.status.value, "iter_count": r.counts["ipopt_iterations"],
            "n_nlp": r.counts["nlp_solves"], "t_wall_total": r.seconds["total"],
        }  # fmt: skip

    def _solver(self, **bounds: ArrayLike) -> MPCCSolver:
        arrays: dict[str, Any] = {name: np.array(bound, dtype=float) for name, bound in bounds.items()}
        key = tuple(array.tobytes() for array in arrays.values())
        if key not in self._solvers:
            self._solvers[key] = MPCCSolver(MPCC(**self._problem, **arrays), self._options)
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
    return MPCCFunction(name, problem, Options().having({**settings, "relaxation": plugin}))
