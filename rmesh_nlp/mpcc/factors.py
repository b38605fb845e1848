"""Sparse LU of symmetric systems, with the few dense rows apart.

A design variable that enters every equation is a dense row and column of the KKT matrix. LU with pivoting
fills the whole matrix once such a row is chosen. So they are bordered: with A the sparse block,
``[A B; B^T C]`` is solved by A and the dense Schur complement ``C - B^T A^-1 B``, and refined.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import IntArray
from rmesh_nlp.optimize.budget import Budget

T = TypeVar("T")
_LARGE = 2000  # rows of a system whose dense rows cost more than the border
_DENSE = 2.0  # entries of a dense row, in units of the square root of the size

Solve = Callable[[Array], Array]
"""The solution for a right side."""


def factorised(system: sp.csc_matrix, use: Callable[[Solve], T], budget: Budget | None = None) -> T:
    """What ``use`` makes of the factors, within a budget.

    SuperLU's memory is given back only in the thread in which it was taken, so the factors stay in there:
    ``use`` must not keep the function that it is given.

    Raises
    ------
    RuntimeError
        If the matrix, or its sparse block, is exactly singular.
    StoppedError
        If it takes longer.
    """
    return (budget or Budget()).within(lambda: use(_solution(system)))


def _solution(system: sp.csc_matrix) -> Solve:
    n, root = system.shape[0], np.sqrt(system.shape[0])
    is_dense = np.diff(system.indptr) > _DENSE * root
    if n < _LARGE or not 0 < np.count_nonzero(is_dense) < root:
        factors = _lu(system)
        return lambda right: np.asarray(factors.solve(right))
    return _bordered(system, np.flatnonzero(~is_dense), np.flatnonzero(is_dense))


def _bordered(system: sp.csc_matrix, inner: IntArray, outer: IntArray) -> Solve:
    sparse, border = system[inner][:, inner].tocsc(), system[inner][:, outer].toarray()
    factors = _lu(sparse)
    through = factors.solve(border)
    complement = system[outer][:, outer].toarray() - border.T @ through

    def once(right: Array) -> Array:
        solution = np.zeros(right.size)
        first = factors.solve(right[inner])
        solution[outer] = np.linalg.lstsq(complement, right[outer] - border.T @ first, rcond=None)[0]
        solution[inner] = first - through @ solution[outer]
        return solution

    def refined(right: Array) -> Array:
        solution = once(right)
        return solution + once(right - system @ solution)

    return refined


def _lu(system: sp.csc_matrix) -> sp.linalg.SuperLU:
    """COLAMD: of a KKT matrix of 5,000 rows minimum degree of A^T + A takes a hundred times as long."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return splu(system, permc_spec="COLAMD")
