"""The paper's sketches are drawn, and the least known energies are kept by grid and box."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scripts import best_known, paper_figures


@pytest.mark.slow
def test_the_figures_are_drawn(tmp_path: Path) -> None:
    files = paper_figures.main(["--out", str(tmp_path)])
    assert [file.name for file in files] == ["figure-3.1.png", "figure-3.2.png", "figure-6.1.png"]
    assert all(file.stat().st_size > 5_000 for file in files)
    low, high = paper_figures.figure_61(tmp_path / "again.png")
    # the lower half is odd about x = 1/2, and the upper bump is lower
    assert low == pytest.approx(-high, rel=1e-3)
    assert 0.4 < high < 0.6


@pytest.mark.slow
def test_the_lower_energy_of_a_grid_and_box_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "known.json"
    best_known.main(["6.3:6", "--starts", "1", "--file", str(file)])
    (row,) = json.loads(file.read_text())
    assert (row["example"], row["n"]) == ("6.3", 6)
    assert row["energy"] < 0
    lower = {**row, "energy": row["energy"] - 1}
    wider = {**row, "delta": [1.0, 1.0]}
    assert best_known.merged([row], lower) == [lower]
    assert best_known.merged([lower], row) == [lower]
    assert len(best_known.merged([row], wider)) == 2
