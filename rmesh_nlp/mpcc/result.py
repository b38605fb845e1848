"""What a solve returns: the point, residuals of the source problem, multipliers, labels, history."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Index, magnitude
from rmesh_nlp.mpcc.lower_level import LowerLevelCheck
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.optimize.status import Status


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """A point that a solve came to, measured on the source problem.

    Attributes
    ----------
    phase : str
        ``relaxed`` (a relaxation solved at ``t``), ``branch`` (each pair fixed on one side) or ``newton``
        (Newton steps with active sets).
    t : float
        Relaxation parameter; 0 in the finish.
    objective, constraint_violation : float
    complementarity, product : float
        Maximum over the pairs of ``min(|G|, |H|)`` and of ``|G H|``.
    biactive : int
        Pairs whose larger member is at most ``2 sqrt(t)`` (or ``Options.corner``): in a relaxed solution
        biactive pairs are found there.
    """

    phase: str
    t: float
    objective: float
    constraint_violation: float
    complementarity: float
    product: float
    biactive: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage(Measured):
    """The end of one NLP of the homotopy or of the exact finish; attributes as in ``Measured``.

    Attributes
    ----------
    iterations : int
    status : Status
        How it ended.
    seconds : float
    multiplier : float
        Largest multiplier of the relaxation's rows: positive where a relaxation with rows acts.
    """

    iterations: int = 0
    status: Status = Status.CONVERGED
    seconds: float = 0.0
    multiplier: float = 0.0

    HEADER = (
        f"{'phase':>9} {'t':>8} {'objective':>15} {'violation':>9} {'max min':>8} {'max GH':>8} "
        f"{'iter':>5} status"
    )

    def line(self) -> str:
        """One line of the log; the columns are those of ``Stage.HEADER``."""
        return (
            f"{self.phase:>9} {self.t:8.1e} {self.objective:15.8e} {self.constraint_violation:9.1e} "
            f"{self.complementarity:8.1e} {self.product:8.1e} {self.iterations:5d} {self.status.value}"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Iterate(Measured):
    """One Ipopt iteration of a relaxation or of a branch; attributes as in ``Measured``.

    Attributes
    ----------
    iteration : int
        Counted from 1 through the whole solve.
    x : array
        The point.
    """

    iteration: int
    x: Array


@np.errstate(invalid="ignore")  # inf - inf is infinitely far away
def residuals(mpcc: MPCC, x: Array, column: Array, scale: Array | float) -> dict[str, float]:
    """The fields of ``MPCCResult`` that say how far a point is from a solution.

    ``column`` is ``vertcat(g, G, H)`` there, whose rows are measured in units of ``scale``.
    """
    lower = np.append(mpcc.lbg, np.zeros(2 * mpcc.n_pairs)) / scale
    upper = np.append(mpcc.ubg, np.full(2 * mpcc.n_pairs, np.inf)) / scale
    rows = column / scale
    pairs = np.abs(rows[mpcc.n_g :]).reshape(2, -1)
    return {
        "constraint_violation": max(excess(x, mpcc.lbx, mpcc.ubx), excess(rows, lower, upper)),
        "complementarity": magnitude(np.min(pairs, axis=0)),
        "product": magnitude(np.prod(pairs, axis=0)),
    }


def beyond(value: Array, lower: Array | float, upper: Array | float) -> Array:
    """Distances of values from ``[lower, upper]``."""
    return np.maximum(np.maximum(lower - value, value - upper), 0.0)


def excess(value: Array, lower: Array | float, upper: Array | float) -> float:
    """Largest distance of ``value`` from ``[lower, upper]``; infinite where it is NaN."""
    worst = magnitude(beyond(value, lower, upper))
    return worst if np.isfinite(worst) else np.inf


def is_same(f: float, other: float) -> bool:
    """Whether two objectives are taken for those of one point, or of one trajectory at the same t."""
    return bool(np.isclose(f, other, rtol=1e-4, atol=1e-4))


def in_words(stationarity: str, b_stationary: bool | None, n_biactive: int) -> str:
    """A stationarity label, and what it means with so many biactive pairs."""
    if stationarity == "S" and n_biactive == 0:
        return "S (no biactive pair: a KKT point)"
    b_word = {True: "B-stationary", False: "not B-stationary", None: "B not computed"}[b_stationary]
    pairs = f"{n_biactive} biactive pair{'' if n_biactive == 1 else 's'}"
    if stationarity.startswith("at least"):
        stationarity = f"undecided, {stationarity}"
    return f"{stationarity or 'no label'} ({pairs}, {b_word})"


@dataclass(frozen=True, eq=False)
class Duals:
    """Multipliers of ``f + lam_x^T x + lam_g^T g + lam_G^T G + lam_H^T H`` to start from."""

    lam_x: Array
    lam_g: Array
    lam_G: Array  # noqa: N815 the field's symbol
    lam_H: Array  # noqa: N815


def shift(result: MPCCResult, blocks: int) -> tuple[Array, Duals]:
    """A result moved one stage ahead, as ``x0`` and ``start`` of the next solve over a receding horizon.

    The unknowns, ``g`` and the pairs each end with ``blocks`` stages of equal length. The last stage is
    repeated, and what stands before the stages is kept.

    Raises
    ------
    BadInputError
        If ``blocks`` is not a positive whole number.
    """
    if not isinstance(blocks, int) or blocks < 1:
        raise BadInputError(f"blocks must be a positive whole number, got {blocks!r}")

    def ahead(values: Array) -> Array:
        n = values.size // blocks
        first = values.size - n * blocks
        return np.concatenate([values[:first], values[first + n :], values[values.size - n :]])

    names = ("lam_x", "lam_g", "lam_G", "lam_H")
    return ahead(result.x), Duals(*(ahead(getattr(result, name)) for name in names))


@dataclass(frozen=True)
class Reached:
    """Where some of several starts ended: objective (NaN without success), status, number of starts."""

    f: float
    status: Status
    starts: int

    def __str__(self) -> str:
        where = "" if np.isnan(self.f) else f"f = {self.f:.8g}, "
        return f"{self.starts} {where}{self.status.value}"


@dataclass(frozen=True, eq=False)
class MPCCResult:
    """A solution of an MPCC and everything that was measured on it.

    Attributes
    ----------
    x : array
        The point.
    f : float
        The objective there.
    status : Status
        How it ended.
    success : bool
        True only if feasible, complementary and stationary within the tolerances, all measured
        on the source problem.
    message : str
        One sentence for people.
    constraint_violation : float
        Largest violation of bounds, of ``g`` and of ``G, H >= 0`` (absolute).
    complementarity : float
        Maximum over the pairs of ``min(|G|, |H|)`` (absolute).
    product : float
        Maximum over the pairs of ``|G H|``.
    stationarity : str
        ``"S"``, ``"M"``, ``"C"`` or ``"W"``: the strongest for which multipliers were shown to
        exist; ``"none"`` if they were sought and do not exist, ``""`` if nothing was computed.
        ``"at least C"`` if a search for more ran out of nodes.
    b_stationary : bool or None
        Whether no linearised feasible direction descends, over all branches of the biactive set.
        None: not computed.
    lam_x, lam_g, lam_G, lam_H : arrays
        Multipliers of ``f + lam_x^T x + lam_g^T g + lam_G^T G + lam_H^T H`` (an active lower bound has a
        non-positive one): those that prove ``stationarity``. NaN if there are none. A lower bound
        ``x_j >= 0`` of an unknown that is itself a member of a pair is counted with the pair.
    G, H, g : arrays
        Values at ``x``.
    biactive : int array
        Pairs with ``G = H = 0`` within the activity tolerance; ``n_biactive`` is their number. With none of
        them S says no more than that the point is a KKT point of the one branch it lies in, see ``label``.
    history : tuple of Stage
        The NLPs that were solved, in their order.
    counts : mapping
        ``nlp_solves``, ``ipopt_iterations``, ``pivots``, ...
    seconds : mapping
        Wall time: ``total`` is the sum of ``build``, ``homotopy`` (relaxed NLPs) and ``finish``: all else,
        branches, labels, linear and mixed-integer programs.
    curvature : str
        Of the Lagrangian along what is active: ``"not negative"``, ``"negative"`` (a saddle beside which no
        lower point was found), or ``"not tested"`` (not S, more than 10,000 unknowns with slacks, no Hessian,
        or undecided where something active has no multiplier).
    ends : tuple of MPCCResult
        The results of several starts, in their order; the first is from the given start. A start whose
        trajectory came upon a former one has that one's result. The result itself is the best one; its
        ``counts`` and ``seconds`` are sums over all starts.
    lower_level : LowerLevelCheck, optional
        Of a bilevel program: whether its lower level is at a minimum. Without success where it is not.
    """

    x: Array
    f: float
    status: Status
    success: bool
    message: str
    constraint_violation: float
    complementarity: float
    product: float
    stationarity: str
    b_stationary: bool | None
    lam_x: Array
    lam_g: Array
    lam_G: Array  # noqa: N815 the field's symbol
    lam_H: Array  # noqa: N815
    g: Array
    G: Array
    H: Array
    biactive: Index
    history: tuple[Stage, ...]
    counts: Mapping[str, int]
    seconds: Mapping[str, float]
    lower_level: LowerLevelCheck | None = None
    curvature: str = "not tested"
    ends: tuple[MPCCResult, ...] = ()

    @property
    def n_biactive(self) -> int:
        """Number of biactive pairs."""
        return self.biactive.size

    @property
    def label(self) -> str:
        """The stationarity in words: the letter, and what it means here."""
        return in_words(self.stationarity, self.b_stationary, self.n_biactive)

    @property
    def reached(self) -> tuple[Reached, ...]:
        """What several starts ended at: objectives, the lowest first, then statuses without success."""
        reached: list[Reached] = []
        for end in sorted(self.ends, key=lambda r: (not r.success, r.f if r.success else 0.0)):
            last, f = reached[-1] if reached else None, end.f if end.success else np.nan
            if last is not None and last.status is end.status and (not end.success or is_same(f, last.f)):
                reached[-1] = replace(last, starts=last.starts + 1)
            else:
                reached.append(Reached(f, end.status, 1))
        return tuple(reached)

    def table(self) -> str:
        """The history as text, one line per NLP solve."""
        return "\n".join([Stage.HEADER, *(step.line() for step in self.history)])

    def columns(self) -> dict[str, list[object]]:
        """The history by column, ready for ``pandas.DataFrame``."""
        return {f.name: [getattr(step, f.name) for step in self.history] for f in fields(Stage)}

    def __str__(self) -> str:
        return (
            f"{self.status.value}: f = {self.f:.10g}, violation {self.constraint_violation:.1e}, "
            f"complementarity {self.complementarity:.1e}, stationarity {self.label}"
            + ("" if self.lower_level is None else f"; lower level: {self.lower_level}")
            + ("" if not self.reached else f"; starts: {'; '.join(map(str, self.reached))}")
        )
