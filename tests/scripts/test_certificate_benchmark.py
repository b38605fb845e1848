"""The benchmark of certificates runs on small problems, and counts a violated bound."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


@pytest.fixture
def comparisons(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module("certificate_comparisons")


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    monkeypatch.setattr(sys, "argv", ["benchmark_certificate.py"])
    return importlib.import_module("benchmark_certificate")


@pytest.mark.slow
def test_small_run_finds_no_violation(benchmark: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--parts", "exact", "random", "--kinds", "scalar", "--seeds", "1", "--n", "4"]
    assert benchmark.main(arguments) == 0
    assert "violations: 0" in capsys.readouterr().out


def test_a_violated_bound_is_counted(comparisons: ModuleType) -> None:
    rough = comparisons.bracket_of(comparisons.problem_of(0, "scalar"))
    assert not comparisons.compared(rough, rough).violated
    assert comparisons.compared(replace(rough, lower=rough.upper + 1), rough).violated
