"""Stationarity labels and B-stationarity against brute force over the branches.

Two experiments with random problems. At random corners with linear data, the label of ``classify`` is
compared with an enumeration of all sign patterns of the multipliers (S, M, C, W) and of all branches (B). And
solutions of random QPECs by ``solve`` are put to the same test. The enumeration is dense, uses scipy's
linprog alone, and shares no code with the solver.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence

import casadi as ca
import numpy as np
from scipy.optimize import linprog

from rmesh_nlp.mpcc import MPCC, classify, solve

S, M, C = ((-1, -1),), ((-1, -1), (0, 2), (2, 0)), ((-1, -1), (1, 1))
LIMITS = {-1: (None, 0), 0: (0, 0), 1: (0, None), 2: (None, None)}
TOLERANCE = 1e-6


def corner(random: np.random.Generator, pairs: int) -> tuple[MPCC, dict[str, np.ndarray]]:
    """Linear data at the origin: pairs ``A_G x _|_ A_H x`` all biactive, rows ``B x >= 0``, slope c.

    Small integers make coincidences: redundant rows and multipliers that are zero.
    """
    n, m = pairs + int(random.integers(1, 4)), int(random.integers(0, 3))
    data = {
        "G": random.integers(-1, 2, (pairs, n)).astype(float),
        "H": random.integers(-1, 2, (pairs, n)).astype(float),
        "B": random.integers(-1, 2, (m, n)).astype(float),
    }
    rows = np.vstack([data["G"], data["H"], data["B"]])
    multipliers = random.integers(-1, 3, rows.shape[0]).astype(float)
    multipliers[2 * pairs :] = np.abs(multipliers[2 * pairs :])
    data["c"] = rows.T @ multipliers + (random.uniform() < 0.1) * random.normal(size=n)
    x = ca.SX.sym("x", n)
    g = data["B"] @ x if m else None
    return MPCC(x, ca.dot(data["c"], x), g, data["G"] @ x, data["H"] @ x, lbg=0), data


def exists(data: dict[str, np.ndarray], pieces: Sequence[tuple[int, int]]) -> bool:
    """Whether ``c + G^T nu_G + H^T nu_H + B^T lam = 0`` with the signs of ``pieces`` and lam <= 0."""
    matrix = np.vstack([data["G"], data["H"], data["B"]]).T
    bounds = [LIMITS[a] for a, _ in pieces] + [LIMITS[b] for _, b in pieces]
    bounds += [(None, 0)] * data["B"].shape[0]
    slack = TOLERANCE * max(1.0, float(np.max(np.abs(data["c"]), initial=0.0)))
    answer = linprog(
        np.zeros(matrix.shape[1]), A_ub=np.vstack([matrix, -matrix]),
        b_ub=np.concatenate([slack - data["c"], slack + data["c"]]), bounds=bounds,
    )  # fmt: skip
    return bool(answer.status == 0)


def label(data: dict[str, np.ndarray]) -> str:
    """The strongest label by enumeration."""
    k = data["G"].shape[0]
    for name, pieces in (("S", S), ("M", M), ("C", C)):
        if any(exists(data, choice) for choice in itertools.product(pieces, repeat=k)):
            return name
    return "W" if exists(data, [(2, 2)] * k) else "none"


def b_stationary(data: dict[str, np.ndarray]) -> bool:
    """Whether no branch has a descent direction in the unit box."""
    k, n = data["G"].shape
    slope = max(1.0, float(np.max(np.abs(data["c"]), initial=0.0)))
    for sides in itertools.product((True, False), repeat=k):
        on_G = np.array(sides, dtype=bool)
        equal = np.vstack([data["G"][on_G], data["H"][~on_G]])
        above = -np.vstack([data["H"][on_G], data["G"][~on_G], data["B"]])
        answer = linprog(
            data["c"], A_ub=above, b_ub=np.zeros(above.shape[0]), A_eq=equal, b_eq=np.zeros(equal.shape[0]),
            bounds=[(-1, 1)] * n,
        )  # fmt: skip
        if answer.status == 0 and answer.fun < -10 * TOLERANCE * slope:
            return False
    return True


def check_corner(seed: int, most: int) -> tuple[str, str]:
    """Label a random corner twice; returns the label and a fault, empty if there is none."""
    random = np.random.default_rng([20, seed])
    mpcc, data = corner(random, int(random.integers(1, most + 1)))
    found = classify(mpcc, np.zeros(mpcc.n_x))
    expected, b = label(data), b_stationary(data)
    if (found.stationarity, found.b_stationary) == (expected, b):
        return expected, ""
    return (
        expected,
        f"corner {seed}: {found.stationarity}, B {found.b_stationary}; brute force {expected}, B {b}",
    )


def check_solution(seed: int, most: int) -> tuple[str, str]:
    """Solve a random QPEC and put its solution to the test of all branches around it."""
    random = np.random.default_rng([21, seed])
    k = int(random.integers(1, most + 1))
    n = max(1, k // 2)
    M_ = np.eye(k) + 0.3 * random.normal(size=(k, k)) / np.sqrt(k)
    N, q = random.normal(size=(k, n)), random.normal(size=k)
    x, y = ca.SX.sym("x", n), ca.SX.sym("y", k)
    target = random.normal(size=n + k)
    z = ca.vertcat(x, y)
    f = ca.sumsqr(z - target)
    mpcc = MPCC(z, f, None, y, N @ x + M_ @ y + q)
    result = solve(mpcc, random.normal(size=n + k))
    if not result.success:
        return result.status.value, f"QPEC {seed}: {result.status.value}"
    point = result.x
    G_all, H_all = np.hstack([np.zeros((k, n)), np.eye(k)]), np.hstack([N, M_])
    G, H = point[n:], H_all @ point + q
    zero_G, zero_H = np.abs(G) <= TOLERANCE, np.abs(H) <= TOLERANCE
    both = zero_G & zero_H
    fixed = np.vstack([G_all[zero_G & ~both], H_all[zero_H & ~both]])
    data = {
        "G": G_all[both], "H": H_all[both], "B": np.vstack([fixed, -fixed]), "c": 2 * (point - target),
    }  # fmt: skip
    faults = []
    if not b_stationary(data):
        faults.append("a branch descends")
    expected = label(data) if np.count_nonzero(both) <= 5 else result.stationarity
    if result.stationarity != expected:
        faults.append(f"label {result.stationarity}, brute force {expected}")
    return result.stationarity, f"QPEC {seed}: {'; '.join(faults)}" if faults else ""


def labels_agree(problems: int, pairs: int = 10, seed: int = 0) -> bool:
    """Check half as many corners and half as many solutions, print counts, and say whether all agree.

    Corners have at most 4 pairs, QPECs at most ``pairs``.
    """
    faults = []
    for name, check, most in (
        ("random corners", check_corner, min(pairs, 4)),
        ("solutions of QPECs", check_solution, pairs),
    ):
        outcomes = [check(one, most) for one in range(seed, seed + problems // 2)]
        wrong = [fault for _, fault in outcomes if fault]
        faults += wrong
        counts = ", ".join(f"{n} {word}" for word, n in Counter(word for word, _ in outcomes).most_common())
        print(f"{name}: {len(outcomes)} ({counts}), {len(wrong)} disagree")
    print("\n".join(faults))
    return not faults
