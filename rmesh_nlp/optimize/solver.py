"""The only call of ``casadi.nlpsol``: an NLP made ready, and what a solve returns."""

from __future__ import annotations

import re
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import Annotated, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.errors import BadInputError, nearest
from rmesh_nlp.evaluation import Array, flat, is_finite
from rmesh_nlp.optimize.budget import Budget, checked
from rmesh_nlp.optimize.callbacks import IterationCallback, Monitor
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import ByName, Values

COMMON = (
    "tol",
    "max_iter",
    "max_cpu_time",
    "max_wall_time",
    "print_level",
    "acceptable_tol",
    "acceptable_iter",
    "mu_strategy",
    "mu_init",
    "mu_target",
    "hessian_approximation",
    "linear_solver",
    "constr_viol_tol",
    "dual_inf_tol",
    "compl_inf_tol",
    "bound_push",
    "bound_relax_factor",
    "nlp_scaling_method",
    "obj_scaling_factor",
    "warm_start_init_point",
    "limited_memory_max_history",
)
"""Options of Ipopt that people set, for the nearest name."""


class Taken:
    """Mark of a mapping of options that Ipopt takes."""

    def check(self, name: str, options: PluginOptions) -> None:
        """Raise a BadInputError for the first one that it refuses, by itself on an NLP of one unknown.

        Libraries of linear solvers are looked for only when it starts.
        """
        x = ca.SX.sym("x")
        for option, value in options.items():
            own = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", option: value}}
            try:
                with redirect_stdout(StringIO()):  # Ipopt prints the description of the option
                    probe = ca.nlpsol("probe", "ipopt", {"x": x, "f": x**2}, own)
                    probe()
                if probe.stats()["return_status"] == "Invalid_Option":
                    raise RuntimeError
            except RuntimeError as refusal:
                said = f"refuses {option} = {value!r} here"
                if re.search(r"[Nn]o such \w+ option", str(refusal)):
                    said = f"has no {option!r}{nearest(option, COMMON)}"
                raise BadInputError(f"{name} must be options of Ipopt, which {said}") from None


PluginOptions: TypeAlias = Annotated[ByName, Taken()]
"""Options of Ipopt by name: numbers, words, yes and no."""

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

IPOPT_OPTIONS: PluginOptions = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    # The default relaxes every bound by 1e-8: it moves a contact energy in the sixth digit.
    "bound_relax_factor": 0.0,
}

LEAST_SHIFTS: PluginOptions = {"perturb_dec_fact": 0.2, "perturb_inc_fact": 1.5}
"""Ipopt options for a Hessian that is indefinite at nearly every iterate, as that of an energy in the nodes.

A shift within a factor 1.5 of the least one, where Ipopt's own search is within 8, repays the factorisations
that it costs: 6.1 with 24 squares a side takes 61 and 82 iterations of joint and mpcc for 122 and 161."""


@dataclass(frozen=True)
class NLPResult:
    """What a solver returned: a point, multipliers in CasADi's signs, status and counts.

    ``history`` has ``obj``, ``inf_pr``, ``inf_du``, ``mu``, ... of each iteration, as the solver gives them.
    """

    x: Array
    f: float
    g: Array
    lam_x: Array
    lam_g: Array
    status: Status
    iterations: int
    history: dict[str, list[float]]
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether the solver says that it met a tolerance (no proof: see the assessment)."""
        return self.status in (Status.CONVERGED, Status.ACCEPTABLE)


class Solver:
    """An NLP made ready once and solved for many starts, parameters and bounds.

    Parameters
    ----------
    nlp : NLP
    options : mapping
        Those of Ipopt; they add to and override ``IPOPT_OPTIONS``.

    Raises
    ------
    ValueError
        At a call, if an array has the wrong length, or a start is not finite.
    KeyboardInterrupt
        At a call, if the user interrupts.
    """

    def __init__(self, nlp: NLP, *, options: PluginOptions | None = None) -> None:
        self.nlp = nlp
        # CasADi does not own its callbacks: the reference must be kept alive
        self._callback = IterationCallback(nlp.n_x, nlp.n_g, nlp.p.shape[0])
        own = {**IPOPT_OPTIONS, **(options or {})}
        settings: Values = {
            "print_time": False,
            "error_on_fail": False,
            "no_nlp_grad": True,
            "calc_lam_p": False,
            "show_eval_warnings": False,
            "iteration_callback": self._callback,
            "ipopt": own,
        }
        if nlp.derivatives is not None:
            settings |= {"grad_f": nlp.derivatives.grad_f, "jac_g": nlp.derivatives.jac_g}
            if own.get("hessian_approximation", "exact") == "exact":
                settings["hess_lag"] = nlp.derivatives.hess_lag
        problem = {"x": nlp.x, "p": nlp.p, "f": nlp.f, "g": nlp.g}
        self._function = ca.nlpsol("solver", "ipopt", problem, settings)

    def __call__(
        self, x0: ArrayLike, *, p: ArrayLike = (), monitor: Monitor | None = None, **others: ArrayLike
    ) -> NLPResult:
        """Solve; ``monitor`` is called after each iteration.

        ``others`` are bounds that replace the NLP's own, and multipliers ``lam_x0``, ``lam_g0``.
        """
        nlp = self.nlp
        start = np.asarray(x0, dtype=float).ravel()
        if start.size != nlp.n_x:
            raise ValueError(f"x0 has length {start.size}, the problem has {nlp.n_x} unknowns")
        if not is_finite(start):
            raise ValueError(f"x0[{int(np.flatnonzero(~np.isfinite(start))[0])}] is not finite")
        bounds = {"lbx": nlp.lbx, "ubx": nlp.ubx, "lbg": nlp.lbg, "ubg": nlp.ubg}
        watch = Budget()
        with self._callback.watched(monitor):
            # no checkpoint raises inside CasADi: the monitor stops the solver
            solution = checked(lambda: None, lambda: self._function(x0=start, p=p, **{**bounds, **others}))
        stats = self._function.stats()
        word = str(stats["return_status"])
        return NLPResult(
            **{name: flat(solution[name]) for name in ("x", "g", "lam_x", "lam_g")},
            f=float(solution["f"]),
            status=_IPOPT_STATUS.get(word, Status.CONVERGED if stats["success"] else Status.FAILED),
            iterations=int(stats.get("iter_count", 0)),
            history={key: list(values) for key, values in stats.get("iterations", {}).items()},
            seconds=watch.elapsed,
        )
