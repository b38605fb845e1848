"""Projected Newton-CG with a trust region, for a smooth function in a box.

In the manner of TRON (C.-J. Lin, J. J. Moré, Newton's method for large bound-constrained optimization
problems, SIAM J. Optim. 9 (1999) 1100-1127), by the steps of :mod:`rmesh_nlp.optimize.newton_step`.

- The trust region is a box too. TRON's ball stops a step where the conjugate gradients leave it, and the
  projection then shortens that step, so that the ball never grows although the model is right. In a box the
  same model is used until it has nothing left to give: of the functions here, a derivative costs as much as
  dozens of Hessian products.
- A function that is its own barrier may have :class:`LocalRadii`: a uniform radius is held back everywhere by
  the smallest element. A step that leaves its domain is cut at a part of its way to the boundary, as interior
  points do, and not refused: the cut costs no evaluation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.evaluation import Array, magnitude
from rmesh_nlp.optimize.newton_step import BoxStep, Model, NewtonSettings, Scaled
from rmesh_nlp.optimize.status import Status


@dataclass(frozen=True)
class Evaluation:
    """Value and gradient at a point; ``model`` builds the Hessian there."""

    value: float
    gradient: Array
    model: Callable[[], Model]


@dataclass(frozen=True)
class NewtonResult:
    """Where the method stopped; STALLED where no step was left to take and the point is not stationary."""

    x: Array
    status: Status
    iterations: int


@dataclass(frozen=True)
class LocalRadii:
    """A trust region of its own for each variable.

    ``widths`` has the positive widths (n,) of the trust region at a point, for radius 1. ``longest`` takes a
    point and a step to the part of the step, at most 1, that stays well within the domain of the function.
    """

    widths: Callable[[Array], Array]
    longest: Callable[[Array, Array], float]


def minimise(
    evaluate: Callable[[Array], Evaluation | None],
    start: Array,
    lower: Array,
    upper: Array,
    *,
    tolerance: float = 1e-6,
    gain_tolerance: float = 0.0,
    reference: float | None = None,
    unit: float | None = None,
    max_iterations: int = 200,
    local: LocalRadii | None = None,
    on_step: Callable[[int, Array], bool | None] | None = None,
    settings: NewtonSettings | None = None,
) -> NewtonResult:
    """Minimise in the box ``lower <= x <= upper``.

    Converged means two things: the point is stationary, and the model predicts no decrease worth a
    step. On a fine mesh every point is nearly stationary, since no node matters much.

    Parameters
    ----------
    evaluate : callable
        Value, gradient and model at a point of the box; None where the function is not defined.
    tolerance : float
        Stationary: ``max |x - proj(x - g / unit)|`` is at most this, g the gradient and ``unit`` by default
        the size of the function.
    gain_tolerance : float
        No decrease: the model predicts less than this fraction of the decrease so far, which counts from
        ``reference``, by default the value at the start.
    on_step : callable, optional
        Called with the iteration and the point; the descent stops if it returns True.
    """
    use = settings or NewtonSettings()
    x = np.clip(start, lower, upper)
    current = evaluate(x)
    if current is None:
        return NewtonResult(x, Status.EVALUATION_ERROR, 0)
    reference = current.value if reference is None else reference
    radius = 0.0
    for iteration in range(max_iterations + 1):
        if on_step is not None and on_step(iteration, x):
            return NewtonResult(x, Status.INTERRUPTED, iteration)
        if iteration == max_iterations:
            break
        size = max(abs(current.value), 1e-300)
        g, model = current.gradient, current.model()
        downhill = np.clip(x - g / (unit or size), lower, upper)
        stationary = magnitude(x - downhill) <= tolerance
        # in units in which the trust region is a cube
        width = np.ones_like(x) if local is None else local.widths(x)
        low, high = (lower - x) / width, (upper - x) / width
        while True:
            step = BoxStep(Scaled(model, width), width * g, use)
            if not radius:
                gradient_step = np.clip(-g / step.scale, low, high) if local is None else 1.0
                radius = use.first_radius * magnitude(gradient_step)
            y, predicted = step.within(np.maximum(low, -radius), np.minimum(high, radius))
            enough = stationary and predicted <= gain_tolerance * (reference - current.value)
            if enough or not predicted > np.finfo(float).eps * size:  # not so of NaN
                status = Status.CONVERGED if stationary else Status.STALLED
                return NewtonResult(x, status, iteration)
            part = 1.0 if local is None else local.longest(x, width * y)
            if part < 1:
                cut = part * width * y
                predicted = -float(g @ cut + 0.5 * cut @ model(cut))
            landed = np.clip(x + part * (width * y), lower, upper)
            trial = evaluate(landed)
            ratio = -np.inf if trial is None else (current.value - trial.value) / max(predicted, 1e-300)
            if not ratio >= use.poor:
                radius = use.shrink * part * magnitude(y)
            elif part < 1:
                radius = part * radius
            elif ratio > use.good:
                radius = use.grow * radius
            if trial is not None and ratio > use.sufficient:
                x, current = landed, trial
                break
    return NewtonResult(x, Status.ITERATION_LIMIT, max_iterations)
