"""Measurements of a solution that is a success in every respect."""

from __future__ import annotations

from rmesh_nlp.assessment.assessor import Audit
from rmesh_nlp.assessment.conclusion import Measured
from rmesh_nlp.optimize.status import Status

GOOD = Measured(
    audit=Audit(-1.1, 1e-9, 1e-9, 0.5, 0.0),
    contact=Status.CONVERGED,
    consistent=True,
    gain=0.1,
    gain_audited=0.1,
    gain_computed=0.1,
    decrease=0.1,
    size=1.0,
    is_energy=True,
    stationary=True,
)
