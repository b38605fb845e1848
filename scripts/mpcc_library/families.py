"""Families of generated MPCCs, seeded and of any size. None of them chose a default option."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.mpcc import MPCC, Problem

INF = np.inf


class Builder:
    """Collects unknowns, constraints and pairs one after the other, as a modelling language does."""

    def __init__(self) -> None:
        self._columns: dict[str, list[Any]] = {name: [] for name in ("x", "g", "G", "H")}
        self._numbers: dict[str, list[float]] = {name: [] for name in ("lbx", "ubx", "x0", "lbg", "ubg")}

    def _extend(self, n: int, **values: ArrayLike) -> None:
        for name, value in values.items():
            self._numbers[name].extend(np.broadcast_to(np.asarray(value, dtype=float), n))

    def unknown(
        self, n: int = 1, lower: ArrayLike = -INF, upper: ArrayLike = INF, start: ArrayLike = 0.0
    ) -> Any:
        """Return ``n`` new unknowns as a column."""
        self._columns["x"].append(ca.SX.sym(f"x{len(self._columns['x'])}", n))
        self._extend(n, lbx=lower, ubx=upper, x0=start)
        return self._columns["x"][-1]

    def constrain(self, g: Any, lower: ArrayLike = 0.0, upper: ArrayLike = 0.0) -> None:
        """Add ``lower <= g <= upper``."""
        self._columns["g"].append(ca.vec(ca.SX(g)))
        self._extend(ca.SX(g).numel(), lbg=lower, ubg=upper)

    def pair(self, G: Any, H: Any) -> None:
        """Add ``0 <= G _|_ H >= 0`` componentwise."""
        self._columns["G"].append(ca.vec(ca.SX(G)))
        self._columns["H"].append(ca.vec(ca.SX(H)))

    def done(self, name: str, f: Any) -> Problem:
        """Return the problem with objective ``f``."""
        bounds = {key: np.array(values) for key, values in self._numbers.items()}
        x0 = bounds.pop("x0")
        return Problem(name, MPCC(f=f, **self._columns, **bounds), x0)


def lpec(size: int, seed: int) -> Problem:
    """A linear objective over ``0 <= y _|_ N x + M y + q >= 0`` and bounds, ``size`` pairs.

    M is positive semidefinite of half rank, so that the followers' answer need not be unique.
    """
    random = np.random.default_rng([2, size, seed])
    n = max(2, size // 2)
    b = Builder()
    x, y = b.unknown(n, -3.0, 3.0), b.unknown(size, 0.0, 10.0)
    half, skew = random.normal(size=(size, max(1, size // 2))), random.normal(size=(size, size))
    M = (half @ half.T + 0.3 * (skew - skew.T)) / size
    N = random.normal(size=(size, n))
    reference, side = random.uniform(-2, 2, n), random.integers(0, 3, size)
    y_ref = np.where(side == 0, random.uniform(0.2, 2, size), 0.0)
    q = np.where(side == 1, random.uniform(0.2, 2, size), 0.0) - N @ reference - M @ y_ref
    b.pair(y, N @ x + M @ y + q)
    cost = ca.dot(random.normal(size=n), x) + ca.dot(random.uniform(-0.5, 1.5, size), y)
    return b.done(f"lpec-{size}-{seed}", cost)


def bouncing(size: int, seed: int) -> Problem:
    """A point mass above a table, thrust limited, perfectly inelastic impacts (Moreau's time stepping)."""
    random = np.random.default_rng([5, size, seed])
    h, gravity = 2.0 / size, 9.81
    height, goal = random.uniform(0.5, 1.5), random.uniform(0.0, 1.0)
    b = Builder()
    q, v, f = ca.SX(height), ca.SX(0.0), ca.SX(0)
    for _ in range(size):
        u = b.unknown(1, 0.0, 15.0, 5.0)
        q_next, v_next, impulse = b.unknown(start=height), b.unknown(), b.unknown(lower=0.0)
        b.constrain(v_next - v - h * (u - gravity) - impulse)
        b.constrain(q_next - q - h * v_next)
        b.pair(impulse, q_next)
        f += h * 1e-3 * u**2
        q, v = q_next, v_next
    return b.done(f"bouncing-{size}-{seed}", f + 10 * (q - goal) ** 2 + v**2)


def hysteresis(size: int, seed: int) -> Problem:
    """Play operator: the output follows the input within a distance r; track a wave, ``size`` steps."""
    random = np.random.default_rng([7, size, seed])
    h, r = 2 * np.pi / size, random.uniform(0.1, 0.4)
    phase, scale = random.uniform(0, 6), random.uniform(0.5, 1.5)
    b = Builder()
    u, z, f = ca.SX(0), ca.SX(0), ca.SX(0)
    for k in range(size):
        rate, u_next, z_next = b.unknown(1, -2.0, 2.0), b.unknown(), b.unknown()
        up, down = b.unknown(lower=0.0), b.unknown(lower=0.0)
        b.constrain(u_next - u - h * rate)
        b.constrain(z_next - z - up + down)
        b.pair(ca.vertcat(up, down), ca.vertcat(r - u_next + z_next, r + u_next - z_next))
        f += h * ((z_next - scale * np.sin(h * (k + 1) + phase)) ** 2 + 0.01 * rate**2)
        u, z = u_next, z_next
    return b.done(f"hysteresis-{size}-{seed}", f)


def cournot(size: int, seed: int) -> Problem:
    """A leader among ``size`` Cournot followers with capacities: mixed complementarity by split multipliers.

    Inverse demand ``p(Q) = (a / Q)^(1 / e)`` and costs ``c q + k q^(1 + s)``, as in J. Outrata, M. Kocvara,
    J. Zowe, Nonsmooth Approach to Optimization Problems with Equilibrium Constraints, 1998, chapter 12.
    """
    random = np.random.default_rng([10, size, seed])
    elasticity, demand = random.uniform(1.0, 1.6), 5000.0
    capacity = random.uniform(10, 60, size)
    cost, power = random.uniform(2, 12, size), random.uniform(0.5, 1.2, size)
    b = Builder()
    leader, q = b.unknown(1, 0.0, 150.0, 30.0), b.unknown(size, 0.0, capacity, 0.5 * capacity)
    low, high = b.unknown(size, 0.0), b.unknown(size, 0.0)
    total = leader + ca.sum1(q)
    price = (demand / (total + 1e-3)) ** (1 / elasticity)
    slope = -price / (elasticity * (total + 1e-3))
    marginal = cost + 0.1 * (1 + power) * (q + 1e-3) ** power
    b.constrain(marginal - price - slope * q - low + high)
    b.pair(ca.vertcat(low, high), ca.vertcat(q, capacity - q))
    return b.done(f"cournot-{size}-{seed}", random.uniform(3, 10) * leader - leader * price)


def markets(size: int, seed: int) -> Problem:
    """Taxes of a leader on ``size`` markets in which three firms with capacities compete.

    ``0 <= q_ij _|_ c_ij + tax_j + lam_i - price_j + s_j q_ij >= 0``, ``0 <= lam_i _|_ capacity_i - sum_j q_ij
    >= 0``, linear prices ``a_j - s_j sum_i q_ij``. The leader wants revenue, and amounts near whole targets.
    """
    random = np.random.default_rng([36, size, seed])
    firms = 3
    b = Builder()
    tax, q, lam = b.unknown(size, -5.0, 20.0), b.unknown(firms * size, 0.0), b.unknown(firms, 0.0)
    amount = ca.reshape(q, firms, size)
    sold = ca.sum1(amount).T
    slope = random.integers(1, 4, size).astype(float)
    price = random.integers(15, 40, size).astype(float) - slope * sold
    cost = random.integers(1, 12, (firms, size)).astype(float)
    f = -ca.dot(tax, sold) + ca.sumsqr(sold - random.integers(0, 8, size))
    for j in range(size):
        b.pair(amount[:, j], cost[:, j] + tax[j] + lam - price[j] + slope[j] * amount[:, j])
    b.pair(lam, random.integers(2 * size, 5 * size, firms) - ca.sum2(amount))
    return b.done(f"markets-{size}-{seed}", f)


def tolls(size: int, seed: int) -> Problem:
    """Revenue-optimal tolls on some of ``size`` parallel roads per pair of towns, drivers in equilibrium.

    ``0 <= flow_r _|_ time_r(flow) + toll_r - pi_w >= 0``, flows sum to the demand; times grow with the fourth
    power of a flow (Bureau of Public Roads). Three pairs of towns share a congested road.
    """
    random = np.random.default_rng([11, size, seed])
    b = Builder()
    f, shared, parts = ca.SX(0), ca.SX(0), []
    for _ in range(3):
        demand = random.uniform(1, 4)
        flow, least = b.unknown(size, 0.0, INF, demand / size), b.unknown(1, 0.0, INF, 1.0)
        toll = b.unknown(size, 0.0, 5.0 * (random.uniform(size=size) < 0.5))
        b.constrain(ca.sum1(flow) - demand)
        shared += flow[0]
        parts.append((flow, least, toll, random.uniform(0.5, 2, size), random.uniform(0.5, 2, size)))
        f -= ca.dot(toll, flow)
    for flow, least, toll, free, room in parts:
        time = free * (1 + 0.15 * (flow / room) ** 4)
        time[0] += 0.1 * shared**2
        b.pair(flow, time + toll - least)
    return b.done(f"tolls-{size}-{seed}", f)


def prices(size: int, seed: int) -> Problem:
    """A generating firm in a power network of ``size`` nodes, whose operator clears the market.

    Given the firm's amounts x the operator maximises welfare with competitors' amounts y, demands d and
    angles of a direct-current network whose lines are limited; the multipliers of the balances are the
    prices. The firm wants profit. B. Hobbs, C. Metzler, J.-S. Pang, Strategic gaming analysis for electric
    power systems: an MPEC approach, IEEE Trans. Power Syst. 15 (2000) 638-645.
    """
    random = np.random.default_rng([50, size, seed])
    lines = [(i, (i + 1) % size) for i in range(size)]
    lines += [tuple(random.choice(size, 2, replace=False)) for _ in range(size // 2)]
    incidence = np.zeros((size, len(lines)))
    for k, (i, j) in enumerate(lines):
        incidence[i, k], incidence[j, k] = 1.0, -1.0
    susceptance, limit = random.uniform(0.5, 2, len(lines)), random.uniform(1, 6, len(lines))
    capacity = random.uniform(5, 15, size) * (random.uniform(size=size) < 0.5)
    own, cost, slope = random.uniform(1, 4, size), random.uniform(2, 8, size), random.uniform(0.2, 1, size)
    top, fall = random.uniform(10, 25, size), random.uniform(0.5, 2, size)
    b = Builder()
    x = b.unknown(size, 0.0, capacity, 0.5 * capacity)
    y, d = b.unknown(size, 0.0, INF, 1.0), b.unknown(size, 0.0, INF, 1.0)
    angle, price = b.unknown(size - 1), b.unknown(size, start=10.0)
    over, under = b.unknown(len(lines), 0.0), b.unknown(len(lines), 0.0)
    drop = ca.mtimes(incidence.T, ca.vertcat(angle, 0))
    flow = susceptance * drop
    b.constrain(x + y - d - ca.mtimes(incidence, flow))
    rent = susceptance * (ca.mtimes(incidence.T, price) + over - under)
    b.constrain(ca.mtimes(incidence, rent)[:-1])
    b.pair(ca.vertcat(y, d), ca.vertcat(cost + slope * y - price, price - top + fall * d))
    b.pair(ca.vertcat(over, under), ca.vertcat(limit - flow, limit + flow))
    return b.done(f"prices-{size}-{seed}", ca.dot(own - price, x))


def hopper(size: int, seed: int) -> Problem:
    """A body on a foot crosses a floor with Coulomb friction in ``size`` steps, contact times not given.

    Leg and hip forces act between the two; impulses and slip of the foot are unknowns of each time step.
    M. Posa, C. Cantu, R. Tedrake, A direct method for trajectory optimization of rigid bodies through
    contact, Int. J. Robot. Res. 33 (2014) 69-81.
    """
    random = np.random.default_rng([51, size, seed])
    h, gravity, friction = 1.5 / size, 9.81, random.uniform(0.4, 1.0)
    body, foot, goal = 1.0, random.uniform(0.1, 0.4), random.uniform(0.2, 0.8)
    b = Builder()
    z, zf, x, xf = ca.SX(1.0), ca.SX(0.0), ca.SX(0.0), ca.SX(0.0)
    v, f = ca.SX.zeros(4), ca.SX(0)
    for _ in range(size):
        leg, hip = b.unknown(1, 0.0, 40.0, 10.0), b.unknown(1, -5.0, 5.0)
        v_next, q = b.unknown(4), b.unknown(4, start=[1.0, 0.0, 0.0, 0.0])
        normal, forth, back, slip = (b.unknown(lower=0.0) for _ in range(4))
        b.constrain(body * (v_next[0] - v[0]) - h * (leg - body * gravity))
        b.constrain(foot * (v_next[1] - v[1]) + h * (leg + foot * gravity) - normal)
        b.constrain(body * (v_next[2] - v[2]) - h * hip)
        b.constrain(foot * (v_next[3] - v[3]) + h * hip - forth + back)
        b.constrain(q - ca.vertcat(z, zf, x, xf) - h * v_next)
        b.constrain(ca.vertcat(q[0] - q[1], q[2] - q[3]), [0.5, -0.4], [1.5, 0.4])
        b.pair(ca.vertcat(normal, slip), ca.vertcat(q[1], friction * normal - forth - back))
        b.pair(ca.vertcat(forth, back), ca.vertcat(slip + v_next[3], slip - v_next[3]))
        f += h * (1e-3 * leg**2 + 1e-2 * hip**2)
        z, zf, x, xf = ca.vertsplit(q)
        v = v_next
    end = 10 * ((x - goal) ** 2 + (xf - goal) ** 2 + (z - 1) ** 2) + ca.sumsqr(v)
    return b.done(f"hopper-{size}-{seed}", f + end)


FAMILIES: dict[str, tuple[Callable[[int, int], Problem], tuple[int, ...]]] = {
    "lpec": (lpec, (4, 10, 30, 100)),
    "bouncing": (bouncing, (10, 30, 100, 300)),
    "hysteresis": (hysteresis, (10, 30, 100, 300)),
    "cournot": (cournot, (4, 10, 30, 100)),
    "markets": (markets, (2, 5, 15, 60)),
    "tolls": (tolls, (3, 6, 12, 40)),
    "prices": (prices, (4, 10, 30, 100)),
    "hopper": (hopper, (10, 30, 100, 300)),
}
"""Makers, of a size and a seed, and sizes from tiny to a few thousand unknowns."""
