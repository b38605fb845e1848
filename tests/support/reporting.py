"""Records made by hand for the tests of tables and figures: every figure in them is chosen."""

from pathlib import Path
from typing import Any

from rmesh_nlp.io.records import REQUIRED, Record
from rmesh_nlp.io.results import Result, single_result
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.study.runner import Done

FIXED_61: Record = {
    **dict.fromkeys(REQUIRED),
    **{"example": "6.1", "formulation": "fixed", "objective": "energy", "n": "8", "delta": [0.0275, 0.0275]},
    **{"quadrature": "midpoint", "status": "converged", "success": True, "versions": {"python": "3.12.0"}},
    **{"energy_initial": -1.1246023, "energy": -1.1246023, "energy_audited": -1.1172085, "gain": 0.0},
    **{"u_min": -0.45486, "u_max": 0.47528, "min_area_ratio": 1.0, "iterations": 4, "contact_solves": 1},
    **{"wall_time_s": 0.002, "contact_time_s": 0.0025, "equilibrium_residual": 5.5e-16},
    **{"complementarity_residual": 0.0, "stationarity_residual": 3.1e-2, "stationarity": ""},
}
JOINT_61: Record = {
    **FIXED_61,
    **{"formulation": "joint", "energy": -1.4740087, "energy_audited": -1.4757774, "gain": 0.3494064},
    **{"u_min": -0.52152, "u_max": 0.52777, "min_area_ratio": 0.3189, "iterations": 45},
    **{"wall_time_s": 0.125, "stationarity_residual": 7.6e-6, "stationarity": "KKT"},
}
KEPT = ("example", "objective", "n", "delta", "quadrature", "versions")
JOINT_62: Record = {
    **FIXED_61,
    **{"key": "6.2-12x6-joint", "example": "6.2", "formulation": "joint", "n": "12x6"},
    **{"delta": [0.15667, 0.07333], "message": "Converged to the tolerance."},
    **{"energy_initial": -4.854190196, "energy": -4.910329789, "gain": 0.056139593, "gain_audited": 0.056},
    **{"energy_initial_audited": -4.854190196, "energy_audited": -4.910329789, "start": "given"},
    **{"build_time_s": 0.02, "solve_time_s": 0.06, "audit_time_s": 0.003, "wall_time_s": 0.083},
    **{"own_equilibrium_residual": 3.1e-9, "equilibrium_residual": 4.7e-13},
    **{"own_complementarity_residual": 2e-10, "complementarity_residual": 0.0},
    **{"biactive_nodes": [], "u_min": -0.053583, "u_max": 0.0094881, "min_area_ratio": 0.13213},
    **{"resultant": 132.25, "peak_pressure": 171.5},
    **{"iterations": 44, "contact_solves": 3, "cold_contact_solves": 1, "contact_factorisations": 7},
    **{"kkt_factorisations": 44, "contact_time_s": 0.004, "stationarity": "KKT"},
    **{"stationarity_residual": 2.94e-6},
}


DESIGNED: Record = {
    **JOINT_62,
    **{"key": "seal-mpcc", "example": "seal", "formulation": "mpcc", "n": "128 triangles"},
    **{"delta": [0.0, 0.0], "objective": "level-pressure(face)", "units": {"length": "mm", "force": "N"}},
    **{"objective_initial": 2.5, "objective_value": 1e-3, "gain_surviving": 0.96, "stationarity": "S"},
    **{"design": {"E": 1.25, "h_0": -0.5}, "design_initial": {"E": 1.0, "h_0": 0.0}, "biactive": 0},
    "design_bounds": {"E": [0.5, 2.0], "h_0": [-0.5, 0.5]},
    "constraints": {
        "area": {"value": 4.0, "lower": 3.9, "upper": 4.0, "violation": 0.0},
        "max-pressure(face)": {"value": 110.0, "lower": None, "upper": 100.0, "violation": 0.1},
    },
}


def designed(**changes: Any) -> Record:
    """``mpcc`` on a problem with two design variables and two constraints, one of them violated."""
    return {**DESIGNED, **changes}


def fixed_61(**changes: Any) -> Record:
    """``fixed`` on Example 6.1 with the paper's settings."""
    return {**FIXED_61, **changes}


def joint_61(**changes: Any) -> Record:
    """``joint`` on Example 6.1 with the paper's settings."""
    return {**JOINT_61, **changes}


def joint_62(**changes: Any) -> Record:
    """``joint`` on Example 6.2 with the paper's settings, and all that a record of today has."""
    return {**JOINT_62, **changes}


def failed(record: Record, **changes: Any) -> Record:
    """``mpcc`` that broke on the problem of a record: words and settings, no figures."""
    known = {name: record[name] for name in KEPT}
    broken = {"formulation": "mpcc", "status": "failed", "success": False, "stationarity": "", "seed": None}
    return {**dict.fromkeys(record), **known, **broken, "message": "RuntimeError: 100% & more_", **changes}


def failed_61(**changes: Any) -> Record:
    """A formulation that broke on Example 6.1."""
    return failed(FIXED_61, **changes)


ROWS = [joint_62(), failed(joint_62(), wall_time_s=0.083)]
"""A success and a failure on Example 6.2."""


def saved(solution: Solution, folder: Path) -> Result:
    """A solution with its files, as ``rmesh solve`` keeps them."""
    result = single_result(folder, solution.record())
    Done(result.record, solution).save(result)
    return result
