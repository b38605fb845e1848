"""Notes below the tables: each is said where the records show it, and nowhere else."""

from __future__ import annotations

import pytest

from rmesh_nlp.io.records import Record
from rmesh_nlp.report.notes import detailed_notes, main_notes
from support.reporting import joint_61, joint_62

FINAL = "Example 6.2: printed final energy -4.9188 is"
INITIAL = "Example 6.2: printed initial energy -4.8541:"
STICKING, BELOW, FOREIGN = "there is no stick zone", "lies BELOW the infimum", "not the paper's settings"
EXTREMES = "printed extremes -0.4549, 0.4753 on the given grid:"
EARLY = joint_62(status="iteration_limit")
METRES = {"units": {"length": "m", "force": "N"}}
GIVEN_61 = joint_61(formulation="fixed", energy=-1.124602, u_min=-0.454855, u_max=0.475281)
MOVED_61 = joint_61(energy=-1.475161, u_min=-0.5228, u_max=0.5266)
# two solvers stop at one minimum, apart by rounding: neither is to be called the better one
ENDS = {"joint": (-4.92, -4.92), "mpcc": (-4.92 - 1e-11, -4.92 + 1e-11), "nested": (-4.919999, -4.919999)}
TIED = [joint_62(formulation=k, energy=own, energy_audited=end) for k, (own, end) in ENDS.items()]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([joint_62()], f"{FINAL} NOT reached: the lowest here is -4.910330 (joint). "),
        # truncated, not rounded, it would be printed as -4.9187
        ([joint_62(energy=-4.91879)], f"{FINAL} NOT reached"),
        ([joint_62(energy=-4.9189)], f"{FINAL} passed: the lowest here"),
        ([joint_62(formulation="fixed")], "no formulation relocated the grid here, so the printed final"),
        ([joint_62(energy_initial=-4.854190196)], f"{INITIAL} met, here -4.854190."),
        ([joint_62(energy_initial=-4.85409)], f"{INITIAL} NOT met, here -4.854090."),
        ([joint_62(quadrature=6)], FOREIGN),
        ([GIVEN_61, MOVED_61], f"{EXTREMES} met, here -0.45486, 0.47528."),
        ([{**GIVEN_61, "u_max": 0.4755}, MOVED_61], f"{EXTREMES} NOT met"),
        ([GIVEN_61, MOVED_61], "final energy -1.4445 is passed: the lowest here is -1.475161 (joint)."),
        ([GIVEN_61, MOVED_61], "here -0.5228, 0.5266 (joint)"),
        ([joint_62(), EARLY], "iteration_limit: a success that is valid and not worse than the given mesh, "
         "but not stationary to the tolerance."),
        ([joint_62(**METRES), joint_62(example="6.3", **METRES), joint_61(units={})],
         "Example 6.2, Example 6.3: u in m, J in N, the energy per m of depth."),
        ([joint_62(sticking_nodes=0), joint_62(sticking_nodes=0)], STICKING),
        (TIED, "Example 6.2: by audited energy joint = mpcc -4.920000; nested -4.919999."),
        ([joint_62(example="6.1", energy=-4.51, energy_audited=-1.1, energy_above_exact=0.845)],
         "joint: the energy -4.510000 lies BELOW the infimum -1.945000: its quadrature"),
        ([joint_62(guaranteed_lower=True, energy_lower_bound=-4.9)],
         "the audited energy -4.910330 lies BELOW the infimum -4.900000"),
    ],
)  # fmt: skip
def test_note_is_said_once(rows: list[Record], said: str) -> None:
    assert len([note for note in {*main_notes(rows), *detailed_notes(rows)} if said in note]) == 1


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([joint_62(example="mine", n="144 triangles")], "aper"),
        ([joint_62(), {**EARLY, "success": False}], "iteration_limit: a success"),
        ([joint_62(sticking_nodes=0), joint_62(sticking_nodes=1)], STICKING),
        ([joint_62(energy_above_exact=0.1)], BELOW),
        ([joint_62(energy_lower_bound=-4.9)], BELOW),
        ([joint_62(**METRES | {"units": {"length": "m"}})], "u in m"),
        ([joint_62()], "by audited energy"),
    ],
)
def test_note_is_not_said(rows: list[Record], said: str) -> None:
    assert said not in "".join([*main_notes(rows), *detailed_notes(rows)])
