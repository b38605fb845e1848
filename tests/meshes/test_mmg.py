"""Remeshing by Mmg: domain, names, corners and signals are kept."""

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.meshes import mmg, named, shapes
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.meshes.mmg import remeshed
from rmesh_nlp.optimize.budget import Budget, Limits, StoppedError, checked
from rmesh_nlp.optimize.process import Answer
from rmesh_nlp.problem.lines import line_facets
from support.quality import sizes


def uniform(mesh: MeshTri, length: float) -> np.ndarray:
    """(3, nodes) the metric of edges of one length."""
    return np.broadcast_to(np.array([[1.0], [0.0], [1.0]]) / length**2, (3, mesh.p.shape[1]))


def corner_nodes(mesh: MeshTri) -> np.ndarray:
    """Nodes with other than two facets on lines, or where these turn."""
    ends = mesh.facets[:, line_facets(mesh)]
    found = []
    for node in np.unique(ends):
        here = ends[:, np.any(ends == node, axis=0)]
        directions = mesh.p[:, here[1]] - mesh.p[:, here[0]]
        straight = here.shape[1] == 2 and abs(np.linalg.det(directions)) < 1e-9
        if not straight:
            found.append(node)
    return np.array(found)


def made(mesh: MeshTri, length: float) -> MeshTri:
    return remeshed(mesh, uniform(mesh, length), line_facets(mesh), corner_nodes(mesh))


def middles(mesh: MeshTri, name: str) -> np.ndarray:
    return np.asarray(mesh.p[:, mesh.facets[:, np.asarray(mesh.boundaries[name])]].mean(axis=1))


class TestNames:
    def test_are_kept_also_where_they_overlap(self) -> None:
        """A square with two halves, and a part of the top that overlaps it."""
        body = named(
            shapes.rectangle(6, 6),
            {"load": lambda x: (x[1] > 1 - 1e-9) & (x[0] < 0.5), "all": lambda x: x[0] > -1},
            {"lower": lambda x: x[1] < 0.5, "upper": lambda x: x[1] > 0.5, "wide": lambda x: x[0] > -1},
        )
        new = made(body, 0.09)
        assert new.p.shape[1] > 1.5 * body.p.shape[1]
        assert sizes(new) == pytest.approx(sizes(body), rel=1e-12)
        assert set(np.asarray(new.boundaries["load"])) < set(np.asarray(new.boundaries["top"]))
        assert set(np.asarray(new.boundaries["all"])) == set(new.boundary_facets())
        assert np.all(middles(new, "load")[0] < 0.5)
        np.testing.assert_allclose(middles(new, "right")[0], 1.0, atol=1e-12)
        centres = new.p[:, new.t].mean(axis=1)
        np.testing.assert_array_equal(np.sort(new.subdomains["lower"]), np.flatnonzero(centres[1] < 0.5))
        np.testing.assert_array_equal(np.sort(new.subdomains["upper"]), np.flatnonzero(centres[1] > 0.5))
        assert len(new.subdomains["wide"]) == new.t.shape[1]

    @pytest.mark.parametrize("top", [0.7, 1.1], ids=["ends inside", "cuts in two"])
    def test_of_a_line_within_a_subdomain_are_kept(self, top: float) -> None:
        mesh = shapes.rectangle(6, 6)
        on = np.isclose(mesh.p[0], 1 / 3) & (mesh.p[1] < top)
        mesh = mesh.with_boundaries({**mesh.boundaries, "line": np.flatnonzero(on[mesh.facets].all(axis=0))})
        new = made(mesh, 0.08)
        assert sizes(new) == pytest.approx(sizes(mesh), rel=1e-12)
        np.testing.assert_allclose(middles(new, "line")[0], 1 / 3, atol=1e-12)
        assert (new.boundaries["line"].size > 8) == (top > 1)  # kept as it is where it ends inside


class TestDomain:
    @pytest.mark.parametrize("length", [0.1, 0.4])
    def test_l_shape_keeps_its_corners(self, length: float) -> None:
        mesh = shapes.l_shape(0.25)
        new = made(mesh, length)
        assert sizes(new) == pytest.approx(sizes(mesh), rel=1e-12)
        off = np.abs(new.p[:, :, None] - mesh.p[:, None, corner_nodes(mesh)]).max(axis=0).min(axis=0)
        assert np.all(off < 1e-12)
        # counter-clockwise, and edges about as long as asked for
        edges = new.p[:, new.facets[0]] - new.p[:, new.facets[1]]
        assert 0.5 * length < np.median(np.linalg.norm(edges, axis=0)) < 1.5 * length

    def test_several_bodies_stay_apart(self) -> None:
        one = shapes.rectangle(4, 4)
        p = np.hstack([one.p, one.p + np.array([[1.1], [0.3]])])
        new = made(MeshTri(p, np.hstack([one.t, one.t + one.p.shape[1]])), 0.12)
        assert sizes(new) == pytest.approx({"": 2.0}, rel=1e-12)  # without names, as they were
        left = np.all(new.p[0, new.t] < 1 + 1e-9, axis=0)
        right = np.all(new.p[0, new.t] > 1.1 - 1e-9, axis=0)
        assert np.all(left ^ right)
        assert np.abs(signed_areas(new.p, new.t[:, left])).sum() == pytest.approx(1.0, rel=1e-12)

    def test_edges_are_stretched_as_the_metric_says(self) -> None:
        mesh = shapes.rectangle(8, 8)
        tensors = uniform(mesh, 0.05) * np.array([[1.0], [0.0], [1 / 16]])  # four times as long in y
        new = remeshed(mesh, tensors, line_facets(mesh), corner_nodes(mesh))
        dx, dy = np.abs(new.p[:, new.facets[0]] - new.p[:, new.facets[1]]).mean(axis=1)
        assert 2.5 < dy / dx < 6


class TestErrors:
    def test_without_mmgpy_it_says_what_to_install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(mmg, "is_available", lambda: False)
        with pytest.raises(BadInputError, match=r"pip install 'rmesh-nlp\[remesh\]'"):
            made(shapes.rectangle(2, 2), 0.3)

    def test_what_mmg_says_is_passed_on(self, monkeypatch: pytest.MonkeyPatch) -> None:
        import mmgpy

        def fail(*_: object, **__: object) -> None:
            raise RuntimeError("no memory")

        monkeypatch.setattr(mmgpy.MmgMesh2D, "remesh", fail)
        monkeypatch.setattr(mmg._mmg, "ask", lambda line: Answer(mmg._made(line), "", None, 0.0))
        with pytest.raises(BadInputError, match="Mmg cannot remesh this domain: no memory"):
            made(shapes.rectangle(2, 2), 0.3)
        monkeypatch.setattr(mmg._mmg, "ask", lambda *_: Answer(None, "died", -11, 0.0))
        with pytest.raises(BadInputError, match="it ended with code -11"):
            made(shapes.rectangle(2, 2), 0.3)


class TestEnds:
    """Mmg has handlers of its own, of which that for Ctrl-C ends the process, and looks at no clock."""

    @pytest.mark.parametrize("within", [False, True], ids=["main thread", "another thread"])
    def test_ctrl_c_after_a_remeshing_is_a_keyboard_interrupt(self, within: bool) -> None:
        if within:
            with ThreadPoolExecutor(1) as pool:
                pool.submit(made, shapes.rectangle(3, 3), 0.2).result()
        else:
            made(shapes.rectangle(3, 3), 0.2)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)

    @pytest.mark.slow
    @pytest.mark.parametrize("by", ["time limit", "Ctrl-C"])
    def test_a_large_mesh_is_given_up(self, by: str) -> None:
        """Where the metric asks for a thousand million triangles."""
        mesh = shapes.rectangle(3, 3)
        made(mesh, 0.2)  # the process is there
        budget, least = Budget(Limits(0.3 if by == "time limit" else 60.0)), threading.Timer(0.3, press)
        if by == "Ctrl-C":
            least.start()
        with pytest.raises(StoppedError if by == "time limit" else KeyboardInterrupt):
            checked(budget.check, lambda: made(mesh, 3e-5))
        assert 0.2 < budget.elapsed < 10
        assert mmg._mmg.megabytes == 0  # no process is left
        assert sizes(made(mesh, 0.2)) == pytest.approx(sizes(mesh))


def press() -> None:
    os.kill(os.getpid(), signal.SIGINT)
