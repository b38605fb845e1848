"""Projected Newton-CG with a trust region for a smooth function in a box.

In the manner of TRON (C.-J. Lin, J. J. Moré, Newton's method for large bound-constrained
optimization problems, SIAM J. Optim. 9 (1999) 1100-1127): a Cauchy point, then conjugate
gradients over the variables that are free, with a projected search that lets many bounds become
active at once, again and again on the same quadratic model.

The trust region is a box too. TRON's ball stops a step where the conjugate gradients leave it
or meet negative curvature; the projection then shortens that step, so that the ball never grows
although the model is right. In a box the step ends in a corner of the trusted part of the box
instead, and the same model is used until it has nothing left to give: of the functions here, a
derivative costs as much as dozens of Hessian products.

Walls are smooth constraints that cost nothing beside the function. They are handled in the manner of feasible
sequential quadratic programming (E. R. Panier, A. L. Tits, On combining feasibility, descent and
superlinear convergence in inequality constrained optimization, Math. Programming 59 (1993) 261-276):
a step obeys their linearisation, the model has the Hessian of the Lagrangian, and what curvature
leaves of a violation is taken back before the function is evaluated. So the function itself is
the merit, there is no penalty or barrier, and a wall that is not met changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.activity import is_inside
from rmesh_nlp.optimize.constraints import Walls
from rmesh_nlp.optimize.newton_settings import NewtonSettings
from rmesh_nlp.optimize.newton_step import BoxStep, Model, WalledStep
from rmesh_nlp.optimize.status import Status


@dataclass(frozen=True)
class Evaluation:
    """Value and gradient at a point; ``model`` builds the Hessian there."""

    value: float
    gradient: Array
    model: Callable[[], Model]


@dataclass(frozen=True)
class NewtonResult:
    """Where the method stopped.

    ``crowded`` says that too many walls held a step; the status is then STALLED.
    """

    x: Array
    value: float
    status: Status
    iterations: int
    products: int
    crowded: bool = False


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
    walls: Walls | None = None,
    on_step: Callable[[int, Array, Evaluation], bool | None] | None = None,
    settings: NewtonSettings | None = None,
) -> NewtonResult:
    """Minimise in the box ``lower <= x <= upper``, and within walls if there are any.

    Converged means two things: the point is stationary, and the model sees no decrease worth a
    step. On a fine mesh every point is nearly stationary, for each node has little to say.

    Parameters
    ----------
    evaluate : callable
        Value, gradient and model at a point of the box; None where the function is not
        defined, which makes the trust region shrink.
    start, lower, upper : (n,) arrays
    tolerance : float
        Stationary: ``max |x - proj(x - g / unit)|`` is at most this, g less the pull of the walls.
    gain_tolerance : float
        No decrease: the model predicts less than this fraction of the decrease so far.
    reference : float, optional
        The value that decrease counts from; by default that at the start.
    unit : float, optional
        What the gradient is measured in; by default the size of the function.
    max_iterations : int
    walls : Walls, optional
        Constraints that ``start`` obeys.
    on_step : callable, optional
        Called with the iteration, the point and its evaluation; the descent stops if it returns True.
    settings : NewtonSettings, optional
    """
    use = settings or NewtonSettings()
    x = np.clip(start, lower, upper)
    here = evaluate(x)
    if here is None:
        return NewtonResult(x, np.nan, Status.EVALUATION_ERROR, 0, 0)
    reference, products = here.value if reference is None else reference, 0
    radius = 0.0
    model = here.model()
    domain = _Box(lower, upper, use) if walls is None else _WalledBox(lower, upper, walls, use)
    domain.arrive(x)
    before = np.inf
    for iteration in range(max_iterations + 1):
        if on_step is not None and on_step(iteration, x, here):
            return NewtonResult(x, here.value, Status.INTERRUPTED, iteration, products)
        g = here.gradient
        size = max(abs(here.value), 1e-300)
        step_down = np.clip(x - domain.released(g) / (unit or size), lower, upper)
        residual = np.max(np.abs(x - step_down), initial=0.0)
        if iteration == max_iterations:
            break
        accepted = False
        while not accepted:
            step = domain.step(model, g)
            if radius == 0.0:
                newton_like = np.clip(x - g / step.scale, lower, upper) - x
                radius = use.first_radius * float(np.max(np.abs(newton_like), initial=0.0))
            s, predicted = step.solve(
                np.maximum(lower - x, -radius), np.minimum(upper - x, radius), use.forcing
            )
            products += step.products
            if step.rows_held(s) > use.crowded:
                return NewtonResult(x, here.value, Status.STALLED, iteration, products, crowded=True)
            if residual <= tolerance and predicted <= gain_tolerance * (reference - here.value):
                return NewtonResult(x, here.value, Status.CONVERGED, iteration, products)
            creeps = isinstance(step, WalledStep) and tolerance < residual > use.creeping * before
            if creeps and predicted <= use.negligible * (reference - here.value):
                return NewtonResult(x, here.value, Status.STALLED, iteration, products)
            if not np.any(s) or predicted <= 1e-16 * size:
                status = Status.CONVERGED if residual <= tolerance else Status.STALLED
                return NewtonResult(x, here.value, status, iteration, products)
            landed = domain.land(np.clip(x + s, lower, upper), step, s)
            there = None if landed is None else evaluate(landed)
            actual = here.value - there.value if there is not None else -np.inf
            ratio = actual / predicted
            if ratio < use.poor:
                radius = use.shrink * float(np.max(np.abs(s)))
            elif ratio > use.good:
                radius = use.grow * radius
            if landed is not None and there is not None and ratio > use.sufficient:
                x, here, accepted, before = landed, there, True, residual
                model = here.model()
                domain.arrive(x)
    return NewtonResult(x, here.value, Status.ITERATION_LIMIT, max_iterations, products)


class _Box:
    """Where the method may go, seen from its last point."""

    def __init__(self, lower: Array, upper: Array, settings: NewtonSettings) -> None:
        self._lower, self._upper, self._settings = lower, upper, settings

    def arrive(self, x: Array) -> None:
        """Take note of a new point."""

    def released(self, g: Array) -> Array:
        """A gradient less the pull of the walls."""
        return g

    def step(self, model: Model, g: Array) -> BoxStep:
        """The minimiser of the model."""
        return BoxStep(model, g, self._settings.step)

    def land(self, trial: Array, step: BoxStep, s: Array) -> Array | None:
        """The point that the step ``s`` to ``trial`` leads to; None if there is none."""
        return trial


class _WalledBox(_Box):
    """The same with walls; keeps their multipliers from one step to the next.

    Steps take account of walls from when one is first met.
    """

    def __init__(self, lower: Array, upper: Array, walls: Walls, settings: NewtonSettings) -> None:
        super().__init__(lower, upper, settings)
        self._walls = walls
        self._pull: Array | None = None  # of the last step that took account of walls
        self._met = False

    def arrive(self, x: Array) -> None:
        self._x, self._wall = x, self._walls.at(x)
        self._inside = is_inside(x, self._lower, self._upper)
        self._met = self._met or bool(np.any(self._wall.slack < self._settings.close))

    def released(self, g: Array) -> Array:
        self._fitted = self._wall.fitted(g, self._inside)
        return g - self._wall.jacobian.T @ self._fitted

    def step(self, model: Model, g: Array) -> BoxStep:
        if not self._met:
            return super().step(model, g)
        pull = self._fitted if self._pull is None else self._pull
        bent = _Bent(model, self._walls.hessian(self._x, pull))
        return WalledStep(bent, g, self._wall, self._settings)

    def land(self, trial: Array, step: BoxStep, s: Array) -> Array | None:
        if isinstance(step, WalledStep):
            # of a step that will be rejected too: its rows are those that the next one meets
            self._pull = step.multipliers(s)
        landed = self._walls.back(trial, self._wall, self._lower, self._upper, step.scale)
        self._met = self._met or landed is not trial
        return landed


@dataclass(frozen=True)
class _Bent:
    """A model less the curvature of walls that pull: the Hessian of the Lagrangian."""

    model: Model
    walls: sp.csc_array

    def __call__(self, d: Array) -> Array:
        return self.model(d) - self.walls @ d

    def diagonal(self) -> Array:
        return self.model.diagonal()
