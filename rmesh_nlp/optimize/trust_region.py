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

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.newton_step import (
    MAX_PRODUCTS,
    BoxStep,
    Model,
    scaled,
)
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.settings import Count, Factor, Part, Positive, Settings

NOTHING, NOTHING_LOCAL = 1e-16, 1e-20
"""Predicted decrease, relative to the value, below which no step follows; with local radii the second one."""

LEAST_RADIUS = 1e-6
"""Local radius, in widths, at which a descent gives up."""

FUNCTION_ERROR = 1e-14
"""Error of a function with local radii, relative to its value: near the end both decreases are rounding, and
then count as alike (A. R. Conn, N. I. M. Gould, Ph. L. Toint, Trust-region methods, SIAM 2000, 17.4.2)."""


@dataclass(frozen=True)
class NewtonSettings(Settings):
    """Settings of the descents.

    For the ratios see A. R. Conn, N. I. M. Gould, Ph. L. Toint, Trust-region methods, SIAM 2000, section 6.1;
    docs/notes/speed.md and docs/notes/large_moves.md have the benchmarks that chose the method.

    Attributes
    ----------
    sufficient : float
        Least ratio of actual to predicted decrease of an accepted step.
    poor, good : float
        Ratios below and above which the trust region shrinks and grows.
    shrink, grow : float
        Its factors then.
    forcing : float
        Conjugate gradients stop at this part of the residual they began with.
    first_radius : float
        First half-width of the trust region, as a part of the longest component of the scaled gradient step;
        of local radii, in widths.
    max_products : int
        Hessian products of one step.
    """

    sufficient: Positive = 1e-4
    poor: Positive = 0.25
    good: Part = 0.75
    shrink: Part = 0.25
    grow: Factor = 4.0
    forcing: Part = 0.1
    first_radius: Positive = 0.5
    max_products: Count = MAX_PRODUCTS

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sufficient <= self.poor < self.good:
            raise BadInputError(
                "a trust region needs sufficient <= poor < good, got "
                f"{self.sufficient!r}, {self.poor!r} and {self.good!r}"
            )


LOCAL = NewtonSettings(grow=2.0, first_radius=1.0)
"""Settings of descents with local radii."""


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
    value: float
    status: Status
    iterations: int
    products: int


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
    on_step: Callable[[int, Array, Evaluation], bool | None] | None = None,
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
        Called with the iteration, the point and its evaluation; the descent stops if it returns True.
    """
    use = settings or (NewtonSettings() if local is None else LOCAL)
    domain = _Box(lower, upper, use) if local is None else _LocalBox(lower, upper, use, local)
    x = np.clip(start, lower, upper)
    current = evaluate(x)
    if current is None:
        return NewtonResult(x, np.nan, Status.EVALUATION_ERROR, 0, 0)
    reference, products = current.value if reference is None else reference, 0
    radius = 0.0
    for iteration in range(max_iterations + 1):
        if on_step is not None and on_step(iteration, x, current):
            return NewtonResult(x, current.value, Status.INTERRUPTED, iteration, products)
        if iteration == max_iterations:
            break
        size = max(abs(current.value), 1e-300)
        domain.arrive(x, current)
        downhill = np.clip(x - current.gradient / (unit or size), lower, upper)
        residual = float(np.max(np.abs(x - downhill), initial=0.0))
        stationary = residual <= tolerance
        while True:
            step = domain.step()
            radius = radius or domain.first_radius(step)
            y, predicted = step.within(*domain.trusted(radius), use.forcing)
            products += step.products
            gained, nothing = reference - current.value, predicted <= domain.nothing * size
            enough = predicted <= gain_tolerance * gained
            if stationary and (enough or nothing):
                return NewtonResult(x, current.value, Status.CONVERGED, iteration, products)
            if nothing or radius < domain.least_radius:
                return NewtonResult(x, current.value, Status.STALLED, iteration, products)
            part, predicted = domain.cut(y, predicted)
            products += part < 1
            landed = domain.land(part, y)
            trial = evaluate(landed)
            ratio, rounding = -np.inf, domain.rounding * size
            if trial is not None:
                ratio = (current.value - trial.value + rounding) / (max(predicted, 0.0) + rounding)
            if not ratio >= use.poor:
                radius = use.shrink * part * float(np.max(np.abs(y)))
            elif part < 1:
                radius = max(part * radius, domain.least_radius)
            elif ratio > use.good:
                radius = use.grow * radius
            if trial is not None and ratio > use.sufficient:
                x, current = landed, trial
                break
    return NewtonResult(x, current.value, Status.ITERATION_LIMIT, max_iterations, products)


class _Box:
    """Where the method may go, seen from its last point, in units in which the trust region is a cube."""

    nothing, rounding, least_radius = NOTHING, 0.0, 0.0

    def __init__(self, lower: Array, upper: Array, settings: NewtonSettings) -> None:
        self._lower, self._upper, self.settings = lower, upper, settings
        self._width: Array | float = 1.0

    def arrive(self, x: Array, evaluation: Evaluation) -> None:
        """Take note of a new point."""
        self._x, self._g, self._model = x, evaluation.gradient, evaluation.model()

    def first_radius(self, step: BoxStep) -> float:
        gradient_step = np.clip(self._x - self._g / step.scale, self._lower, self._upper) - self._x
        return self.settings.first_radius * float(np.max(np.abs(gradient_step), initial=0.0))

    def trusted(self, radius: float) -> tuple[Array, Array]:
        """Bounds of a step."""
        low, high = (self._lower - self._x) / self._width, (self._upper - self._x) / self._width
        return np.maximum(low, -radius), np.minimum(high, radius)

    def step(self) -> BoxStep:
        """The minimiser of the model."""
        return BoxStep(self._model, self._g, self.settings.max_products)

    def cut(self, y: Array, predicted: float) -> tuple[float, float]:
        """Part of a step that stays in the domain, and the decrease that the model predicts of it."""
        return 1.0, predicted

    def land(self, part: float, y: Array) -> Array:
        """The point that a step leads to."""
        return np.clip(self._x + part * (self._width * y), self._lower, self._upper)


class _LocalBox(_Box):
    """The same with a radius for each variable."""

    nothing, rounding, least_radius = NOTHING_LOCAL, FUNCTION_ERROR, LEAST_RADIUS

    def __init__(self, lower: Array, upper: Array, settings: NewtonSettings, local: LocalRadii) -> None:
        super().__init__(lower, upper, settings)
        self._local = local

    def arrive(self, x: Array, evaluation: Evaluation) -> None:
        super().arrive(x, evaluation)
        self._width = self._local.widths(x)

    def first_radius(self, step: BoxStep) -> float:
        return self.settings.first_radius

    def step(self) -> BoxStep:
        model, slope = scaled(self._model, np.asarray(self._width)), self._width * self._g
        return BoxStep(model, slope, self.settings.max_products)

    def cut(self, y: Array, predicted: float) -> tuple[float, float]:
        part = self._local.longest(self._x, self._width * y)
        if part < 1:
            s = part * (self._width * y)
            predicted = -float(self._g @ s + 0.5 * s @ self._model(s))
        return part, predicted
