"""Numbers of the Newton methods: frozen, checked, and with where they come from."""

from __future__ import annotations

from dataclasses import dataclass, field

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.optimize.activity import ROW_OF_A_STEP
from rmesh_nlp.settings import Count, Factor, Part, Positive, Settings


@dataclass(frozen=True)
class TrustRegionSettings(Settings):
    """How a trust region follows its model.

    See A. R. Conn, N. I. M. Gould, Ph. L. Toint, Trust-region methods, SIAM 2000, section 6.1.

    Attributes
    ----------
    sufficient : float
        Least ratio of actual to predicted decrease of an accepted step.
    poor, good : float
        Ratios below and above which the trust region shrinks and grows.
    shrink, grow : float
        Its factors then.
    """

    sufficient: Positive = 1e-4
    poor: Positive = 0.25
    good: Part = 0.75
    shrink: Part = 0.25
    grow: Factor = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sufficient <= self.poor < self.good:
            raise BadInputError(
                "a trust region needs sufficient <= poor < good, got "
                f"{self.sufficient!r}, {self.poor!r} and {self.good!r}"
            )


@dataclass(frozen=True)
class StepSettings(Settings):
    """The minimisation of one quadratic model (:mod:`rmesh_nlp.optimize.newton_step`).

    Attributes
    ----------
    max_products : int
        Hessian products of one step. On 6.1 with 128 squares a side they take 0.7 of the time of a step.
    max_products_walled : int
        The same along area constraints: there the conjugate gradients, not the model, are what stops a step.
    worthwhile : float
        Least part of a step's decrease that the last round of conjugate gradients must give.
    overshoot : float
        How far beyond the trust region, in its widths, a direction is followed before it is projected.
    decrease : float
        Least part of the slope that a Cauchy point and a projected search give: mu_0 of Lin and Moré.
    shorten_cauchy, shorten : float
        Factors of the steps that are tried then.
    searches : int
        Lengths that a projected search tries.
    """

    max_products: Count = 40
    max_products_walled: Count = 250
    worthwhile: Part = 0.06
    overshoot: Positive = 2.0
    decrease: Part = 0.01
    shorten_cauchy: Part = 0.25
    shorten: Part = 0.5
    searches: Count = 30


@dataclass(frozen=True)
class ProjectionSettings(Settings):
    """Projections on linearised area constraints (:mod:`rmesh_nlp.optimize.constraints`).

    Attributes
    ----------
    max_steps : int
        Newton steps on the dual of a projection, one factorisation each.
    exact : float
        Violation of a row at which its projection ends.
    held : float
        Value of a row at which it counts as active; also the violation that a step may have.
    regular : float
        Part of a row's own coupling that is added to it: the rows of one element may depend on each other.
    damping : float
        First such part where a Newton step does not raise the dual enough.
    damping_up, damping_down : float
        Factors of the damping after a step that failed, and after one that did not.
    shorten : float
        Factor between the parts of a Newton step that are tried before it is damped.
    searches : int
        How many are tried.
    sufficient : float
        Least part of the slope of the dual that an accepted step gives (Armijo's rule).
    """

    max_steps: Count = 200
    exact: Positive = 1e-10
    held: Positive = ROW_OF_A_STEP
    regular: Positive = 1e-10
    damping: Positive = 1e-4
    damping_up: Factor = 10.0
    damping_down: Part = 0.01
    shorten: Part = 0.3
    searches: Count = 8
    sufficient: Part = 1e-4


@dataclass(frozen=True)
class NewtonSettings(TrustRegionSettings):
    """Projected Newton-CG in a box (:mod:`rmesh_nlp.optimize.trust_region`), in a trust region.

    docs/notes/speed.md has the benchmarks on the paper's examples that chose the method.

    Attributes
    ----------
    forcing : float
        Conjugate gradients stop at this part of the residual they began with.
    first_radius : float
        First half-width of the trust region, as a part of the longest move of the scaled gradient step.
    close : float
        Slack at which an area constraint counts as met, and from when on steps take account of them. If
        they always do, Newton-CG ends the paper's 6.2 at -4.90994 in place of -4.91034.
    crowded : int
        Area constraints that hold one step beyond which the descent gives up: projections on so many cost
        more than the rest of a step, and conjugate gradients along them crawl.
    negligible, creeping : float
        Where area constraints have been met it gives up too if the model predicts less than the first part of
        the decrease so far, and the last step has left more than the second part of the residual.
    step : StepSettings
    projection : ProjectionSettings
    """

    forcing: Part = 0.1
    first_radius: Positive = 0.5
    close: Positive = 1e-2
    crowded: Count = 20
    negligible: Part = 1e-10
    creeping: Part = 0.8
    step: StepSettings = field(default_factory=StepSettings)
    projection: ProjectionSettings = field(default_factory=ProjectionSettings)


@dataclass(frozen=True)
class LocalNewtonSettings(TrustRegionSettings):
    """Newton-CG with a trust region for each variable (:mod:`rmesh_nlp.optimize.local_newton`).

    docs/notes/large_moves.md has the benchmarks that chose the method.

    Attributes
    ----------
    grow : float
        See :class:`TrustRegionSettings`.
    forcing : float
        Conjugate gradients stop at this part of the residual they began with.
    first : float
        First radius, in widths.
    least : float
        Radius at which the descent gives up.
    hidden : float
        Part of the variables that may end a step at the edge of the region without its hiding a decrease.
    rounding : float
        Error of the function relative to its value (A. R. Conn, N. I. M. Gould, Ph. L. Toint, Trust-region
        methods, SIAM 2000, section 17.4.2).
    nothing : float
        Predicted decrease, relative to the value, below which a point is stationary.
    step : StepSettings
    """

    grow: Factor = 2.0
    forcing: Part = 0.1
    first: Positive = 1.0
    least: Part = 1e-6
    hidden: Part = 0.05
    rounding: Part = 1e-14
    nothing: Part = 1e-20
    step: StepSettings = field(default_factory=StepSettings)
