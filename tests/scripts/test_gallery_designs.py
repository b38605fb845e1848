"""The design cases of the gallery small: all starts succeed, labels are proved, gains are real."""

import importlib
from pathlib import Path

import pytest

import rmesh_nlp as rm
from rmesh_nlp.fem.fit import read_measurements
from rmesh_nlp.io.problem_file import load_problem

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
