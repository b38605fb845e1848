"""Records made by hand for the tests of tables and figures: every figure in them is chosen."""

from __future__ import annotations

from typing import Any

from rmesh_nlp.io.records import REQUIRED, Record

PAPER_61: Record = {
    **dict.fromkeys(REQUIRED),
    "example": "6.1",
    "formulation": "fixed",
    "objective": "energy",
    "n": "8",
    "delta": [0.0275, 0.0275],
    "quadrature": "midpoint",
    "status": "converged",
    "success": True,
    "energy_initial": -1.1246023,
    "energy": -1.1246023,
    "energy_audited": -1.1172085,
    "gain": 0.0,
    "u_min": -0.45486,
    "u_max": 0.47528,
    "min_area_ratio": 1.0,
    "iterations": 4,
    "contact_solves": 1,
    "wall_time_s": 0.002,
    "contact_time_s": 0.0025,
    "equilibrium_residual": 5.5e-16,
    "complementarity_residual": 0.0,
    "stationarity_residual": 3.1e-2,
    "stationarity": "",
    "versions": {"python": "3.12.0"},
}


def fixed_61(**changes: Any) -> Record:
    """``fixed`` on Example 6.1 with the paper's settings."""
    return {**PAPER_61, **changes}


def joint_61(**changes: Any) -> Record:
    """``joint`` on Example 6.1 with the paper's settings."""
    moved = {
        "formulation": "joint",
        "energy": -1.4740087,
        "energy_audited": -1.4757774,
        "gain": 0.3494064,
        "u_min": -0.52152,
        "u_max": 0.52777,
        "min_area_ratio": 0.3189,
        "iterations": 45,
        "wall_time_s": 0.125,
        "stationarity_residual": 7.6e-6,
        "stationarity": "KKT",
    }
    return {**PAPER_61, **moved, **changes}


def failed_61(**changes: Any) -> Record:
    """A formulation that broke: words and settings, no figures."""
    kept = ("example", "objective", "n", "delta", "quadrature", "versions")
    return {
        **dict.fromkeys(REQUIRED),
        **{name: PAPER_61[name] for name in kept},
        "formulation": "mpcc",
        "status": "failed",
        "success": False,
        "message": "ZeroDivisionError: a | b & c",
        "stationarity": "",
        **changes,
    }
