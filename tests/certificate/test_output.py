"""Certificates in records, files, tables, figures and in print."""

from __future__ import annotations

import json

import meshio
import numpy as np
import pytest

from rmesh_nlp.cli.app import run
from rmesh_nlp.io.results import read_results
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.report.blocks import blocks
from rmesh_nlp.report.columns import CERTIFICATES
from rmesh_nlp.report.figures import block_figures
from rmesh_nlp.report.tables import markdown

FLAT = "normal = [0.0, 1.0]\nfriction = 0.1"
CURVED = "circle = { centre = [1.0, -5.0], radius = 5.0 }"
TOML = f"""
[mesh]
shape = "rectangle"
nx = 6
ny = 3
x = [0.0, 2.0]
[material]
law = "plane-strain"
young = 20.0
poisson = 0.3
[dirichlet]
left = [0.0, 0.0]
[tractions]
top = [0.0, -0.5]
[contact]
boundary = "bottom"
{FLAT}
[motion]
delta = 0.05
[solve]
certify = true
"""


@pytest.fixture(scope="module")
def certified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certified")
    assert run(["solve", "6.3", "--n", "6x4", "--certify", "--out", str(folder)]) == 0
    return folder


def test_record_and_file_hold_the_certificate(certified):
    record = json.loads((certified / "record.json").read_text())
    assert record["energy_lower_bound"] < record["energy"] == pytest.approx(record["energy_upper_bound"])
    assert record["error_bound"] < record["error_bound_initial"]
    assert record["guaranteed_lower"] is record["guaranteed_upper"] is True
    cells = meshio.read(certified / "solution.vtu").cell_data
    assert cells["equilibrated_stress"][0].shape == (record["triangles"], 3)
    # the lower bound may be the better one of the other mesh
    assert np.sum(cells["error_bound"][0]) >= 0.5 * record["error_bound"] ** 2 - 1e-12
    assert read_vtu(certified / "solution.vtu").error_bound is not None


def test_tables_and_figures_show_it(certified):
    results = read_results(certified)
    records = [result.record for result in results]
    text = markdown(records)
    assert CERTIFICATES[-1].heading.replace("|", " ") in text
    assert "at most" in text
    figures = dict(block_figures(blocks(records)[0], results))
    (error,) = [figure for name, figure in figures.items() if name.endswith("-error")]
    titles = [axis.get_title() for axis in error.axes]
    assert "given, error at most" in titles[0]
    assert "relocated, error at most" in titles[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("foundation", "printed", "bounded"),
    [
        (FLAT, ("error in the energy norm at most", "least energy between"), True),
        (CURVED, ("no certificate: the normal of a curved foundation",), False),
    ],
)
def test_a_problem_file_may_ask_for_it_and_what_was_found_is_printed(
    foundation: str, printed: tuple[str, ...], bounded: bool, tmp_path, capsys
) -> None:
    (tmp_path / "my.toml").write_text(TOML.replace(FLAT, foundation))
    options = ["--formulation", "fixed", "--out", str(tmp_path / "o")]
    assert (run(["solve", str(tmp_path / "my.toml"), *options]) == 0) or not bounded
    text = capsys.readouterr().out
    assert all(part in text for part in printed)
    record = json.loads((tmp_path / "o" / "record.json").read_text())
    assert (record.get("energy_lower_bound") is not None) is bounded
