"""Every gallery case small: formulations agree, meshes are valid, and one number is as it should be.

``common.run`` asserts success, validity, no rise of the energy, and joint = nested to 1e-4.
"""

import importlib
from pathlib import Path

import common
import numpy as np
import pytest


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
    solutions = module.main(4, ["newton"])
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
    nested = solutions["nested, newton"]
    assert (nested.status.value, nested.stationarity) == ("converged", "S")
    assert nested.record()["biactive_nodes"] == best.record()["biactive_nodes"]
    assert nested.record()["objective_value"] == pytest.approx(best.record()["objective_value"], rel=1e-8)
    assert "exact finish" in nested.record()["outer"]
    again = solutions["mpcc from the end of nested, newton"]
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
