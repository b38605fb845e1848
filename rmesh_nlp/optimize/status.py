"""How a solve ended, in one word and in one sentence."""

from __future__ import annotations

from enum import Enum


class Status(str, Enum):
    """How a solve ended. The value is a word for tables, ``message`` a sentence for people."""

    CONVERGED = "converged"
    ACCEPTABLE = "acceptable"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    INTERRUPTED = "interrupted"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    STALLED = "stalled"
    CYCLED = "cycled"
    INACCURATE = "inaccurate"
    NOT_STATIONARY = "not_stationary"
    WORSE = "worse"
    EXPLOITED = "exploited"
    INVALID_MESH = "invalid_mesh"
    TOO_FEW_FREEDOMS = "too_few_freedoms"
    EVALUATION_ERROR = "evaluation_error"
    FAILED = "failed"

    @property
    def message(self) -> str:
        """One sentence that says what the status means."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.CONVERGED: "Converged to the tolerance.",
    Status.ACCEPTABLE: "Converged to the looser, acceptable tolerance only.",
    Status.ITERATION_LIMIT: "Stopped at the iteration limit.",
    Status.TIME_LIMIT: "Stopped at the time limit.",
    Status.INTERRUPTED: "Stopped by the user; the best valid point so far is kept.",
    Status.INFEASIBLE: "Converged to a point of local infeasibility.",
    Status.UNBOUNDED: "The iterates diverge: the problem may be unbounded.",
    Status.STALLED: "No further progress was possible before the tolerance was met.",
    Status.CYCLED: "The active set repeated itself without a solution.",
    Status.INACCURATE: "A residual of the problem is above its tolerance, or the solver's energy is wrong.",
    Status.NOT_STATIONARY: "The solver met its own test, but not the tolerance of the first-order residual.",
    Status.WORSE: "The minimised objective, measured accurately, is above its value on the given mesh.",
    Status.EXPLOITED: "Only an error of the discretisation lowered the energy: the continuous one rose.",
    Status.INVALID_MESH: "An element is inverted or smaller than allowed.",
    Status.TOO_FEW_FREEDOMS: "There are more equations than free unknowns.",
    Status.EVALUATION_ERROR: "A function returned NaN or infinity.",
    Status.FAILED: "The solver failed.",
}

NOT_STATIONARY_YET = "valid and not worse than the given mesh, but not stationary to the tolerance"
"""What a success is that did not converge."""


def success_in_words(success: bool, status: Status) -> str:
    """Whether a solve succeeded, and what its result lacks if it did not converge."""
    if not success:
        return "no"
    return "yes" if status is Status.CONVERGED else f"yes: {NOT_STATIONARY_YET}"


class StoppedError(Exception):
    """Raised by a callback to abort a solver."""
