"""Quadratic functions for descents."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.optimize.trust_region import Evaluation


class Matrix:
    """A constant Hessian."""

    def __init__(self, A: np.ndarray) -> None:
        self.A = A

    def __call__(self, d: np.ndarray) -> np.ndarray:
        return self.A @ d

    def diagonal(self) -> np.ndarray:
        return np.abs(np.diag(self.A)) + 1e-3


def quadratic(A: np.ndarray, b: np.ndarray, x: np.ndarray) -> Evaluation:
    """1/2 x^T A x - b^T x."""
    return Evaluation(0.5 * x @ A @ x - b @ x, A @ x - b, lambda: Matrix(A))


def convex(rng: np.random.Generator, n: int) -> np.ndarray:
    """A positive definite matrix."""
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)
