"""Newton-CG with a trust region of its own for each variable, for functions that are their own barrier.

The method of :mod:`rmesh_nlp.optimize.trust_region` with three changes for large moves of a mesh:

- Each variable is trusted within a width of its own, given by the point (for a node: the least
  height of the elements around it). A uniform radius is held back everywhere by the smallest element;
  with widths one radius of order one suits them all, and a coarse mesh is as easy as a fine one.
- A step that leaves the domain of the function is cut at a part of its way to the boundary, as interior
  points do, and not refused: the cut costs no evaluation.
- The descent ends where the model sees no decrease worth a step *and* the trust region does not
  hide it: a small radius makes every decrease small.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.newton_settings import LocalNewtonSettings
from rmesh_nlp.optimize.newton_step import BoxStep, Model, PreconditionedStep, Preconditioner
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.trust_region import Evaluation, NewtonResult


def descend(
    evaluate: Callable[[Array], Evaluation | None],
    start: Array,
    lower: Array,
    upper: Array,
    widths: Callable[[Array], Array],
    longest: Callable[[Array, Array], float],
    *,
    gain_tolerance: float,
    reference: float | None = None,
    max_iterations: int = 100,
    forcing: float | None = None,
    settings: LocalNewtonSettings | None = None,
    on_step: Callable[[int, Array, Evaluation], bool | None] | None = None,
    preconditioned: Callable[[Any, Array], Preconditioner | None] | None = None,
) -> NewtonResult:
    """Minimise in the box ``lower <= x <= upper`` from ``start``, where the function is defined.

    Parameters
    ----------
    evaluate : callable
        Value, gradient and model; None where the function is not defined.
    start, lower, upper : (n,) arrays
    widths : callable
        Positive widths (n,) of the trust region at a point, for radius 1.
    longest : callable
        ``(x, step) -> part`` of the step, at most 1, that stays well within the domain.
    gain_tolerance : float
        Ends where the model predicts less than this part of the decrease since ``reference``.
    reference : float, optional
        By default the value at the start.
    max_iterations : int
    forcing : float, optional
        In place of that of the settings.
    settings : LocalNewtonSettings, optional
    on_step : callable, optional
        Called with the iteration, the point and its evaluation; the descent stops if it returns True.
    preconditioned : callable, optional
        ``(model, widths) -> preconditioner`` of the conjugate gradients, in units of the widths; None, as by
        default, for the diagonal of the model.
    """
    use = settings or LocalNewtonSettings()
    forcing = use.forcing if forcing is None else forcing
    x = np.clip(start, lower, upper)
    here = evaluate(x)
    if here is None:
        return NewtonResult(x, np.nan, Status.EVALUATION_ERROR, 0, 0)
    reference, products, radius = here.value if reference is None else reference, 0, use.first
    for iteration in range(max_iterations + 1):
        if on_step is not None and on_step(iteration, x, here):
            return NewtonResult(x, here.value, Status.INTERRUPTED, iteration, products)
        if iteration == max_iterations:
            break
        model, there, width = here.model(), None, widths(x)
        preconditioner = None if preconditioned is None else preconditioned(model, width)
        while there is None:
            low, high = np.maximum((lower - x) / width, -radius), np.minimum((upper - x) / width, radius)
            scaled, slope = Scaled(model, width), width * here.gradient
            step = BoxStep(scaled, slope, use.step)
            if preconditioner is not None:
                step = PreconditionedStep(scaled, slope, preconditioner, use.step)
            y, predicted = step.solve(low, high, forcing)
            products += step.products
            hidden = float(np.mean(np.abs(y) >= 0.999 * radius)) if y.size else 0.0
            rounding = use.rounding * max(abs(here.value), 1e-300)
            floor = use.nothing * max(abs(here.value), 1e-300)
            enough = gain_tolerance * (reference - here.value)
            if predicted <= max(enough, floor) and (hidden <= use.hidden or predicted <= floor):
                return NewtonResult(x, here.value, Status.CONVERGED, iteration, products)
            if radius < use.least or not np.any(y):
                return NewtonResult(x, here.value, Status.STALLED, iteration, products)
            s = width * y
            part = longest(x, s)
            if part < 1:
                s = part * s
                predicted = -float(here.gradient @ s + 0.5 * s @ model(s))
                products += 1
            there = evaluate(np.clip(x + s, lower, upper))
            ratio = -np.inf
            if there is not None:
                # close to the end both decreases are rounding of the function: they then count as alike
                ratio = (here.value - there.value + rounding) / (max(predicted, 0.0) + rounding)
            if not ratio >= use.poor:
                radius = use.shrink * part * float(np.max(np.abs(y)))
            elif part < 1:
                radius = max(part * radius, use.least)
            elif ratio > use.good:
                radius = use.grow * radius
            if there is not None and not ratio > use.sufficient:
                there = None
        x, here = np.clip(x + s, lower, upper), there
    return NewtonResult(x, here.value, Status.ITERATION_LIMIT, max_iterations, products)


class Scaled:
    """A model in units of the widths, in which the trust region is a cube; see :class:`Model`."""

    def __init__(self, model: Model, width: Array) -> None:
        self._model, self._width = model, width

    def __call__(self, d: Array) -> Array:
        """Hessian times ``d``."""
        return self._width * self._model(self._width * d)

    def diagonal(self) -> Array:
        """That of the model."""
        return self._width**2 * self._model.diagonal()
