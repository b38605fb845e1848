"""The nonlinear program, its result, and the only call of ``casadi.nlpsol``.

Form and signs, here and everywhere in the package::

    minimise f(x, p)   subject to   lbg <= g(x, p) <= ubg,   lbx <= x <= ubx,
    Lagrangian  f + lam_g^T g + lam_x^T x,

so an active lower bound has a non-positive multiplier, an active upper bound a
non-negative one (CasADi's convention).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, field, replace
from enum import Enum
from io import StringIO
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array, flat
from rmesh_nlp.optimize.callbacks import IterationCallback, Monitor, SignalWatch
from rmesh_nlp.optimize.solver_options import refused_option


class Status(str, Enum):
    """How a solve ended. The value is a word for tables, ``message`` a sentence for people."""

    CONVERGED = "converged"
    ACCEPTABLE = "acceptable"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    INTERRUPTED = "interrupted"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    STALLED = "stalled"
    CYCLED = "cycled"
    INACCURATE = "inaccurate"
    NOT_STATIONARY = "not_stationary"
    WORSE = "worse"
    QUADRATURE_EXPLOITED = "quadrature-exploited"
    PENETRATION = "penetration"
    INVALID_MESH = "invalid_mesh"
    TOO_FEW_FREEDOMS = "too_few_freedoms"
    EVALUATION_ERROR = "evaluation_error"
    FAILED = "failed"

    @property
    def message(self) -> str:
        """One sentence that says what the status means."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.CONVERGED: "Converged to the tolerance.",
    Status.ACCEPTABLE: "Converged to the looser, acceptable tolerance only.",
    Status.ITERATION_LIMIT: "Stopped at the iteration limit.",
    Status.TIME_LIMIT: "Stopped at the time limit.",
    Status.INTERRUPTED: "Stopped by the user; the best valid point so far is kept.",
    Status.INFEASIBLE: "Converged to a point of local infeasibility.",
    Status.UNBOUNDED: "The iterates diverge: the problem may be unbounded.",
    Status.STALLED: "No further progress was possible before the tolerance was met.",
    Status.CYCLED: "The active set repeated itself without a solution.",
    Status.INACCURATE: "The solver stopped, but a residual of the source problem is above its tolerance.",
    Status.NOT_STATIONARY: "The solver met its own test, but not the tolerance of the first-order residual.",
    Status.WORSE: "The minimised objective, measured accurately, is above its value on the given mesh.",
    Status.QUADRATURE_EXPLOITED: "The gain is one of the quadrature rule: take a rule of higher degree.",
    Status.PENETRATION: "Between its nodes the contact boundary penetrates the foundation too far.",
    Status.INVALID_MESH: "An element is inverted or smaller than allowed.",
    Status.TOO_FEW_FREEDOMS: "There are more equations than free unknowns.",
    Status.EVALUATION_ERROR: "A function returned NaN or infinity.",
    Status.FAILED: "The solver failed.",
}

_IPOPT_STATUS = {
    "Solve_Succeeded": Status.CONVERGED,
    "Feasible_Point_Found": Status.CONVERGED,
    "Solved_To_Acceptable_Level": Status.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Maximum_CpuTime_Exceeded": Status.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": Status.TIME_LIMIT,
    "User_Requested_Stop": Status.INTERRUPTED,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Diverging_Iterates": Status.UNBOUNDED,
    "Search_Direction_Becomes_Too_Small": Status.STALLED,
    "Restoration_Failed": Status.STALLED,
    "Error_In_Step_Computation": Status.STALLED,
    "Not_Enough_Degrees_Of_Freedom": Status.TOO_FEW_FREEDOMS,
    "Invalid_Number_Detected": Status.EVALUATION_ERROR,
}

IPOPT_OPTIONS: Mapping[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    # The default relaxes every bound by 1e-8: it moves a contact energy in the sixth digit.
    "bound_relax_factor": 0.0,
}


@dataclass(frozen=True)
class Derivatives:
    """Derivative Functions that replace CasADi's automatic ones, in the form nlpsol takes.

    Attributes
    ----------
    grad_f : casadi.Function
        ``(x, p) -> (f, grad_f_x)``, the gradient a dense column.
    jac_g : casadi.Function
        ``(x, p) -> (g, jac_g_x)``.
    hess_lag : casadi.Function or None
        ``(x, p, lam_f, lam_g) -> triu_hess_gamma_x_x``, upper triangle of the Hessian of
        ``lam_f f + lam_g^T g``. None where only quasi-Newton methods are meant.
    kernels : tuple
        What must live as long as these Functions: Python callbacks, which CasADi does not own.
    """

    grad_f: ca.Function
    jac_g: ca.Function
    hess_lag: ca.Function | None
    kernels: tuple[ca.Function, ...] = ()


@dataclass(frozen=True)
class NLP:
    """A parametric nonlinear program in CasADi expressions.

    Attributes
    ----------
    x, p : SX or MX, columns
        Unknowns and parameters (``p`` may be of length 0).
    f, g : SX or MX
        Scalar objective and column of constraints.
    lbx, ubx, lbg, ubg : arrays
        Bounds.
    derivatives : Derivatives or None
        Assembled derivatives of exactly this ``f`` and ``g``. None: CasADi derives them.
        To add a term or a constraint use :meth:`extended`, which keeps them; if you
        ``dataclasses.replace`` ``f`` or ``g``, set ``derivatives=None`` as well.
    parts : mapping of str to expression
        Parts of the unknowns by name.
    """

    x: Any
    p: Any
    f: Any
    g: Any
    lbx: Array
    ubx: Array
    lbg: Array
    ubg: Array
    derivatives: Derivatives | None = None
    _of: tuple[int, int] = field(default=(0, 0), repr=False)
    parts: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        of = (_identity(self.f), _identity(self.g))
        if self.derivatives is not None and self._of not in ((0, 0), of):
            raise ValueError(
                "f or g was replaced but the derivatives were not: use extended(), or derivatives=None"
            )
        object.__setattr__(self, "_of", of)

    @property
    def n_x(self) -> int:
        """Number of unknowns."""
        return int(self.x.shape[0])

    @property
    def n_g(self) -> int:
        """Number of constraints."""
        return int(self.g.shape[0])

    def extended(
        self,
        *,
        x: Any = None,
        p: Any = None,
        f: Any = 0,
        g: Any = None,
        lbx: ArrayLike = (),
        ubx: ArrayLike = (),
        lbg: ArrayLike = (),
        ubg: ArrayLike = (),
    ) -> NLP:
        """Append unknowns, parameters and constraint rows and add a term to the objective.

        The assembled derivatives of what was there are kept; only the new ``f`` and ``g``
        are differentiated by CasADi. Their expressions may use old and new unknowns.

        Parameters
        ----------
        x, p : symbols to append to the unknowns and to the parameters
        f : term added to the objective
        g : rows appended to the constraints
        lbx, ubx, lbg, ubg : bounds of the appended unknowns and rows
        """
        kind = type(self.x)
        new_x = kind(0, 1) if x is None else x
        new_p = kind(0, 1) if p is None else p
        new_g = kind(0, 1) if g is None else g
        all_x, all_p = ca.vertcat(self.x, new_x), ca.vertcat(self.p, new_p)
        all_g = ca.vertcat(self.g, new_g)
        all_f = self.f + f
        derivatives = None
        if self.derivatives is not None:
            derivatives = _extend_derivatives(self, self.derivatives, new_x, all_x, all_p, kind(f), new_g)
        return replace(
            self,
            x=all_x,
            p=all_p,
            f=all_f,
            g=all_g,
            lbx=np.append(self.lbx, lbx),
            ubx=np.append(self.ubx, ubx),
            lbg=np.append(self.lbg, lbg),
            ubg=np.append(self.ubg, ubg),
            derivatives=derivatives,
            _of=(0, 0),
        )


def _identity(expression: Any) -> int:
    """A number for an expression; SX columns have no hash."""
    return hash(expression) if isinstance(expression, ca.MX) else id(expression)


def _extend_derivatives(
    nlp: NLP, base: Derivatives, new_x: Any, x: Any, p: Any, f: Any, g: Any
) -> Derivatives:
    """Sum the derivatives of ``nlp`` and the automatic ones of the appended ``f`` and ``g``."""
    kind, n_new = type(nlp.x), int(new_x.shape[0])
    f_old, gradient = base.grad_f(nlp.x, nlp.p)
    g_old, jacobian = base.jac_g(nlp.x, nlp.p)
    lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", nlp.n_g + int(g.shape[0]))
    lam_old, lam_new = ca.vertsplit(lam_g, [0, nlp.n_g, lam_g.shape[0]])
    hess_lag = None
    if base.hess_lag is not None:
        hessian = ca.diagcat(base.hess_lag(nlp.x, nlp.p, lam_f, lam_old), kind(n_new, n_new))
        # the appended part is small or sparse: CasADi colours it well
        hessian_new = ca.triu(ca.hessian(lam_f * f + ca.dot(lam_new, g), x)[0])
        hess_lag = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [hessian + hessian_new])
    jacobian_old = ca.horzcat(jacobian, kind(nlp.n_g, n_new))
    return Derivatives(
        grad_f=ca.Function(
            "nlp_grad_f",
            [x, p],
            [f_old + f, ca.vertcat(gradient, kind(n_new, 1)) + ca.densify(ca.gradient(f, x))],
        ),
        jac_g=ca.Function(
            "nlp_jac_g", [x, p], [ca.vertcat(g_old, g), ca.vertcat(jacobian_old, ca.jacobian(g, x))]
        ),
        hess_lag=hess_lag,
        kernels=base.kernels,
    )


@dataclass(frozen=True)
class NLPResult:
    """What a solver returned: a point, multipliers in CasADi's signs, status and counts.

    Attributes
    ----------
    x, g, lam_x, lam_g : arrays
    f : float
    status : Status
    solver_message : str
        The solver's own word.
    iterations : int
    history : dict of str to list of float
        Per iteration: ``obj``, ``inf_pr``, ``inf_du``, ``mu``, ... as the solver gives them.
    seconds : float
    """

    x: Array
    f: float
    g: Array
    lam_x: Array
    lam_g: Array
    status: Status
    solver_message: str
    iterations: int
    history: dict[str, list[float]]
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether the solver says that it met a tolerance (not yet a proof: see the audit)."""
        return self.status in (Status.CONVERGED, Status.ACCEPTABLE)


class Solver:
    """An NLP made ready once and solved for many starts, parameters and bounds.

    Parameters
    ----------
    nlp : NLP
    plugin : str
        Any CasADi ``nlpsol`` plugin; the options below are Ipopt's.
    options : mapping
        Solver options without the plugin prefix; they add to and override ``IPOPT_OPTIONS``.
    monitor : callable, optional
        Called after each iteration.
    every : int
        Call the monitor at each of so many iterations only.

    Raises
    ------
    ValueError
        If the plugin refuses an option; at a call, if an array has the wrong length or a start is not finite.
    KeyboardInterrupt
        At a call, if the user interrupts.
    """

    def __init__(
        self,
        nlp: NLP,
        *,
        plugin: str = "ipopt",
        options: Mapping[str, Any] | None = None,
        monitor: Monitor | None = None,
        every: int = 1,
    ) -> None:
        self.nlp = nlp
        settings: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            "no_nlp_grad": True,
            "calc_lam_p": False,
            "show_eval_warnings": False,
        }
        base = IPOPT_OPTIONS if plugin == "ipopt" else {}
        settings[plugin] = {**base, **(options or {})}
        if nlp.derivatives is not None:
            settings["grad_f"] = nlp.derivatives.grad_f
            settings["jac_g"] = nlp.derivatives.jac_g
            if settings[plugin].get("hessian_approximation", "exact") == "exact":
                settings["hess_lag"] = nlp.derivatives.hess_lag
        n_p = int(nlp.p.shape[0])
        # CasADi does not own its callbacks: the reference must be kept alive
        self._callback = None if monitor is None else IterationCallback(nlp.n_x, nlp.n_g, n_p, monitor)
        if self._callback is not None:
            settings["iteration_callback"] = self._callback
            settings["iteration_callback_step"] = every
        problem = {"x": nlp.x, "p": nlp.p, "f": nlp.f, "g": nlp.g}
        try:
            with redirect_stdout(StringIO()):  # Ipopt prints the description of an option it refuses
                self._function = ca.nlpsol("solver", plugin, problem, settings)
        except RuntimeError as error:
            raise refused_option(plugin, options or {}, error) from None

    def __call__(
        self,
        x0: ArrayLike,
        *,
        p: ArrayLike = (),
        lbx: ArrayLike | None = None,
        ubx: ArrayLike | None = None,
        lbg: ArrayLike | None = None,
        ubg: ArrayLike | None = None,
        lam_x0: ArrayLike = 0.0,
        lam_g0: ArrayLike = 0.0,
    ) -> NLPResult:
        """Solve; bounds that are not given are the program's own."""
        nlp = self.nlp
        start = np.asarray(x0, dtype=float).ravel()
        if start.size != nlp.n_x:
            raise ValueError(f"x0 has length {start.size}, the problem has {nlp.n_x} unknowns")
        if not np.all(np.isfinite(start)):
            raise ValueError(f"x0[{int(np.flatnonzero(~np.isfinite(start))[0])}] is not finite")
        began = time.perf_counter()
        with SignalWatch(self._callback):
            solution = self._function(
                x0=start,
                p=p,
                lbx=nlp.lbx if lbx is None else lbx,
                ubx=nlp.ubx if ubx is None else ubx,
                lbg=nlp.lbg if lbg is None else lbg,
                ubg=nlp.ubg if ubg is None else ubg,
                lam_x0=lam_x0,
                lam_g0=lam_g0,
            )
        seconds = time.perf_counter() - began
        stats = self._function.stats()
        word = str(stats["return_status"])
        status = _IPOPT_STATUS.get(word, Status.CONVERGED if stats["success"] else Status.FAILED)
        return NLPResult(
            x=flat(solution["x"]),
            f=float(solution["f"]),
            g=flat(solution["g"]),
            lam_x=flat(solution["lam_x"]),
            lam_g=flat(solution["lam_g"]),
            status=status,
            solver_message=word,
            iterations=int(stats.get("iter_count", 0)),
            history={key: list(values) for key, values in stats.get("iterations", {}).items()},
            seconds=seconds,
        )
