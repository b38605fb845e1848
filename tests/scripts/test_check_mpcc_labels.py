"""Labels of the solver against brute force, by the script that shares no code with it."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "check_mpcc_labels.py"


@pytest.fixture
def script(monkeypatch):
    spec = importlib.util.spec_from_file_location("check_mpcc_labels", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_labels_of_random_corners_and_solutions_agree_with_brute_force(script, capsys):
    assert script.main(["--problems", "40", "--pairs", "4", "--seed", "7"]) == 0
    out = capsys.readouterr().out
    assert "random corners: 20" in out
    assert out.count("0 disagree") == 2


@pytest.mark.parametrize(
    ("slope", "label", "b"),
    [((1, 1), "S", True), ((-1, 0), "M", False), ((-1, -1), "C", False), ((1, -1), "W", False)],
)
def test_the_brute_force_itself_on_a_corner_known_by_hand(script, slope, label, b):
    data = {
        "G": np.array([[1.0, 0]]),
        "H": np.array([[0, 1.0]]),
        "B": np.zeros((0, 2)),
        "c": np.array(slope, float),
    }
    assert (script.label(data), script.b_stationary(data)) == (label, b)


@pytest.mark.slow
def test_a_wrong_label_is_found_out(script, monkeypatch, capsys):
    honest = script.classify

    def wrong(*arguments):
        found = honest(*arguments)
        return type(found)("S", True, True, found.biactive)

    monkeypatch.setattr(script, "classify", wrong)
    assert script.main(["--problems", "40", "--pairs", "2"]) == 1
    assert "brute force" in capsys.readouterr().out
