"""How a solve ended, in one word and in one sentence."""

from __future__ import annotations

from enum import Enum


class Status(str, Enum):
    """How a solve ended. The value is a word for tables, ``message`` a sentence for people."""

    message: str

    def __new__(cls, word: str, message: str) -> Status:
        """A member whose value is the word alone."""
        member = str.__new__(cls, word)
        member._value_, member.message = word, message
        return member

    CONVERGED = "converged", "Converged to the tolerance."
    ACCEPTABLE = "acceptable", "Converged to the looser, acceptable tolerance only."
    ITERATION_LIMIT = "iteration_limit", "Stopped at the iteration limit."
    TIME_LIMIT = "time_limit", "Stopped at the time limit."
    INTERRUPTED = "interrupted", "Stopped by the user; the best valid point so far is kept."
    INFEASIBLE = "infeasible", "Locally infeasible: at a local minimum of the violation."
    VIOLATED = "violated", "A constraint of the problem does not hold."
    UNBOUNDED = "unbounded", "The iterates diverge: the problem may be unbounded."
    STALLED = "stalled", "Progress ended, or became too slow, before the tolerance was met."
    CYCLED = "cycled", "The active set repeated itself without a solution."
    INACCURATE = (
        "inaccurate",
        "A residual of the problem is above its tolerance, or the solver's energy is wrong.",
    )
    NOT_STATIONARY = (
        "not_stationary",
        "The solver met its own test, but not the tolerance of the first-order residual.",
    )
    NO_MINIMUM = "no_minimum", "Stationary, but the lower level is at no minimum."
    WORSE = "worse", "The minimised objective, measured accurately, is above its value on the given mesh."
    EXPLOITED = (
        "exploited",
        "Only an error of the discretisation lowered the energy: the continuous one rose.",
    )
    UNAUDITED = "unaudited", "The solver's solution alone, not compared with the given mesh."
    INVALID_MESH = "invalid_mesh", "An element is inverted or smaller than allowed."
    TOO_FEW_FREEDOMS = "too_few_freedoms", "There are more equations than free unknowns."
    EVALUATION_ERROR = "evaluation_error", "A function returned NaN or infinity."
    FAILED = "failed", "The solver failed."


NOT_STATIONARY_YET = "valid and not worse than the given mesh, but not stationary to the tolerance"
"""What a success is that did not converge."""


def success_in_words(success: bool, status: Status) -> str:
    """Whether a solve succeeded, and what its result lacks if it did not converge."""
    if not success:
        return "no"
    return "yes" if status is Status.CONVERGED else f"yes: {NOT_STATIONARY_YET}"
