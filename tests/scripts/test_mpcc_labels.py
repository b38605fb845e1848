"""Points of known label, and what the package says of some of them."""

import numpy as np
import pytest

from check_mpcc_labels import main, verdict
from mpcc_library.labels import (
    Active,
    Point,
    dependent,
    descends_by_search,
    label_by_search,
    regular,
    tangled,
)
from rmesh_nlp.mpcc import classify


@pytest.fixture(autouse=True, scope="module")
def few_blocks():
    """Of each kind some: most of the time goes into the search for blocks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpcc_library.labels._BLOCKS", 100)
        yield


@pytest.mark.parametrize(
    ("c", "label", "descends"),
    [
        ([1.0, 1.0], "S", False),
        ([-1.0, 0.0], "M", True),
        ([-1.0, -1.0], "C", True),
        ([1.0, -1.0], "W", True),
        ([1.0, 1.0, 1.0], "none", True),  # a free unknown with slope
    ],
)
def test_search_finds_the_label_of_a_corner(c, label, descends):
    n = len(c)
    data = Active(np.array(c), np.zeros((0, n)), np.zeros(0), np.eye(n)[:1], np.eye(n)[1:2])
    assert (label_by_search(data), descends_by_search(data)) == (label, descends)


def test_search_knows_a_point_that_is_b_but_not_s():
    """min x + y - z, z <= 4 x, z <= 4 y of Scheel and Scholtes: the multipliers of S are missing."""
    A = np.array([[-4.0, 0, 1], [0, -4.0, 1]])
    data = Active(np.array([1.0, 1, -1]), A, np.array([1, 1]), np.eye(3)[:1], np.eye(3)[1:2])
    assert (label_by_search(data), descends_by_search(data)) == ("M", False)


@pytest.mark.parametrize("make", [regular, dependent, tangled])
@pytest.mark.parametrize("seed", range(5))
def test_labels_are_those_that_are_known(make, seed):
    point = make(seed, 1, 7)
    found = classify(point.mpcc, point.x)
    assert found.biactive.size == point.n_biactive
    assert verdict(point, found.stationarity, found.b_stationary) == "right"


@pytest.mark.parametrize("seed", range(2))
def test_labels_with_many_biactive_pairs_are_never_wrong(seed):
    point = dependent(seed, 8, 12)
    found = classify(point.mpcc, point.x)
    assert verdict(point, found.stationarity, found.b_stationary) != "wrong"


@pytest.mark.parametrize(
    ("known", "said", "word"),
    [
        (("M", True), ("M", True), "right"),
        (("M", None), ("M", False), "right"),
        (("M", True), ("M", None), "undecided"),
        (("M", True), ("at least C", True), "undecided"),
        (("W", False), ("at least C", False), "wrong"),
        (("M", True), ("C", True), "wrong"),
        (("C", False), ("M", False), "wrong"),
        (("M", True), ("M", False), "wrong"),
        (("M", True), ("", None), "wrong"),
    ],
)
def test_verdict_tells_wrong_from_undecided(known, said, word):
    point = Point("", regular(0, 1, 1).mpcc, np.zeros(1), 1, *known)
    assert verdict(point, *said) == word


def test_script_prints_a_table_and_finds_nothing_wrong(capsys):
    assert main(["--few", "3", "--many", "0"]) == 0
    assert "0 wrong" in capsys.readouterr().out
