"""Any installed formulation, by an object or by its name."""

from __future__ import annotations

import warnings
from typing import Any

from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.formulation import Chooser, Formulation, available
from rmesh_nlp.solving.limits import TOLERANCE, Limits
from rmesh_nlp.solving.monitor import OnStep
from rmesh_nlp.solving.options import solve_by_options
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.start import Start


def formulations() -> tuple[str, ...]:
    """Names of the installed formulations, those of other packages included."""
    return tuple(sorted(available()))


def solve(
    problem: ContactProblem,
    formulation: str | Formulation | Chooser = "auto",
    *,
    objective: str | Objective = "energy",
    start: Start = None,
    seed: int | None = None,
    tolerance: float = TOLERANCE,
    limits: Limits | None = None,
    on_step: OnStep | None = None,
    certify: bool = False,
    **settings: Any,
) -> Solution:
    """Relocate the nodes of a problem and solve the contact problem there.

    Parameters
    ----------
    problem : ContactProblem
    formulation : str or Formulation
        A name, see :func:`formulations`, or an object whose fields are its settings, such as
        ``Joint(first_barrier=1e-2)`` of ``formulations.joint``. ``auto`` chooses for the problem and says so
        in the record; ``fixed`` moves no node, ``nested`` solves a contact problem per step, ``joint`` and
        ``mpcc`` find positions and displacement at once.
    objective : str or Objective
        "energy", or another one such as "error-l2 + 0.01*quality" or "mean(top, -uy)".
    start : positions (2, nodes), "given", name of a formulation, or Solution, optional
        By default the mesh as given.
    seed : int, optional
        Random start.
    tolerance : float
        Largest measured first-order residual of a solution that is called converged.
    limits : Limits, optional
        After them, as after Ctrl-C, the best valid mesh so far is the solution.
    on_step : callable, optional
        Called with each step of the history.
    certify : bool
        Bound the error of the solution: ``solution.certificate``.
    settings
        Settings of a formulation that is named, and of what takes one, as on the command line:
        ``flips=True``, ``starts=8``. ``time_limit_s`` and ``max_iterations``, the limits of 0.1, still work
        and warn.

    Returns
    -------
    Solution
        Judged by what is measured on the problem; see ``status`` and ``success``.

    Raises
    ------
    BadInputError
        If there is no such formulation, or it does not take the problem or an option.
    """
    for old in ("time_limit_s", "max_iterations"):
        if old in settings:
            warnings.warn(f"{old} is now a part of limits=Limits(...)", DeprecationWarning, stacklevel=2)
    common: dict[str, Any] = {"on_step": on_step, "certify": certify}
    asked: dict[str, Any] = {"objective": objective, "start": start, "seed": seed, "tolerance": tolerance}
    if settings and isinstance(formulation, str):
        if limits is not None:
            settings = {"time_limit_s": limits.seconds, "max_iterations": limits.iterations, **settings}
        return solve_by_options(problem, formulation, {**settings, **asked}, **common)
    if settings:
        example = f"{type(formulation).__name__}({next(iter(settings))}=...)"
        raise TypeError(f"settings are fields of the formulation: {example}")
    return driver.solve(problem, formulation, limits=limits, **asked, **common)
