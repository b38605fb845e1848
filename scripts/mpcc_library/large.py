"""Families whose size matters: control and design over a grid, ``size`` pairs (a square number)."""

from __future__ import annotations

import functools
from collections.abc import Callable

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc import MPCC, Problem


def _grid(size: int) -> tuple[int, float, Array, Array]:
    """Interior nodes per side of the unit square, their distance, and their coordinates."""
    m = round(size**0.5)
    if m * m != size:
        raise ValueError(f"{size} pairs are no square grid")
    x, y = np.meshgrid(*[np.arange(1, m + 1) / (m + 1)] * 2)
    return m, 1 / (m + 1), x.ravel(), y.ravel()


def _differences(m: int) -> sp.csc_matrix:
    """Differences of neighbours on the grid, zero outside: D^T D is the 5-point Laplacian times h^2."""
    line = sp.diags([np.ones(m), -np.ones(m)], [0, -1], shape=(m + 1, m))
    return sp.csc_matrix(sp.vstack([sp.kron(sp.identity(m), line), sp.kron(line, sp.identity(m))]))


def obstacle_control(size: int, seed: int) -> Problem:
    """Least |u - u_d|^2 + 1e-3 |f|^2 subject to -Laplace u = f + xi, 0 <= xi _|_ u >= 0, from 0."""
    m, h, x, y = _grid(size)
    differences = _differences(m)
    laplace = ca.DM(sp.csc_matrix(differences.T @ differences) / h**2)
    shift = 0.02 * np.random.default_rng([51, size, seed]).uniform(0.5, 1.5)
    wanted = 0.5 * np.sin(2 * np.pi * x) * np.sin(2 * np.pi * y) - shift
    v = ca.SX.sym("v", 3 * size)
    u, f, xi = ca.vertsplit(v, [0, size, 2 * size, 3 * size])
    cost = h**2 * (ca.sumsqr(u - wanted) + 1e-3 * ca.sumsqr(f))
    mpcc = MPCC(v, cost, ca.mtimes(laplace, u) - f - xi, xi, u, lbg=0, ubg=0)
    return Problem(f"obstacle-control-{size}-{seed}", mpcc, np.zeros(3 * size))


def membrane(size: int, seed: int, *, of_pressure: bool = False) -> Problem:
    """Stiffnesses of 3 by 3 parts of a membrane over a foundation, of mean at most 1, for a wanted shape.

    ``of_pressure``: for a wanted contact pressure that no stiffness reaches, since it has no gap at the rim.
    """
    m, h, x, y = _grid(size)
    differences = _differences(m)
    places = np.vstack([x, y])
    middle = abs(differences) @ places.T / np.asarray(abs(differences).sum(axis=1))
    column, row = np.minimum((3 * middle.T).astype(int), 2)
    at = np.arange(column.size), 3 * row + column
    part = sp.csc_matrix((np.ones(column.size), at), shape=(column.size, 9))
    load = -2.0 * np.random.default_rng([52, size, seed]).uniform(0.9, 1.1) * h**2
    ground = -0.05 - 0.1 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)
    v = ca.SX.sym("v", 9 + 2 * size)
    stiffness, u, force = ca.vertsplit(v, [0, 9, 9 + size, 9 + 2 * size])
    D = ca.DM(differences)
    balance = ca.mtimes(D.T, ca.mtimes(ca.DM(part), stiffness) * ca.mtimes(D, u)) - load - force
    miss = force / h**2 - (1.0 + x) if of_pressure else u + 0.04 + 0.02 * x
    cost = h**2 * ca.sumsqr(miss) + 1e-3 / 9 * ca.sumsqr(stiffness - 1)
    lower = np.append(np.full(9, 0.2), np.full(2 * size, -np.inf))
    upper = np.append(np.full(9, 5.0), np.full(2 * size, np.inf))
    none = np.zeros(size)
    mpcc = MPCC(
        v, cost, ca.vertcat(balance, ca.sum1(stiffness) / 9), force, u - ground,
        lbx=lower, ubx=upper, lbg=np.append(none, 0.0), ubg=np.append(none, 1.0),
    )  # fmt: skip
    name = "membrane-pressure" if of_pressure else "membrane"
    return Problem(f"{name}-{size}-{seed}", mpcc, np.append(np.ones(9), np.zeros(2 * size)))


LARGE: dict[str, tuple[Callable[[int, int], Problem], tuple[int, ...]]] = {
    "obstacle-control": (obstacle_control, (400, 1600, 4900, 10_000, 40_000, 99_856)),
    "membrane": (membrane, (400, 1600, 4900, 10_000)),
    "membrane-pressure": (functools.partial(membrane, of_pressure=True), (400, 1600, 3600, 10_000)),
}
