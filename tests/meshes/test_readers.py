"""Mesh files of unknown origin: a reader that does not end is stopped, other formats are refused."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from rmesh_nlp.meshes.reading import read_file


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "content"),
    [("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\n"), ("a.off", "OFF\n"), ("a.msh", "garbage")],
)
def test_a_reader_that_never_ends_is_stopped(
    tmp_path: Path, name: str, content: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmesh_nlp.meshes.reading.SECONDS", 0.3)
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match="cannot be read as a mesh"):
        read_file(tmp_path / name)


@pytest.mark.slow
def test_a_reader_that_waits_for_the_processor_is_not_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rmesh_nlp.meshes.reading.SECONDS", 0.1)
    monkeypatch.setattr("meshio.read", lambda *_: time.sleep(0.3) or "a mesh")
    (tmp_path / "a.vtk").write_text("x")
    assert read_file(tmp_path / "a.vtk") == "a mesh"


def test_only_formats_of_the_extension_and_files_of_moderate_size_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.xyz").write_text("$MeshFormat")
    with pytest.raises(ValueError, match=r"the extension '\.xyz' is none of"):
        read_file(tmp_path / "a.xyz")
    monkeypatch.setattr("rmesh_nlp.meshes.reading.LARGEST_FILE", 5)
    (tmp_path / "a.vtk").write_text("too long")
    with pytest.raises(ValueError, match="has 8 bytes"):
        read_file(tmp_path / "a.vtk")
