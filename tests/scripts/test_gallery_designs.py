"""The design cases of the gallery small: all starts succeed, labels are proved, gains are real."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

import rmesh_nlp as rm
from rmesh_nlp.io.problem_file import load_problem

FOLDER = Path(__file__).parents[2] / "scripts" / "gallery"


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Import a script of the gallery as it is when run: its folder first on the path."""
    monkeypatch.syspath_prepend(str(FOLDER))

    def load(name: str) -> ModuleType:
        sys.modules.pop("common", None)
        return importlib.import_module(name)

    return load


def check_ends(starts) -> None:
    """Each end is a success whose label is proved."""
    for (formulation, seed), end in starts.solutions.items():
        assert end.success, f"{formulation} from {seed}: {end.status.message}"
        assert end.extra["b_stationary"], f"{formulation} from {seed}"


def values(starts, formulation: str) -> list[float]:
    return [
        end.extra["objective_value"] for (name, _), end in starts.solutions.items() if name == formulation
    ]


def is_same_at_start(file: str, problem: rm.ContactProblem, objective) -> bool:
    """Whether a problem file is the problem of its script, by the objective at the first design."""
    one, two = (
        rm.solve(each.at_design(), "fixed", objective=objective).extra["objective_value"]
        for each in (load_problem(FOLDER / file), problem)
    )
    return one == pytest.approx(two, rel=1e-9)


@pytest.mark.slow
def test_the_face_of_the_punch_levels_its_pressure(load, tmp_path: Path) -> None:
    module = load("level_punch")
    punch = module.main(4, order=1, seeds=(None, 1))
    check_ends(punch.starts)
    assert values(punch.starts, "nested") == pytest.approx(values(punch.starts, "mpcc"), rel=1e-5)
    for flat, shaped in punch.finer:
        mean = module.FORCE / 2
        assert flat.pressure.max() > 2 * mean
        assert shaped.pressure.max() < 1.05 * mean
    assert module.surviving(punch.finer) > 0.95
    module.draw(punch, tmp_path / "it.png")
    assert (tmp_path / "it.png").stat().st_size > 10_000
    assert is_same_at_start("level_punch.toml", module.problem(8), module.OBJECTIVE)
