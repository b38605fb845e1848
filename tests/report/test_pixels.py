"""Meshes that are too fine for print, as images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.report import before_after, limits, pixels
from rmesh_nlp.report.before_after import write_pictures
from rmesh_nlp.report.pixels import edge_image, field_image, is_fine
from support.formulations import fixed


def test_a_linear_field_is_itself_at_every_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pixels, "ACROSS", 90)
    mesh = rectangle(7, 3, x=(1, 3), y=(0, 1))
    image, window = field_image(mesh.p, mesh.t, 2 * mesh.p[0] - mesh.p[1])
    rows, columns = image.shape
    x = np.linspace(*window[0], 2 * columns + 1)[1::2]
    y = np.linspace(*window[1], 2 * rows + 1)[1::2]
    assert not np.any(image.mask)
    assert np.asarray(image) == pytest.approx(2 * x[None, :] - y[:, None])
    assert columns == pytest.approx(pixels.ACROSS, abs=1)


def test_a_field_of_elements_is_constant_on_each_and_masked_outside() -> None:
    nodes, triangle = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([[0], [1], [2]])
    image, _ = field_image(nodes, triangle, np.array([5.0]))
    assert np.all(image.compressed() == 5.0)
    # half of the square around the triangle is outside
    assert image.mask.mean() == pytest.approx(0.5, abs=0.01)


def test_pixels_are_darker_where_the_mesh_is_finer() -> None:
    mesh = rectangle(90, 90)
    nodes = mesh.p.copy()
    nodes[0] **= 2  # nodes crowd at the left
    image, _ = edge_image(nodes, mesh.facets)
    middle = image.shape[1] // 2
    assert image[:, :middle].mean() > 1.3 * image[:, middle:].mean()
    assert image.max() <= 1.0


@pytest.mark.slow
def test_a_fine_mesh_is_drawn_by_images_and_its_files_stay_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = EXAMPLES["6.2"](n=(8, 4))
    solution = fixed.solve(problem)
    moved = replace(solution.mesh, doflocs=solution.mesh.p + 1e-3 * (solution.mesh.p[1] > 0.5))
    solution = replace(solution, mesh=moved)
    assert not is_fine(problem.triangles)
    for module in (before_after, limits):
        monkeypatch.setattr(module, "is_fine", lambda _: True)
    drawn = write_pictures(solution, tmp_path)
    assert {path.stem for path in drawn} >= {"mesh", "displacement", "stress", "motion", "limits"}
    assert all(path.stat().st_size > 1000 for path in drawn)
