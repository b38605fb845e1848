"""Figures: that they exist, show the data they are made from, and can be read in print."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib.text
import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure

from rmesh_nlp.io.results import Result, Results, read_results
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.report.blocks import blocks
from rmesh_nlp.report.figures import block_figures, write_figures
from rmesh_nlp.report.histories import curve
from rmesh_nlp.report.style import LOOKS, SETTINGS, TWO_COLUMNS, add_legend, new_figure
from rmesh_nlp.study.cases import plan_comparison
from rmesh_nlp.study.comparison import run


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> list[Result]:
    """Small solves of a scalar example and of one with friction."""
    folder = tmp_path_factory.mktemp("results")
    cases = plan_comparison(["6.1"], ["fixed", "nested", "joint", "mpcc"], n=4)
    cases += plan_comparison(["6.3"], ["fixed", "joint"], n=(4, 3))
    list(run(cases, Results(folder)))
    return read_results(folder)


def figures(results: list[Result], example: str) -> dict[str, Figure]:
    chosen = [result for result in results if result.record["example"] == example]
    (block,) = blocks([result.record for result in chosen])
    return dict(block_figures(block, chosen))


def texts(figure: Figure) -> Iterator[matplotlib.text.Text]:
    return (t for t in figure.findobj(matplotlib.text.Text) if t.get_text() and t.get_visible())


@pytest.mark.slow
def test_every_example_has_its_figures(results: list[Result], tmp_path: Path) -> None:
    paths = write_figures(results, tmp_path)
    names = {path.name for path in paths}
    grids = ("nested-grid", "joint-grid", "mpcc-grid")
    stems = {f"6.1-4-{what}" for what in (*grids, "stress", "surface", "convergence")}
    stems |= {f"6.3-4x3-{what}" for what in ("joint-grid", "stress", "convergence")}
    assert names == {f"{stem}.{kind}" for stem in stems for kind in ("png", "pdf")}
    for path in paths:
        head = path.read_bytes()[:5]
        assert head == (b"\x89PNG\r" if path.suffix == ".png" else b"%PDF-")


@pytest.mark.slow
@pytest.mark.parametrize("example", ["6.1", "6.3"])
def test_texts_are_legible_and_do_not_overlap(results: list[Result], example: str) -> None:
    for name, figure in figures(results, example).items():
        with rc_context(SETTINGS):
            figure.draw_without_rendering()
        assert figure.get_size_inches()[0] <= 7.0
        sizes = [text.get_fontsize() for text in texts(figure)]
        assert min(sizes) >= 8, name
        if name.endswith("surface"):
            continue  # three-dimensional axes keep texts of ticks that they do not draw
        labels = [axis.xaxis.label for axis in figure.axes] + [axis.title for axis in figure.axes]
        labels += [axis.yaxis.label for axis in figure.axes]
        labels += [t for legend in figure.legends for t in legend.get_texts()]
        boxes = [(t.get_text(), t.get_window_extent()) for t in labels if t.get_text()]
        frame = figure.bbox.padded(1)
        for i, (text, box) in enumerate(boxes):
            assert frame.x0 <= box.x0 <= box.x1 <= frame.x1, (name, text)
            assert frame.y0 <= box.y0 <= box.y1 <= frame.y1, (name, text)
            for other_text, other in boxes[i + 1 :]:
                assert not box.overlaps(other), (name, text, other_text)


@pytest.mark.slow
def test_grids_have_equal_axes_and_show_both_meshes(results: list[Result]) -> None:
    figure = figures(results, "6.3")["6.3-4x3-joint-grid"]
    grids = [axis for axis in figure.axes if axis.get_label() != "<colorbar>"]
    assert [axis.get_aspect() for axis in grids] == [1.0] * 4
    titles = [axis.get_title() for axis in grids]
    assert titles[:2] == ["given grid", "relocated by joint"]
    assert titles[2] == titles[3]
    magnification = float(titles[2].removeprefix("deformed, u and gap × "))
    joint = next(r for r in results if r.record["example"] == "6.3" and r.record["formulation"] == "joint")
    fields = read_vtu(joint.vtu)
    drawn = np.array(grids[3].lines[0].get_xydata())
    moved = fields.nodes + magnification * fields.displacement
    for corner in (moved[:, 0], moved[:, -1]):
        assert np.nanmin(np.linalg.norm(drawn - corner, axis=1)) < 1e-12


def test_looks_are_told_apart_without_colour() -> None:
    assert len({(one.linestyle, one.marker) for one in LOOKS}) == len(LOOKS)


@pytest.mark.slow
def test_the_cost_of_every_formulation_is_time_in_contact_solves(results: list[Result]) -> None:
    by_name = {r.record["formulation"]: r for r in results if r.record["example"] == "6.1"}
    assert curve(by_name["fixed"]) is None
    for name in ("joint", "nested"):
        found, result = curve(by_name[name]), by_name[name]
        assert found is not None
        last = result.steps()[-1]["seconds"] / result.record["contact_time_s"]
        assert found.cost[-1] == pytest.approx(max(last, 1.0))
    figure = figures(results, "6.1")["6.1-4-convergence"]
    assert "build and solve" in figure.axes[1].get_xlabel()


@pytest.mark.slow
def test_mpcc_begins_at_the_initial_energy(results: list[Result]) -> None:
    (result,) = [r for r in results if r.record["formulation"] == "mpcc"]
    found = curve(result)
    assert found is not None
    assert found.iteration[0] == 0
    # Ipopt pushes forces and gaps off their bounds, by a hundredth of their unit
    assert found.energy[0] == pytest.approx(result.record["energy_initial"], rel=2e-2)
    assert found.energy[-1] == pytest.approx(result.record["energy"], abs=1e-8)


@pytest.mark.parametrize(
    "names",
    [
        ["nested", "joint", "mpcc"],
        [f"nested, mean(load, -uy), seed {k}" for k in range(7)],
        ["newton from forty random starts " * 6],
    ],
)
def test_a_legend_is_not_wider_than_its_figure(names: list[str]) -> None:
    figure = new_figure(TWO_COLUMNS, 3.0)
    axis = figure.subplots()
    for name in names:
        axis.plot([0, 1], [0, 1], label=name)
    with rc_context(SETTINGS):
        add_legend(figure, [axis])
    (legend,) = figure.legends
    figure.draw_without_rendering()
    assert legend.get_window_extent().width <= figure.get_window_extent().width
