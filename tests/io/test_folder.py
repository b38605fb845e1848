"""Files are whole or not there, and nothing but own files is replaced or moved."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.folder import (
    MANIFEST,
    TEMPORARY,
    Manifest,
    append_whole,
    folder_lock,
    remove_leftovers,
    safe_name,
    write_text,
    write_whole,
)

NAMES = ["/abs/path", "../../esc", "..", ".", "", "a/b", "a\\b", "-rf", ".rmesh-files", "a\0b", "x\ud800"]


@pytest.mark.parametrize("name", [*NAMES, "ü" * 400])
def test_any_text_becomes_the_name_of_one_file(tmp_path, name):
    safe = safe_name(name)
    (tmp_path / safe).write_text("")
    assert [path.name for path in tmp_path.iterdir()] == [safe]
    assert safe[0] not in ".-"
    assert safe_name(safe) == safe
    assert safe_name(f"{name}{'x' * 300}a") != safe_name(f"{name}{'x' * 300}b")


def test_what_fails_while_it_is_written_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")

    places = []

    def half(aside):
        places.append(aside.parent)
        aside.write_text("ha")
        raise OSError("disk full")

    for _ in range(2):
        with pytest.raises(OSError, match="disk full"):
            write_whole(path, half)
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]
    assert places[0] != places[1]  # nobody can foresee where a file is written
    assert str(os.getpid()) not in places[0].name


def test_interrupt_while_the_temporary_folder_is_removed_leaves_only_the_file(tmp_path, monkeypatch):
    path, remove = tmp_path / "file", shutil.rmtree

    def interrupted(*given, **options):
        signal.raise_signal(signal.SIGINT)
        remove(*given, **options)

    monkeypatch.setattr(shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_text(path, "new")
    assert [(file, file.read_text()) for file in tmp_path.iterdir()] == [(path, "new")]


def test_links_are_replaced_not_followed(tmp_path):
    victim, path = tmp_path / "victim", tmp_path / "table.md"
    victim.write_text("mine")
    path.symlink_to(victim)
    write_text(path, "new")
    assert (victim.read_text(), path.read_text(), path.is_symlink()) == ("mine", "new", False)
    path.unlink()
    path.symlink_to(victim)
    with pytest.raises(OSError, match="table"):
        append_whole(path, "x")
    assert victim.read_text() == "mine"


WRITER = """
import sys, time
from pathlib import Path
from rmesh_nlp.io.folder import folder_aside, folder_lock
with folder_lock(folder := Path(sys.argv[1])), folder_aside(folder / "figures") as place:
    (place / "half").write_text("ha")
    print(place, flush=True)
    time.sleep(60)
"""


def test_a_writer_that_is_killed_leaves_no_lock_and_no_files(tmp_path):
    folder, elsewhere = tmp_path / "results", tmp_path / "elsewhere" / f"{TEMPORARY}x"
    elsewhere.mkdir(parents=True)
    folder.mkdir()
    (folder / "link").symlink_to(elsewhere.parent)
    command = [sys.executable, "-c", WRITER, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        half = Path(process.stdout.readline().strip()) / "half"
        remove_leftovers(folder)
        assert half.read_text() == "ha"
        with pytest.raises(BadInputError, match=str(process.pid)), folder_lock(folder):
            pass
        process.kill()
    (tmp_path / "to-results").symlink_to(folder)
    with folder_lock(folder):
        remove_leftovers(tmp_path / "to-results")  # also through a link to the folder
    assert not half.parent.exists()
    assert half.parent.parent.exists()
    assert elsewhere.exists()


def test_a_link_of_the_user_s_is_not_claimed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "solutions").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(BadInputError, match="solutions is a link"):
        Manifest(tmp_path).claim("solutions/a.vtu")


@pytest.mark.parametrize(
    "name", ["../victim/a", "{outside}/a", "sub/a", "sub/../victim/a", "deep/sub/a", "link", "a\0b/c"]
)
def test_a_list_that_leads_out_of_its_folder_is_not_followed(tmp_path, name):
    inside, outside = tmp_path / "in", tmp_path / "victim"
    outside.mkdir()
    (inside / "deep").mkdir(parents=True)
    (outside / "a").write_text("mine")
    for link, target in (("sub", outside), ("deep/sub", outside), ("link", outside / "a")):
        (inside / link).symlink_to(target)
    (inside / MANIFEST).write_text(f"{name.format(outside=outside)}\nown\n")
    (inside / "own").write_text("ours")
    manifest = Manifest(inside)
    assert manifest.names() == ["own"]
    manifest.remove([name, "own"])
    assert manifest.set_aside() is None
    assert ((outside / "a").read_text(), (inside / "link").is_symlink()) == ("mine", True)
