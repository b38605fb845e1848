"""The version of a tag stands in every file that states one."""

import shutil

import pytest

import rmesh_nlp as rm
import set_version


def test_every_file_states_the_version_of_the_package() -> None:
    assert set_version.versions() == {key: [rm.__version__] for key in set_version.PLACES}


def test_the_version_of_a_tag_is_written_into_each(tmp_path):
    for name in set_version.PLACES:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(set_version.ROOT / name, tmp_path / name)
    set_version.write("1.20.3rc1", tmp_path)
    assert set_version.versions(tmp_path) == {key: ["1.20.3rc1"] for key in set_version.PLACES}
    with pytest.raises(ValueError, match="'main' is no version"):
        set_version.write("main", tmp_path)
