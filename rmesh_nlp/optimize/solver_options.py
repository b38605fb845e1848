"""Which option a solver refuses, said in one line instead of CasADi's C++ trace."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import casadi as ca

COMMON = (
    *("tol", "max_iter", "max_cpu_time", "max_wall_time", "print_level", "acceptable_tol", "acceptable_iter"),
    *("mu_strategy", "mu_init", "mu_target", "hessian_approximation", "linear_solver", "constr_viol_tol"),
    *("dual_inf_tol", "compl_inf_tol", "bound_push", "bound_relax_factor", "nlp_scaling_method"),
    *("obj_scaling_factor", "warm_start_init_point", "limited_memory_max_history"),
)
"""Options of Ipopt that people set, for the nearest name."""


def refused_option(plugin: str, options: Mapping[str, Any], error: RuntimeError) -> Exception:
    """The error that names the option which ``plugin`` refuses; ``error`` itself if none is refused.

    Each option is tried by itself on a program of one unknown.
    """
    solver = plugin.capitalize()
    for name, value in options.items():
        refusal = _refusal(plugin, name, value)
        if refusal is None:
            continue
        if re.search(r"[Nn]o such \w+ option", refusal):
            near = difflib.get_close_matches(name, COMMON, n=1)
            hint = f", did you mean {near[0]!r}?" if near else ""
            return ValueError(f"{solver} has no option {name!r}{hint}")
        return ValueError(f"{solver} refuses {name} = {value!r}")
    return error


def _refusal(plugin: str, name: str, value: Any) -> str | None:
    """What the solver says to one option; None if it takes it."""
    x = ca.SX.sym("x")
    quiet = {"print_level": 0, "sb": "yes"} if plugin == "ipopt" else {}
    try:
        with redirect_stdout(StringIO()):  # Ipopt prints the description of the option
            ca.nlpsol(
                "probe", plugin, {"x": x, "f": x**2}, {"print_time": False, plugin: {**quiet, name: value}}
            )
    except (RuntimeError, NotImplementedError) as error:
        return str(error)
    return None
