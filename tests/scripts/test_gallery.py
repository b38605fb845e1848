"""Every gallery case small: formulations agree, meshes are valid, gains are real, labels are proved.

``common.run`` asserts success, validity, no rise of the energy, and joint = nested to 1e-4.
"""

import importlib
from pathlib import Path

import common
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.fem.fit import read_measurements
from rmesh_nlp.io.problem_file import load_problem


def needs_gmsh() -> None:
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError):
        pytest.skip("gmsh is not installed")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "n", "ratio"), [("l_shape", 5, 0.75), ("wedge", 3, 0.9), ("signorini", 5, 0.85)]
)
def test_relocation_lowers_the_error(tmp_path: Path, name: str, n: int, ratio: float) -> None:
    if name == "l_shape":
        needs_gmsh()
    case = importlib.import_module(name).main(n)
    assert 0 < case.error_after < ratio * case.error_before
    common.draw(case, tmp_path / "it.png")
    assert (tmp_path / "it.png").stat().st_size > 10_000


@pytest.mark.slow
def test_contact_has_its_analytic_extent() -> None:
    membrane = importlib.import_module("free_boundary")
    assert membrane.radius(membrane.main(10)) == pytest.approx(1, abs=0.05)
    needs_gmsh()
    hertz = importlib.import_module("hertz")
    contact = hertz.measure(hertz.main(8).after)
    assert (contact.half_width, contact.peak) == pytest.approx((1, 1), abs=0.05)


@pytest.mark.slow
def test_the_shaped_punch_has_a_lower_peak_by_both_formulations() -> None:
    solutions = importlib.import_module("punch").main(4)
    before, nested, mpcc = (solutions[name] for name in ("fixed", "nested", "mpcc"))
    assert nested.success
    assert mpcc.success
    assert nested.record()["objective_value"] == pytest.approx(mpcc.record()["objective_value"], rel=1e-4)
    # the load, and with it the mean, is given: what the middle is spared the rest must carry
    assert nested.pressure.max() < 0.9 * before.pressure.max()


@pytest.mark.slow
def test_a_slab_ends_where_a_node_is_about_to_slide(tmp_path: Path) -> None:
    module = importlib.import_module("coulomb_kink")
    solutions = module.main(6)
    module.draw(solutions, tmp_path / "slab.png")
    assert all(solution.success for solution in solutions.values())
    assert solutions["nested"].record()["biactive"] >= 1
    found = module.across(solutions["nested"])
    middle, tiny = len(found.x) // 2, 1e-6
    # sticks on one side and slides on the other: neither slip nor reserve is there on both
    assert max(found.slip[middle], found.reserve[middle]) < tiny
    assert np.all(np.minimum(found.slip / found.slip.max(), found.reserve / found.reserve.max()) < tiny)
    left, right = module.slopes(found)
    assert max(left / right, right / left) > 1.5


@pytest.mark.slow
def test_the_seal_ends_at_biactive_nodes_where_the_objective_has_a_kink(tmp_path: Path) -> None:
    module = importlib.import_module("seal")
    solutions = module.main(4)
    module.draw(solutions, tmp_path / "seal.png")
    best = solutions["mpcc"]
    assert best.success
    assert best.record()["b_stationary"]
    assert len(best.record()["biactive_nodes"]) == len(module.seal_nodes(best.problem)) == 3
    early = [stage for stage in best.record()["stages"] if stage["phase"] == "relaxed"]
    assert len(early) >= 2
    for stage in early:  # the relaxation acts: without it the pairs would open further
        assert stage["product"] >= stage["t"] / 2
        assert stage["multiplier"] > 1e-3
        assert stage["biactive"] == 3
    for kink in module.kinks(best):
        # either way costs, at different rates; a gradient would give rates that differ in their signs alone
        assert kink.up > 0
        assert kink.down > 0
        assert min(abs(kink.gradient - kink.up), abs(kink.gradient + kink.down)) < 0.1 * kink.up
        assert kink.down > 2 * kink.up
    nested = solutions["nested"]
    assert (nested.status.value, nested.stationarity) == ("converged", "S")
    assert nested.record()["biactive_nodes"] == best.record()["biactive_nodes"]
    assert nested.record()["objective_value"] == pytest.approx(best.record()["objective_value"], rel=1e-8)
    assert "exact finish" in nested.record()["outer"]
    again = solutions["mpcc from the end of nested"]
    assert again.record()["objective_value"] == pytest.approx(best.record()["objective_value"], rel=1e-6)
    assert (tmp_path / "seal.png").stat().st_size > 10_000


@pytest.mark.slow
def test_labels_tell_traps_from_minima() -> None:
    cases = {case.name: case for case in importlib.import_module("mpcc_traps").main()}
    for name, case in cases.items():
        assert case.corner.stationarity == name[0]
        assert case.corner.b_stationary == ("trap" not in name)
        left = max(abs(value) for value in case.solved.x) > 1e-4
        assert left == ("trap" in name)
        assert case.solved.b_stationary
    assert cases["C, trap"].plain_is_trapped


FOLDER = Path(__file__).parents[2] / "scripts" / "gallery"


def check(module, case, picture: Path, agree: bool = True) -> None:
    """Each end is a success whose label is proved, both formulations agree, and the case is drawn."""
    found: dict[str, list[float]] = {}
    for (formulation, seed), end in case.starts.solutions.items():
        assert end.success, f"{formulation} from {seed}: {end.status.message}"
        assert end.record()["b_stationary"], f"{formulation} from {seed}"
        found.setdefault(formulation, []).append(end.record()["objective_value"])
    assert not agree or found["nested"] == pytest.approx(found["mpcc"], rel=1e-5)
    module.draw(case, picture)
    assert picture.stat().st_size > 10_000


def is_same_at_start(file: str, problem: rm.ContactProblem, objective) -> bool:
    """Whether a problem file is the problem of its script, by the objective at the first design."""
    one, two = (
        rm.solve(each.at_design(), "fixed", objective=objective).record()["objective_value"]
        for each in (load_problem(FOLDER / file), problem)
    )
    return one == pytest.approx(two, rel=1e-9)


@pytest.mark.slow
def test_the_face_of_the_punch_levels_its_pressure(tmp_path: Path) -> None:
    module = importlib.import_module("level_punch")
    punch = module.main(4, order=1, seeds=(None, 1))
    check(module, punch, tmp_path / "it.png")
    for flat, shaped in punch.finer:
        mean = module.FORCE / 2
        assert flat.pressure.max() > 2 * mean
        assert shaped.pressure.max() < 1.05 * mean
    assert punch.surviving > 0.95
    assert is_same_at_start("level_punch.toml", module.problem(8), module.OBJECTIVE)


@pytest.mark.slow
def test_modulus_friction_and_gap_are_identified(tmp_path: Path) -> None:
    module = importlib.import_module("identification")
    found = module.main(2, seeds=(None, 2))
    check(module, found, tmp_path / "it.png")
    best = found.starts.best.design
    for name, value in module.TRUTH.items():
        assert best[name] == pytest.approx(value, rel=0.05)
    first, last = (end.record()["objective_value"] for end in found.finer[0])
    assert last < 0.01 * first
    assert module.surviving(found.finer) > 0.95
    path = FOLDER / "identification.csv"
    module.write(found.data, tmp_path / "data.csv")
    one, two = (read_measurements(each) for each in (path, tmp_path / "data.csv"))
    assert one.values == pytest.approx(two.values, abs=3e-4)  # of a coarser mesh, with the same noise
    assert is_same_at_start("identification.toml", module.problem(8), f"fit({path})")


@pytest.mark.slow
def test_the_seal_spreads_its_closing_force(tmp_path: Path) -> None:
    module = importlib.import_module("closing_force")
    seal = module.main(4, seeds=(None, 1))
    check(module, seal, tmp_path / "it.png")
    for first, best in seal.finer:
        assert best.pressure.max() < 0.75 * first.pressure.max()
        assert best.record()["resultant"] == pytest.approx(module.FORCE, rel=5e-3)
    design = seal.starts.best.design
    assert design["lip"] > 9 * design["core"]  # a stiff lip on a soft core
    assert seal.surviving > 0.95
    assert is_same_at_start("closing_force.toml", module.problem(8), module.OBJECTIVE)


@pytest.mark.slow
def test_relocation_under_coulomb_friction_lowers_the_error(tmp_path: Path) -> None:
    module = importlib.import_module("stick_slip")
    found = module.main(3, seeds=(None, 1))
    check(module, found, tmp_path / "it.png", agree=False)
    for end in found.starts.solutions.values():
        assert end.record()["objective_value"] < 0.8 * found.given.record()["objective_value"]
    assert found.given.record()["sticking_nodes"] == 2  # of those at x = 0, 1/3, ..., the one at 0 is given
    gains = [1 - after / before for before, after in found.errors]
    assert gains[-1] > 0.5 * gains[0]
    rate = found.errors[0][0] / found.errors[-1][0]
    assert rate > 11  # squared error of linear triangles on meshes four times as fine: 16 in the limit
