"""The verdict on a point: its label, whether it is B-stationary, and if not, where f descends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import IntArray, Lifted
from rmesh_nlp.mpcc.linearisation import Linearisation, linearisation
from rmesh_nlp.mpcc.lpec import Direction, descent
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.programs import Programs
from rmesh_nlp.mpcc.stationarity import Label, label, witness
from rmesh_nlp.optimize.status import Status


@dataclass(frozen=True, eq=False)
class Verdict:
    """What was computed about a point.

    Attributes
    ----------
    label : Label
    b_stationary : bool or None
        None if the LPEC could not be decided within its limits.
    direction : Direction or None
        A linearised descent direction, where there is one.
    """

    label: Label
    b_stationary: bool | None
    direction: Direction | None

    @property
    def status(self) -> Status:
        """CONVERGED if B-stationary and labelled; ACCEPTABLE with a label but B undecided; else STALLED.

        Without a label (its linear programs failed) nothing is proven, so it is never a success.
        """
        if self.label.name == "":
            return Status.STALLED
        if self.b_stationary:
            return Status.CONVERGED
        undecided = self.b_stationary is None and self.label.multipliers is not None
        return Status.ACCEPTABLE if undecided else Status.STALLED


def judge(
    lifted: Lifted,
    lin: Linearisation,
    tolerance: float,
    multipliers: tuple[Array, Array] | None = None,
    seconds: float = np.inf,
) -> Verdict:
    """Label a linearised point; ``multipliers`` of an NLP (rows, z) may save the linear programs.

    ``seconds`` is what a user's time limit leaves; without one nothing here depends on the clock.
    """
    found = None if multipliers is None else witness(lifted, lin, *multipliers, tolerance)
    found = found or label(lifted, lin, tolerance, seconds)
    if found.name == "S":  # S implies B
        return Verdict(found, True, None)
    direction = descent(lifted, lin, seconds)
    if direction is None:
        return Verdict(found, None, None)
    if direction.decrease >= -tolerance * lin.scale:
        return Verdict(found, True, None)
    return Verdict(found, False, direction)


@dataclass(frozen=True, eq=False)
class Classification:
    """Stationarity of a given point.

    Attributes
    ----------
    stationarity : str
        As in ``MPCCResult``: the strongest of S, M, C, W, or ``"none"``; ``""`` if infeasible.
    b_stationary : bool or None
    feasible : bool
        Within the scaled tolerances of ``Options``; an infeasible point gets no label.
    biactive : int array
    """

    stationarity: str
    b_stationary: bool | None
    feasible: bool
    biactive: IntArray


def classify(
    mpcc: MPCC, x: ArrayLike, *, p: ArrayLike = (), options: Options | None = None
) -> Classification:
    """Label a given feasible point, without solving anything but linear programs.

    Raises
    ------
    ValueError
        If ``x`` or ``p`` has the wrong length or is not finite.
    """
    settings = options or Options()
    programs = Programs(mpcc, settings)
    parameters = mpcc.parameters(p)
    point = mpcc.start(x, parameters)
    z = programs.lifted.start(point, parameters)
    parameters = np.append(parameters, programs.lifted.weight(point, parameters))
    if programs.excess(z, parameters) > 1.0:
        return Classification("", None, False, np.zeros(0, dtype=np.int64))
    lin = linearisation(programs.lifted, z, parameters, settings.activity, settings.corner)
    verdict = judge(programs.lifted, lin, settings.stationarity)
    return Classification(verdict.label.name, verdict.b_stationary, True, lin.biactive)
