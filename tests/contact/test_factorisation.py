"""Factors of stiffness matrices by SuperLU and by CHOLMOD: solutions, Schur complements, indefinite ones."""

import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.contact import factorisation
from rmesh_nlp.contact.factorisation import HAS_CHOLMOD, condensed, factorised
from rmesh_nlp.solving.entries import versions


@pytest.fixture(
    params=[False, pytest.param(True, marks=pytest.mark.skipif(not HAS_CHOLMOD, reason="no CHOLMOD"))]
)
def by_cholmod(request, monkeypatch) -> bool:
    monkeypatch.setattr(factorisation, "HAS_CHOLMOD", request.param)
    return request.param


def stiffness(n: int, seed: int = 0) -> sp.csc_array:
    """A sparse symmetric positive definite matrix."""
    half = sp.csr_array(sp.random(n, n, density=0.1, random_state=seed))
    return sp.csc_array(half @ half.T + sp.eye_array(n))


def test_solutions_of_one_and_of_many_right_sides(by_cholmod) -> None:
    K, B = stiffness(40), np.random.default_rng(1).standard_normal((40, 3))
    solve = factorised(K)
    exact = np.linalg.solve(K.toarray(), B)
    np.testing.assert_allclose(solve(B), exact, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(solve(B[:, 0]), exact[:, 0], rtol=1e-10, atol=1e-12)


def test_condensed_stiffness_is_a_schur_complement() -> None:
    K, F, last = stiffness(40), np.random.default_rng(2).standard_normal(40), np.array([3, 8, 9, 20, 21, 39])
    rest, dense = np.setdiff1d(np.arange(40), last), K.toarray()
    a, b, c = dense[np.ix_(rest, rest)], dense[np.ix_(rest, last)], dense[np.ix_(last, last)]
    S, load = condensed(K, F, last)
    np.testing.assert_allclose(S, c - b.T @ np.linalg.solve(a, b), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(load, F[last] - b.T @ np.linalg.solve(a, F[rest]), rtol=1e-9, atol=1e-12)


def test_an_indefinite_matrix_is_solved_too(by_cholmod) -> None:
    K = sp.csc_array(np.diag([2.0, -1.0, 3.0]))
    np.testing.assert_allclose(factorised(K)(np.ones(3)), [0.5, -1.0, 1 / 3])


def test_the_record_says_what_factorised() -> None:
    assert ("scikit-sparse" in versions()) == HAS_CHOLMOD
