"""Two records of Example 6.2, one of them of a formulation that broke, for the tests of tables and notes."""

from __future__ import annotations

from typing import Any

from rmesh_nlp.io.records import REQUIRED


def record(**changes: Any) -> dict[str, Any]:
    """A row of Example 6.2 by joint with the paper's settings."""
    row = {
        **dict.fromkeys(REQUIRED),
        "key": "6.2-12x6-joint",
        "example": "6.2",
        "formulation": "joint",
        "objective": "energy",
        "n": "12x6",
        "delta": [0.15667, 0.07333],
        "quadrature": "midpoint",
        "status": "converged",
        "success": True,
        "message": "Converged to the tolerance.",
        "energy_initial": -4.854190196,
        "energy": -4.910329789,
        "energy_initial_audited": -4.854190196,
        "energy_audited": -4.910329789,
        "gain": 0.056139593,
        "gain_audited": 0.056139593,
        "start": "given",
        "build_time_s": 0.02,
        "solve_time_s": 0.06,
        "audit_time_s": 0.003,
        "own_equilibrium_residual": 3.1e-9,
        "assessed_equilibrium_residual": 4.7e-13,
        "own_complementarity_residual": 2e-10,
        "assessed_complementarity_residual": 0.0,
        "biactive_nodes": [],
        "u_min": -0.053583,
        "u_max": 0.0094881,
        "min_area_ratio": 0.13213,
        "iterations": 44,
        "contact_solves": 3,
        "cold_contact_solves": 1,
        "contact_factorisations": 7,
        "kkt_factorisations": 44,
        "wall_time_s": 0.083,
        "contact_time_s": 0.004,
        "equilibrium_residual": 4.7e-13,
        "complementarity_residual": 0.0,
        "stationarity": "KKT",
        "stationarity_residual": 2.94e-6,
        "versions": {"python": "3.11"},
    }
    return row | changes


UNKNOWN = (
    "stationarity_residual",
    "contact_time_s",
    *("energy_initial_audited", "gain_audited", "start", "build_time_s", "solve_time_s", "audit_time_s"),
    *("own_equilibrium_residual", "assessed_equilibrium_residual", "biactive_nodes"),
    *("own_complementarity_residual", "assessed_complementarity_residual"),
    *("cold_contact_solves", "contact_factorisations", "kkt_factorisations"),
)
MEASURED = [name for name in REQUIRED[REQUIRED.index("energy_initial") :] if name not in ("versions", "seed")]
FAILED = dict.fromkeys((*MEASURED, *UNKNOWN)) | {"wall_time_s": 0.083}
ROWS = [
    record(),
    record(
        formulation="mpcc",
        status="failed",
        success=False,
        message="RuntimeError: 100% & more_",
        **FAILED,
    ),
]
