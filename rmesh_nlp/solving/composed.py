"""Strategies that take a schedule of weights or flips of edges too: several solves, one solution."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec

from rmesh_nlp.settings import check_limits
from rmesh_nlp.solving.flipping import solve_with_flips
from rmesh_nlp.solving.regularised import solve_regularised
from rmesh_nlp.solving.solution import Solution

P = ParamSpec("P")

LIMITS = ("tolerance", "max_iterations", "time_limit_s")


def composed(solve: Callable[P, Solution]) -> Callable[P, Solution]:
    """Give a strategy its keywords ``regularisation``, ``distortion`` and ``flips``.

    The strategy has them in its signature, for people and for ``accepted``, and solves one problem without
    them; its limits are checked here, once.
    """

    @wraps(solve)
    def solved(*problem: P.args, **keywords: P.kwargs) -> Solution:
        options: dict[str, Any] = dict(keywords)
        check_limits(**{name: options[name] for name in LIMITS if name in options})
        if options.pop("flips", False):
            return solve_with_flips(solved, *problem, **options)  # type: ignore[arg-type]
        weight, distortion = options.pop("regularisation", None), options.pop("distortion", "shape-size")
        if weight is not None:
            more = {"regularisation": weight, "distortion": distortion, **options}
            return solve_regularised(solved, *problem, **more)  # type: ignore[arg-type]
        return solve(*problem, **options)

    return solved
