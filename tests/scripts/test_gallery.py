"""Every gallery case small: formulations agree, gains are real, labels are proved."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import rmesh_nlp as rm
from gallery import design, free_boundary, kinks, mpcc_traps, of_file, signorini, stick_slip
from rmesh_nlp.io.problem_file import read_table

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("estimates_unasked")]

FOLDER = Path(kinks.__file__).parent


def needs_gmsh() -> None:
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError):
        pytest.skip("gmsh is not installed")


@pytest.mark.parametrize("name", ["l_shape", "wedge", "free_boundary", "signorini"])
def test_relocation_lowers_the_energy_by_both_formulations(name: str) -> None:
    if name == "l_shape":
        needs_gmsh()
    problem = {
        "l_shape": lambda: of_file("l_shape", h=0.2),
        "wedge": lambda: of_file("wedge", nx=12, ny=3),
        "free_boundary": lambda: free_boundary.problem(10),
        "signorini": lambda: signorini.problem(5),
    }[name]()
    ends = [rm.solve(problem, formulation) for formulation in ("fixed", "joint", "nested")]
    assert all(end.success and end.assessment.final.min_area_ratio > 0 for end in ends)
    given, joint, nested = (end.energy_audited for end in ends)
    assert joint < given
    assert nested == pytest.approx(joint, rel=1e-4)


def test_the_shaped_punch_has_a_lower_peak_by_both_formulations() -> None:
    punch, objective = of_file("punch", nx=4, ny=4), read_table(FOLDER / "punch.toml").solve.objective
    before, nested, mpcc = (
        rm.solve(punch, name, objective=objective) for name in ("fixed", "nested", "mpcc")
    )
    assert nested.success
    assert mpcc.success
    assert nested.record()["objective_value"] == pytest.approx(mpcc.record()["objective_value"], rel=1e-4)
    # the load, and with it the mean, is given: what the middle is spared the rest must carry
    assert nested.final.pressure.max() < 0.9 * before.final.pressure.max()


def test_a_slab_ends_where_a_node_is_about_to_slide(tmp_path: Path) -> None:
    solutions = kinks.main("slab", 6, tmp_path / "slab.png")
    assert all(solution.success for solution in solutions.values())
    node, *_ = solutions["nested"].record()["biactive_nodes"]
    found = kinks.across(solutions["nested"], "slab", node)
    middle, tiny = len(found.shift) // 2, 1e-6
    # sticks on one side and slides on the other: neither slip nor reserve is there on both
    assert max(found.first[middle], found.second[middle]) < tiny
    assert np.all(np.minimum(found.first / found.first.max(), found.second / found.second.max()) < tiny)
    left, right = found.slopes
    assert max(left / right, right / left) > 1.5
    assert (tmp_path / "slab.png").stat().st_size > 10_000


def test_the_seal_ends_at_biactive_nodes_where_the_objective_has_a_kink() -> None:
    solutions = kinks.main("seal", 4)
    best, nested = solutions["mpcc"], solutions["nested"]
    assert best.success
    assert best.record()["b_stationary"]
    nodes = best.record()["biactive_nodes"]
    assert len(nodes) == 3
    for node in nodes:
        # either way costs, at different rates; a gradient would give rates that differ in their signs alone
        kink = kinks.across(best, "seal", node, kinks.STEP, 3)
        down, up = kink.slopes
        assert up > 0 > down
        assert min(abs(kink.gradient - up), abs(kink.gradient - down)) < 0.1 * up
        assert -down > 2 * up
    assert (nested.status.value, nested.record()["stationarity"]) == ("converged", "S")
    assert nested.record()["biactive_nodes"] == nodes
    assert nested.record()["objective_value"] == pytest.approx(best.record()["objective_value"], rel=1e-8)
    assert "exact finish" in nested.record()["outer"]
    again = solutions["mpcc from there"]
    assert again.record()["objective_value"] == pytest.approx(best.record()["objective_value"], rel=1e-6)


def test_labels_tell_traps_from_minima() -> None:
    found = mpcc_traps.main()
    for name, (corner, _, solved) in found.items():
        assert corner.stationarity == name[0]
        assert corner.b_stationary == ("trap" not in name)
        left = max(abs(value) for value in solved.x) > 1e-4
        assert left == ("trap" in name)
        assert solved.b_stationary
    assert mpcc_traps.is_trapped(found["C, trap"])


def designed(name: str, folder: Path, edge: str = "bottom") -> tuple[rm.Solution, list[design.Pair]]:
    """The design of a file on a coarser mesh; it is a success with a proved label, and drawn."""
    text = (FOLDER / f"{name}.toml").read_text()
    for entry, coarser in (("nx = 16", "nx = 8"), ("nx = 32", "nx = 16"), ("ny = 8", "ny = 4")):
        text = text.replace(entry, coarser)
    shutil.copy(FOLDER / "identification.csv", folder)
    (folder / "coarser.toml").write_text(text)
    best, pairs = design.main(folder / "coarser.toml", edge, folder / "it.png")
    assert best.success
    assert best.record()["b_stationary"]
    assert design.surviving(pairs) > 0.95
    assert (folder / "it.png").stat().st_size > 10_000
    return best, pairs


def test_the_face_of_the_punch_levels_its_pressure(tmp_path: Path) -> None:
    for flat, shaped in designed("level_punch", tmp_path)[1]:
        assert flat.final.pressure.max() > 2 * 10
        assert shaped.final.pressure.max() < 1.05 * 10


def test_modulus_friction_and_gap_are_identified(tmp_path: Path) -> None:
    best, (pair, *_) = designed("identification", tmp_path, "top")
    assert best.design == pytest.approx({"E": 1.2, "F": 0.35, "g": 0.01}, rel=0.05)
    first, last = (end.record()["objective_value"] for end in pair)
    assert last < 0.01 * first


def test_the_seal_spreads_its_closing_force(tmp_path: Path) -> None:
    found, pairs = designed("closing_force", tmp_path)
    for first, best in pairs:
        assert best.final.pressure.max() < 0.75 * first.final.pressure.max()
        assert best.record()["resultant"] == pytest.approx(4.0, rel=5e-3)
    assert found.design["lip"] > 9 * found.design["core"]  # a stiff lip on a soft core


def test_relocation_under_coulomb_friction_lowers_the_error(tmp_path: Path) -> None:
    ends, errors = stick_slip.main(3, starts=2, picture=tmp_path / "it.png")
    for end in ends:
        assert end.success
        assert end.record()["b_stationary"] or end.status.value != "converged"
        assert end.record()["objective_value"] < 0.8 * errors[0][0]
    # mpcc runs into a limit from one of its two starts
    assert sum(end.status.value == "converged" for end in ends) >= 3
    gains = [1 - after / before for before, after in errors]
    assert gains[-1] > 0.5 * gains[0]
    assert errors[0][0] / errors[-1][0] > 11  # linear triangles on meshes four times as fine: 16 in the limit
    assert (tmp_path / "it.png").stat().st_size > 10_000
