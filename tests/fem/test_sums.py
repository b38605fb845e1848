import numpy as np
import pytest

from rmesh_nlp.fem.sums import Entries, Sums


def entries(seed: int, shape: tuple[int, int], local: tuple[int, int], *, scaled: bool) -> Entries:
    """Places, some of them taken twice and some dropped."""
    rng = np.random.default_rng(seed)
    row, column = (rng.integers(-1, n, local) for n in shape)
    return Entries(row, column, rng.standard_normal(local) if scaled else None)


@pytest.mark.parametrize("shape", [(5, 7), (6, 1), (1, 1)])
@pytest.mark.parametrize("scaled", [False, True])
def test_nonzeros_are_the_sums_of_their_results(shape, scaled) -> None:
    parts = [entries(1, shape, (3, 20), scaled=scaled), entries(2, shape, (2, 9), scaled=False)]
    sums, results = Sums(shape, parts), np.random.default_rng(3).standard_normal(78)
    expected, filled = np.zeros(shape), np.zeros(shape, dtype=bool)
    flat = [np.concatenate([np.ravel(getattr(part, axis)) for part in parts]) for axis in ("row", "column")]
    scale = np.concatenate([np.ones(p.row.size) if p.scale is None else p.scale.ravel() for p in parts])
    for i, j, factor, result in zip(*flat, scale, results, strict=True):
        if i >= 0 and j >= 0:
            expected[i, j] += factor * result
            filled[i, j] = True
    matrix = sums.numbered.astype(float)
    np.testing.assert_array_equal(matrix.data, 1 + np.arange(sums.n))
    matrix.data = sums(results)
    np.testing.assert_allclose(matrix.toarray(), expected, rtol=1e-12, atol=1e-14)
    assert sums.n_local == 78
    assert sums.pattern.nnz() == sums.n == (filled.sum() if shape[1] > 1 else shape[0])
    np.testing.assert_array_equal(sums.pattern.row(), matrix.indices)


def test_results_by_element_go_to_the_same_places() -> None:
    shape = (5, 7)
    parts = [entries(1, shape, (3, 20), scaled=True), entries(2, shape, (2, 9), scaled=True)]
    sums, rng = Sums(shape, parts), np.random.default_rng(3)
    local = [rng.standard_normal(part.row.shape) for part in parts]
    found = sums(np.concatenate([one.ravel() for one in local]))
    by_element = sum(
        sums.by_element(number, one.shape).full() @ one.ravel(order="F") for number, one in enumerate(local)
    )
    np.testing.assert_allclose(by_element, found, rtol=1e-12, atol=1e-14)


def test_sums_of_nothing_have_no_nonzeros() -> None:
    sums = Sums((4, 3), [])
    assert (sums.n, sums.n_local, sums(np.zeros(0)).size) == (0, 0, 0)
    np.testing.assert_array_equal(Sums((4, 1), [])(np.zeros(0)), np.zeros(4))
