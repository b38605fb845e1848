"""What a solve returns: what it found, with its record, its table for people and its pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from rmesh_nlp.display import Rows, Shown
from rmesh_nlp.settings import Values
from rmesh_nlp.solving.entries import ENTRIES
from rmesh_nlp.solving.entry import KNOWN
from rmesh_nlp.solving.parts import plain
from rmesh_nlp.solving.relocated import Relocated
from rmesh_nlp.solving.summary import summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(Relocated, Shown):
    """A relocated mesh with its contact solution, as it was assessed, and how it was found."""

    def record(self) -> Values:
        """The entries of :mod:`rmesh_nlp.solving.entries` that it has, as plain JSON values. NaN is None."""
        terms, seconds = self.error_terms
        trace = replace(self.trace, audit_time_s=self.trace.audit_time_s + seconds)
        timed = replace(self, trace=trace)
        values = {name: entry.value(timed) for name, entry in ENTRIES.items() if entry.of is not None}
        written = {
            name: value
            for name, value in values.items()
            if value is not None or ENTRIES[name].presence is not KNOWN
        }
        return plain({**written, **terms, **self.details, **self.assessment.first_order.label})

    def plot(self, what: str = "mesh", axes: Axes | None = None, **style: Any) -> Axes:
        """Draw a field of the solution on the relocated mesh.

        Parameters
        ----------
        what : "mesh", "displacement", "stress" or "pressure"
            The mesh over the given one; the displacement or its size; von Mises' stress or the
            size of the flux; the pressure along the contact boundary.
        axes : matplotlib Axes, optional
            Where to draw; a new figure by default.
        style
            Keywords of matplotlib's function that draws, such as ``cmap`` or ``color``.
        """
        from rmesh_nlp.solving import plotting  # matplotlib takes a while to load

        X, final = self.mesh.p, self.final
        return plotting.plot(self.problem, X, final.displacement, final.pressure, what, axes, **style)

    def summary(self) -> Rows:
        """Status, what was minimised, and measured residuals, as (label, value) rows for people."""
        return summary(self)

    @property
    def title(self) -> str:
        """What it is, for people."""
        return f"Solution of {self.problem.name!r} by {self.formulation}"
