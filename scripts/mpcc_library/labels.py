"""Points of MPCCs whose stationarity is known, by construction or by a search over signs and branches.

Nothing here uses the package's own labels. Three kinds of points:

- *regular*: all active gradients are independent and the multipliers are prescribed. There are no others, so
  their signs are the label, and B-stationarity is the same as S.
- *dependent*: integer gradients that depend on each other, in blocks of one to three biactive pairs. Of each
  block every choice of signs and of branches is searched. Blocks share no unknown, so the label of several is
  the weakest of theirs, and they descend where one of them does. An orthogonal change of the unknowns then
  hides the blocks.
- *tangled*: up to as many random rows as pairs, all active, so that multipliers are far from unique and no
  block separates. They have multipliers of M, C or W by construction; a stronger label and descent are
  searched. What the search does not decide is drawn again, or for B-stationarity left unknown.

Signs as in CasADi: ``c + A^T lam + G^T nu_G + H^T nu_H = 0`` with ``lam <= 0`` at a lower bound.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import linprog

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc import MPCC

Piece = tuple[tuple[float | None, float | None], tuple[float | None, float | None]]
LABELS = ("S", "M", "C", "W", "none")
_LOW, _ZERO, _HIGH, _FREE = (None, 0.0), (0.0, 0.0), (0.0, None), (None, None)
_PIECES = {
    "S": ((_LOW, _LOW),),
    "M": ((_LOW, _LOW), (_ZERO, _FREE), (_FREE, _ZERO)),
    "C": ((_LOW, _LOW), (_HIGH, _HIGH)),
    "W": ((_FREE, _FREE),),
}
_BLOCKS, _NEGATIVE = 250, -1e-7
_PROGRAMS = 3000
"""Linear programs of a search; what is not found out by then counts as unknown."""


class _GivenUpError(Exception):
    """A search has used up its linear programs."""


@dataclass(frozen=True, eq=False)
class Active:
    """First-order data at a point where everything is active: gradients c (n), rows A (m, n), pairs (k, n).

    ``kinds`` (m): -1 at the lower bound, 1 at the upper, 0 at both (an equation).
    """

    c: Array
    A: Array
    kinds: Array
    G: Array
    H: Array


@dataclass(frozen=True, eq=False)
class Point:
    """A feasible point of an MPCC, its label, and whether it is B-stationary (None: unknown)."""

    name: str
    mpcc: MPCC
    x: Array
    n_biactive: int
    label: str
    b_stationary: bool | None


def label_by_search(data: Active) -> str:
    """The strongest label for which multipliers exist, over all choices of signs."""
    k, matrix = data.G.shape[0], np.vstack([data.A, data.G, data.H]).T
    rows = [{-1: _LOW, 0: _FREE, 1: _HIGH}[int(kind)] for kind in data.kinds]
    programs_left = itertools.count(_PROGRAMS, -1)

    def exists(pieces: Sequence[Piece], chosen: list[Piece]) -> bool:
        if next(programs_left) <= 0:
            raise _GivenUpError
        pairs = chosen + [(_FREE, _FREE)] * (k - len(chosen))
        bounds = [*rows, *(G for G, _ in pairs), *(H for _, H in pairs)]
        if linprog(np.zeros(len(bounds)), A_eq=matrix, b_eq=-data.c, bounds=bounds).status != 0:
            return False
        return len(chosen) == k or any(exists(pieces, [*chosen, piece]) for piece in pieces)

    return next((name for name, pieces in _PIECES.items() if exists(pieces, [])), "none")


def descends_by_search(data: Active) -> bool:
    """Whether the objective falls to first order along some branch; both members are kept non-negative."""
    k, n = data.G.shape[0], data.c.size
    free, equal = data.kinds != 0, data.kinds == 0
    A_ub = np.vstack([data.kinds[free, None] * data.A[free], -data.G, -data.H])
    programs_left = itertools.count(_PROGRAMS, -1)

    def falls(sides: list[bool]) -> bool:
        if next(programs_left) <= 0:
            raise _GivenUpError
        fixed = np.vstack([data.A[equal], *((data.G if on_G else data.H)[i] for i, on_G in enumerate(sides))])
        result = linprog(
            data.c, A_ub=A_ub, b_ub=np.zeros(A_ub.shape[0]), A_eq=fixed, b_eq=np.zeros(fixed.shape[0]),
            bounds=[(-1.0, 1.0)] * n,
        )  # fmt: skip
        if result.fun > _NEGATIVE:
            return False
        return len(sides) == k or falls([*sides, True]) or falls([*sides, False])

    return falls([])


def random_block(random: np.random.Generator) -> Active:
    """Integer gradients of one to three pairs, whose members are unknowns, and of up to four rows."""
    k, m = int(random.integers(1, 4)), int(random.integers(0, 5))
    n = 2 * k + int(random.integers(1, 3))
    A, kinds = random.integers(-2, 3, (m, n)).astype(float), random.integers(-1, 2, m)
    lam = random.integers(0, 3, m) * np.where(kinds == 0, random.choice([-1, 1], m), kinds)
    nu = np.append(random.integers(-2, 2, 2 * k), np.zeros(n - 2 * k))
    c = -(A.T @ lam + nu) if random.uniform() < 0.9 else random.integers(-2, 3, n).astype(float)
    eye = np.eye(n)
    return Active(c, A, kinds, eye[:k], eye[k : 2 * k])


@functools.cache
def blocks() -> dict[tuple[str, bool], list[Active]]:
    """Random blocks by label and B-stationarity."""
    random, result = np.random.default_rng(7), {}
    for _ in range(_BLOCKS):
        block = random_block(random)
        result.setdefault((label_by_search(block), not descends_by_search(block)), []).append(block)
    return result


def dependent(seed: int, least: int, most: int) -> Point:
    """``least`` to ``most`` biactive pairs in blocks: one has the drawn label, the others none weaker."""
    random, pool = np.random.default_rng([1, seed]), blocks()
    keys = sorted(pool)
    label, b_stationary = keys[int(random.integers(len(keys)))]
    stronger = [
        key for key in keys
        if LABELS.index(key[0]) <= LABELS.index(label) and (key[1] or not b_stationary)
    ]  # fmt: skip
    few = [block for block in pool[label, b_stationary] if block.G.shape[0] <= most]
    wanted, own = int(random.integers(least, most + 1)), [few[int(random.integers(len(few)))]]
    while (missing := wanted - sum(block.G.shape[0] for block in own)) > 0:
        some = pool[stronger[int(random.integers(len(stronger)))]]
        block = some[int(random.integers(len(some)))]
        if block.G.shape[0] <= missing:
            own.append(block)
    data = Active(
        np.concatenate([block.c for block in own]), block_diag(*(block.A for block in own)),
        np.concatenate([block.kinds for block in own]),
        block_diag(*(block.G for block in own)), block_diag(*(block.H for block in own)),
    )  # fmt: skip
    return _stated(f"dependent-{seed}", data, random, label, b_stationary)


def regular(seed: int, least: int, most: int) -> Point:
    """``least`` to ``most`` biactive pairs, independent gradients, multipliers of a drawn label."""
    random = np.random.default_rng([2, seed])
    label, k = LABELS[int(random.integers(len(LABELS)))], int(random.integers(least, most + 1))
    m = int(random.integers(0, 4))
    gradients = np.linalg.qr(random.normal(size=(m + 2 * k + 2, m + 2 * k + 1)))[0].T
    gradients, outside = gradients[:-1], gradients[-1]
    gradients = random.uniform(0.5, 2.0, (len(gradients), 1)) * gradients + 0.1 * gradients[::-1]
    kinds, size = random.integers(-1, 2, m), lambda: random.uniform(0.2, 2.0)
    lam = [size() * (kind or random.choice([-1.0, 1.0])) for kind in kinds]
    own = {
        "S": lambda: random.choice([-1.0, 0.0], 2) * [size(), size()],
        "M": lambda: random.permutation([size(), 0.0]),
        "C": lambda: np.array([size(), size()]),
        "W": lambda: random.permutation([size(), -size()]),
    }
    names = LABELS[: LABELS.index(label) + 1 if label != "none" else 4]
    drawn = [label if label != "none" else "W", *random.choice(names, k - 1)]
    nu = np.array([own[name]() for name in random.permutation(drawn)])
    c = -(gradients.T @ np.concatenate([lam, nu[:, 0], nu[:, 1]]))
    c = c + outside if label == "none" else c
    data = Active(c, *np.split(gradients, [m])[:1], kinds, gradients[m : m + k], gradients[m + k :])
    return _stated(f"regular-{seed}", data, random, label, label == "S")


def tangled(seed: int, least: int, most: int) -> Point:
    """``least`` to ``most`` biactive pairs and up to as many rows."""
    random = np.random.default_rng([3, seed])
    while True:
        k = int(random.integers(least, most + 1))
        m, n = int(random.integers(max(1, k // 2), k + 1)), 2 * k + 1
        A, kinds = random.integers(-2, 3, (m, n)).astype(float), random.integers(-1, 2, m)
        lam = random.uniform(0.2, 2.0, m) * np.where(kinds == 0, random.choice([-1, 1], m), kinds)
        drawn, nu = str(random.choice(["M", "M", "C", "W"])), np.zeros(n)
        G, H = np.eye(n)[:k], np.eye(n)[k : 2 * k]
        for i in range(k):
            size = random.uniform(0.2, 2.0, 2)
            signs = {"M": ([-1, -1], [0, 1], [1, 0]), "C": ([-1, -1], [1, 1]), "W": ([1, -1], [-1, 1])}[drawn]
            nu[[i, k + i]] = size * random.permutation(signs)[0]
        data = Active(-(A.T @ lam + nu), A, kinds, G, H)
        try:
            label = label_by_search(data)
        except _GivenUpError:
            continue
        try:
            b_stationary = label == "S" or not descends_by_search(data)
        except _GivenUpError:
            b_stationary = None
        return _stated(f"tangled-{seed}", data, random, label, b_stationary)


def _stated(name: str, data: Active, random: np.random.Generator, label: str, b: bool | None) -> Point:
    """An MPCC with curvature that has this data at a point; equations may be pairs that are not biactive."""
    n, is_plain = data.c.size, bool(random.uniform() < 0.3)
    turn = np.eye(n) if is_plain else np.linalg.qr(random.normal(size=(n, n)))[0]
    point = np.zeros(n) if is_plain else random.normal(size=n)
    v, scale = ca.SX.sym("v", n), 10.0 ** random.uniform(-2, 2)
    d = v - point
    square = 0.0 if is_plain else ca.sumsqr(d)

    def of(gradients: Array) -> ca.SX:
        return ca.mtimes(ca.DM(gradients @ turn), d) + random.uniform(-0.1, 0.1) * square

    as_pair = (data.kinds == 0) & (random.uniform(size=data.kinds.size) < 0.5)
    rows, kinds = data.A[~as_pair], data.kinds[~as_pair]
    extra, other = of(data.A[as_pair]), 1.0 + of(random.normal(size=data.A[as_pair].shape))
    f = scale * (ca.dot(ca.DM(turn.T @ data.c), d) + random.uniform(-0.5, 0.5) * ca.sumsqr(d))
    mpcc = MPCC(
        v, f, of(rows) if rows.size else None, ca.vertcat(of(data.G), extra), ca.vertcat(of(data.H), other),
        lbg=np.where(kinds <= 0, 0.0, -np.inf), ubg=np.where(kinds >= 0, 0.0, np.inf),
    )  # fmt: skip
    return Point(name, mpcc, point, data.G.shape[0], label, b)
