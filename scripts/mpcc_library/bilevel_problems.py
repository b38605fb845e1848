"""Small bilevel programs of the literature with their known optima.

As collected by Zhou, Zemkoho and Tin, *BOLIB 2019: Bilevel Optimization LIBrary of test problems* (2020), and
by Paulavicius and Adjiman, *BASBLib* (2017), whose names and starts they have. Bounds of single variables are
bounds here. Optimistic optima: of several lower-level minima the upper level may choose. Where the
printed optimum is not that of these data, ``best`` is what a grid over x with exact lower-level solves has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from rmesh_nlp.mpcc import MPCC, bilevel, solve_bilevel

Level = Mapping[str, Any]
Levels = Callable[[Any, Any], tuple[Level, Level]]
"""``(x, y) -> `` the two levels without their variables."""


@dataclass(frozen=True)
class BilevelProblem:
    """A problem: source, start, optimal value of the upper level, and whether its lower level is convex."""

    name: str
    source: str
    x0: Sequence[float]
    y0: Sequence[float]
    best: float
    levels: Levels
    convex: bool = True

    def program(self, kind: Any = ca.SX) -> MPCC:
        """The MPCC in symbols of ``kind``."""
        x, y = kind.sym("x", len(self.x0)), kind.sym("y", len(self.y0))
        upper, lower = self.levels(x, y)
        return bilevel({"x": x, **upper}, lower, variables=y)


BARD_1984 = "Bard, An investigation of the linear three level programming problem, IEEE Trans. SMC 14 (1984)"
BARD_1988 = "Bard, Convex two-level optimization, Math. Programming 40 (1988)"
BARD_1991 = "Bard, Some properties of the bilevel programming problem, JOTA 68 (1991)"
BEN_AYED = (
    "Ben-Ayed and Blair, Computational difficulties of bilevel linear programming, Oper. Res. 38 (1990)"
)
BIALAS = "Bialas and Karwan, Two-level linear programming, Management Science 30 (1984)"
CLARK = "Clark and Westerberg, Bilevel programming for steady-state chemical process design, CACE 14 (1990)"
COLSON = "Colson, BIPA: software for bilevel programming, FUNDP Namur (2002)"
LAMPARIELLO = "Lampariello and Sagratella, A bridge between bilevel programs and Nash games, JOTA 174 (2017)"
MITSOS = "Mitsos and Barton, A test set for bilevel programs, MIT (2006)"
OUTRATA = "Outrata, On the numerical solution of a class of Stackelberg problems, ZOR 34 (1990)"
PAULAVICIUS = "Paulavicius and Adjiman, BASBLib, a library of bilevel test problems (2017)"
SHIMIZU = "Shimizu and Aiyoshi, A new computational method for Stackelberg problems, IEEE TAC 26 (1981)"


def _linear(
    F: Sequence[float],
    f: Sequence[float],
    rows: Sequence[tuple[Sequence[float], float]],
    n: int,
    **upper: Any,
) -> Levels:
    """Linear levels in n upper variables, all variables non-negative, rows ``a (x, y) <= b`` of the lower."""

    def levels(x: Any, y: Any) -> tuple[Level, Level]:
        z = ca.vertcat(x, y)
        g = [ca.dot(ca.DM(a), z) for a, _ in rows]
        bounds = {"lbx": 0, **upper}
        return (
            {"f": ca.dot(ca.DM(F), z), **bounds},
            {"f": ca.dot(ca.DM(f), y), "g": g, "ubg": [b for _, b in rows], "lbx": 0},
        )

    return levels


def _outrata(weight: float, H: Any, tilt: Any = ((1, 0), (0, 1))) -> Levels:
    def levels(x: Any, y: Any) -> tuple[Level, Level]:
        F = weight * ca.sumsqr(x) + ca.sumsqr(y - ca.DM([3, 4])) / 2 - 12.5
        f = ca.bilin(ca.DM(H), y, y) / 2 - ca.dot(ca.DM(tilt) @ x, y)
        g = [-0.333 * y[0] + y[1], y[0] - 0.333 * y[1]]
        return {"f": F}, {"f": f, "g": g, "ubg": 2, "lbx": 0}

    return levels


def _outrata_2(a: float, b: float) -> Levels:
    def levels(x: Any, y: Any) -> tuple[Level, Level]:
        f = (1 + a * x) * y[0] ** 2 / 2 + (1 + b * x) * y[1] ** 2 / 2 - (3 + 1.333 * x) * y[0] - x * y[1]
        g = [-0.333 * y[0] + y[1], y[0] - 0.333 * y[1]]
        return (
            {"f": ca.sumsqr(y - ca.DM([3, 4])) / 2, "lbx": 0},
            {"f": f, "g": g, "ubg": 2, "lbx": 0},
        )

    return levels


def _unit(F: Callable[[Any, Any], Any], f: Callable[[Any, Any], Any], **other: Any) -> Levels:
    """Both levels in [-1, 1]; ``lower_`` and ``upper_`` replace bounds."""
    return lambda x, y: (
        {"f": F(x, y), "lbx": -1, "ubx": 1, **other.get("upper", {})},
        {"f": f(x, y), "lbx": -1, "ubx": 1, **other.get("lower", {})},
    )


def _quartic(y: Any) -> Any:
    return 16 * y**4 + 2 * y**3 - 8 * y**2 - 1.5 * y + 0.5


P = BilevelProblem
LINEAR = (
    P("anandalingham-white-1990", "Anandalingham and White, IEEE TAC 35 (1990)", [1], [1], -49, _linear(
        [-1, -3], [3], [((-1, -2), -10), ((1, -2), 6), ((2, -1), 21), ((1, 2), 38), ((-1, 2), 18)], 1)),
    P("bard-1984-a", BARD_1984, [1], [1], 28 / 9, _linear(
        [1, 1], [-1], [((-1, -0.5), -2), ((-0.25, 1), 2), ((1, 0.5), 8), ((1, -2), 4)], 1)),
    P("bard-1984-b", BARD_1984, [1], [1], -37.6, _linear(
        [-5, -1], [1], [((-1, -0.5), -2), ((-0.25, 1), 2), ((1, 0.5), 8), ((1, -2), 4)], 1)),
    P("bard-1991-2", BARD_1991, [0], [0, 0], -1, _linear(
        [-1, 10, -1], [-1, -1], [((1, 1, 0), 1), ((1, 0, 1), 1), ((0, 1, 1), 1)], 1)),
    P("bard-falk-1982", "Bard and Falk, Comput. Oper. Res. 9 (1982)", [1, 1], [1, 1], -3.25, _linear(
        [-2, 1, 0.5, 0], [-4, 1], [((-2, 0, 1, -1), -2.5), ((1, -3, 0, 1), 2), ((1, 1, 0, 0), 2)], 2)),
    P("ben-ayed-blair-1990-a", BEN_AYED, [1], [1, 1], -2.5, _linear(
        [-1.5, -6, -1], [-1, -5], [((1, 3, 1), 5), ((2, 1, 3), 5)], 1, ubx=1)),
    P("ben-ayed-blair-1990-b", BEN_AYED, [3], [4], -6, _linear(
        [-1, -1], [1], [((-4, -3), -19), ((1, 2), 11), ((3, 1), 13)], 1)),
    P("bialas-karwan-1984-a", BIALAS, [1], [1, 1], -2, _linear(
        [-1, 0, -1], [0, -1], [((1, 1, 1), 3), ((-1, -1, 1), -1), ((-1, 1, 1), 1), ((1, -1, 1), 1),
                               ((0, 0, 1), 0.5)], 1)),
    P("bialas-karwan-1984-b", BIALAS, [10], [14], -11, _linear(
        [0, -1], [1], [((-1, -2), -10), ((1, -2), 6), ((2, -1), 21), ((1, 2), 38), ((-1, 2), 18)], 1)),
    P("candler-townsley-1982", "Candler and Townsley, Comput. Oper. Res. 9 (1982)", [1, 1], [1, 1, 1], -29.2,
      _linear([-8, -4, 4, -40, -4], [1, 1, 2],
              [((0, 0, -1, 1, 1), 1), ((2, 0, -1, 2, -0.5), 1), ((0, 2, 2, -1, -0.5), 1)], 2)),
    P("clark-westerberg-1988", "Clark and Westerberg, CACE 12 (1988)", [20], [0], -37, lambda x, y: (
        {"f": x - 4 * y}, {"f": y, "g": [-2 * x + y, 2 * x + 5 * y, 2 * x - 3 * y], "ubg": [0, 108, -4]})),
    P("clark-westerberg-1990-b", CLARK, [1], [1, 1], -13, lambda x, y: (
        {"f": -x - 3 * y[0] + 2 * y[1], "lbx": 0, "ubx": 8},
        {"f": -y[0], "lbx": [0, -float("inf")], "ubx": [4, float("inf")],
         "g": [-2 * x + y[0] + 4 * y[1], 8 * x + 3 * y[0] - 2 * y[1], -2 * x + y[0] - 3 * y[1]],
         "ubg": [16, 48, -12]})),
    P("glackin-2009", "Glackin, Ecker and Kupferschmid, JOTA 140 (2009)", [0, 1], [0], 6, lambda x, y: (
        {"f": -2 * x[0] + 4 * x[1] + 3 * y, "g": x[0] - x[1], "ubg": -1, "lbx": 0},
        {"f": -y, "g": [x[0] + x[1] + y, 2 * x[0] + 2 * x[1] + y], "ubg": [4, 6], "lbx": 0})),
    P("haurie-1990", "Haurie, Savard and White, Oper. Res. Letters 9 (1990)", [1], [1], 27, lambda x, y: (
        {"f": x + 5 * y},
        {"f": -y, "g": [-3 * x + 2 * y, 3 * x + 4 * y, 2 * x - 5 * y, x + y],
         "ubg": [6, 48, 9, float("inf")], "lbg": [-float("inf")] * 3 + [8]})),
    P("lan-2007", "Lan, Wen, Shih and Lee, Appl. Math. Comput. 187 (2007)", [1], [1], -85.0909, _linear(
        [2, -11], [3], [((1, -2), 4), ((2, -1), 24), ((3, 4), 96), ((1, 7), 126), ((-4, 5), 65),
                        ((-1, -4), -8)], 1)),
    P("toll-setting-5", "Colson, Marcotte and Savard, Ann. Oper. Res. 153 (2007)", [1], [1] * 4, -2.5,
      lambda x, y: ({"f": -(y[1] + y[2]) * x},
                    {"f": 8 * y[0] + (3 + 2 * x) * y[1] + (4 + 2 * x) * y[2] + 6 * y[3],
                     "g": [y[0] + y[1], y[2] + y[3]], "lbg": 1, "ubg": 1, "lbx": 0})),
    P("mitsos-barton-3.8", MITSOS, [1], [1], 0, _unit(
        lambda x, y: y**2, lambda x, y: x * y + ca.exp(x) * y)),
)  # fmt: skip

NONLINEAR = (
    P("aiyoshi-shimizu-1984-2", "Aiyoshi and Shimizu, IEEE TAC 29 (1984)", [10, 10], [20, 20], 0,
      lambda x, y: (
        {"f": 2 * ca.sum1(x) - 3 * ca.sum1(y) - 60, "g": x[0] + x[1] + y[0] - 2 * y[1], "ubg": 40,
         "lbx": 0, "ubx": 50},
        {"f": ca.sumsqr(y - x + 20), "g": 2 * y - x, "ubg": -10, "lbx": -10, "ubx": 20})),
    P("bard-1988-1", BARD_1988, [4], [0], 17, lambda x, y: (
        {"f": (x - 5) ** 2 + (2 * y + 1) ** 2, "lbx": 0},
        {"f": (y - 1) ** 2 - 1.5 * x * y, "g": [-3 * x + y, x - y / 2, x + y], "ubg": [-3, 4, 7], "lbx": 0})),
    P("bard-1988-3", BARD_1988, [0, 2], [4, 1], -12.6787, lambda x, y: (
        {"f": -x[0] ** 2 - 3 * x[1] - 4 * y[0] + y[1] ** 2, "g": x[0] ** 2 + 2 * x[1], "ubg": 4, "lbx": 0},
        {"f": 2 * x[0] ** 2 + y[0] ** 2 - 5 * y[1], "lbx": 0, "lbg": [-3, 4], "ubg": float("inf"),
         "g": [x[0] ** 2 - 2 * x[0] + x[1] ** 2 - 2 * y[0] + y[1], x[1] + 3 * y[0] - 4 * y[1]]})),
    P("bard-1991-1", BARD_1991, [1], [1, 1], 2, lambda x, y: (
        {"f": x + y[1], "lbx": 2, "ubx": 4},
        {"f": 2 * y[0] + x * y[1], "g": y[0] + y[1] - x, "lbg": 4, "lbx": 0})),
    P("calvete-gale-1999", "Calvete and Gale, J. Global Optim. 14 (1999)", [0, 0.5], [0, 0.5, 0], -29.2,
      lambda x, y: (
          {"f": -8 * x[0] - 4 * x[1] + y[0] - 40 * y[1] - 4 * y[2], "lbx": 0},
          {"f": (1 + x[0] + x[1] + 2 * y[0] - y[1] + y[2]) / (6 + 2 * x[0] + y[0] + y[1] - 3 * y[2]),
           "g": [-y[0] + y[1] + y[2], 2 * x[0] - y[0] + 2 * y[1] - y[2] / 2,
                 2 * x[1] + 2 * y[0] - y[1] - y[2] / 2], "ubg": 1, "lbx": 0})),
    P("clark-westerberg-1990-a", CLARK, [1], [1], 5, lambda x, y: (
        {"f": (x - 3) ** 2 + (y - 2) ** 2, "lbx": 0, "ubx": 8},
        {"f": (y - 5) ** 2, "g": [-2 * x + y, x - 2 * y, x + 2 * y], "ubg": [1, -2, 14]})),
    P("colson-bipa-1", COLSON, [10], [10], 250, lambda x, y: (
        {"f": (10 - x) ** 3 + (10 - y) ** 3, "g": y - x, "ubg": 0, "lbx": 0, "ubx": 5},
        {"f": (x + 2 * y - 15) ** 4, "g": x + y, "ubg": 20, "lbx": 0, "ubx": 20})),
    P("colson-bipa-2", COLSON, [4], [0], 17, lambda x, y: (
        {"f": (x - 5) ** 2 + (2 * y + 1) ** 2, "lbx": 0},
        {"f": (y - 1) ** 2 - 1.5 * x * y + x**3, "g": [-3 * x + y, x - y / 2, x + y], "ubg": [-3, 4, 7],
         "lbx": 0})),
    P("colson-bipa-3", COLSON, [4], [0], 2, lambda x, y: (
        {"f": (x - 5) ** 4 + (2 * y + 1) ** 4, "g": x + y, "ubg": 4, "lbx": 0},
        {"f": ca.exp(-x + y) + x**2 + 2 * x * y + y**2 + 2 * x + 6 * y, "g": y - x, "ubg": 2, "lbx": 0})),
    P("colson-bipa-4", COLSON, [1.5], [2.25], 88.7857, lambda x, y: (
        {"f": x**2 + (y - 10) ** 2, "g": x + 2 * y, "ubg": 6, "lbx": 0},
        {"f": x**3 + 2 * y**3 + x - 2 * y - x**2, "g": -x + 2 * y, "ubg": 3, "lbx": 0})),
    # at x = 0 the lower level has a minimum without multipliers: no point of the MPCC, the limit of some
    P("dempe-1992-b", "Dempe, Optimization 25 (1992)", [1], [1], 28.25, lambda x, y: (
          {"f": (x - 3.5) ** 2 + (y + 4) ** 2}, {"f": (y - 3) ** 2, "g": y**2 - x, "ubg": 0})),
    P("de-silva-1978", "de Silva, thesis, George Washington University (1978)", [0, 0], [1, 1], -1,
      lambda x, y: (
        {"f": ca.sumsqr(x - 1) + ca.sumsqr(y) - 2}, {"f": ca.sumsqr(y - x), "lbx": 0.5, "ubx": 1.5})),
    P("falk-liu-1995", "Falk and Liu, Math. Programming 70 (1995)", [0, 0], [1, 1], -2.25,
      lambda x, y: ({"f": ca.sumsqr(x - 1.5) + ca.sumsqr(y) - 4.5},
                    {"f": ca.sumsqr(y - x), "lbx": 0.5, "ubx": 1.5})),
    P("gumus-floudas-2001-1", "Gumus and Floudas, J. Global Optim. 20 (2001)", [1], [1], 2250, lambda x, y: (
        {"f": 16 * x**2 + 9 * y**2, "g": -4 * x + y, "ubg": 0, "lbx": 0, "ubx": 12.5},
        {"f": (x + y - 20) ** 4, "g": 4 * x + y, "ubg": 50, "lbx": 0, "ubx": 50})),
    P("gumus-floudas-2001-4", "Gumus and Floudas, J. Global Optim. 20 (2001)", [1], [1], 9, lambda x, y: (
        {"f": (x - 3) ** 2 + (y - 2) ** 2, "g": [-2 * x + y, x - 2 * y, x + 2 * y], "ubg": [1, -2, 14],
         "lbx": 0, "ubx": 8},
        {"f": (y - 5) ** 2, "lbx": 0, "ubx": 10})),
    P("hatz-2013", "Hatz, Leyffer, Schloder and Bock, Argonne (2013)", [1], [1, 1], 0, lambda x, y: (
        {"f": -x + 2 * y[0] + y[1]}, {"f": (x - y[0]) ** 2 + y[1] ** 2, "lbx": 0})),
    P("henderson-quandt-1958", "Henderson and Quandt, Microeconomic Theory (1958)", [0], [0], -9800 / 3,
      lambda x, y: ({"f": ((x + y) / 2 - 95) * x, "lbx": 0, "ubx": 200},
                    {"f": (y + x / 2 - 100) * y, "lbx": 0})),
    P("lampariello-3.1", LAMPARIELLO, [1], [1], 1, lambda x, y: (
        {"f": x**2 + y**2, "lbx": 1}, {"f": y, "g": x + y, "lbg": 1})),
    P("lampariello-3.2", LAMPARIELLO, [1], [1], 0.5, lambda x, y: (
        {"f": x**2 + y**2}, {"f": (x + y - 1) ** 2})),
    P("lampariello-3.3", LAMPARIELLO, [1], [1, 1], 0.5, lambda x, y: (
        {"f": x**2 + ca.sum1(y) ** 2, "lbx": 0.5}, {"f": y[0], "g": x + ca.sum1(y), "lbg": 1, "lbx": 0})),
    P("lampariello-3.5", LAMPARIELLO, [1], [1], 0.8, lambda x, y: (
        {"f": x**2 + y**2, "lbx": -1, "ubx": 1}, {"f": -y, "g": 2 * x + y, "ubg": 2, "lbx": 0, "ubx": 1})),
    P("lucchetti-1987", "Lucchetti, Mignanego and Pieri, Optimization 18 (1987)", [1], [1], 0,
      lambda x, y: (
        {"f": (1 - x) / 2 + x * y, "lbx": 0, "ubx": 1}, {"f": (x - 1) * y, "lbx": 0, "ubx": 1})),
    P("macal-hurter-1997", "Macal and Hurter, Math. Comput. Modelling 25 (1997)", [1], [1], 81.3279,
      lambda x, y: (
        {"f": (x - 1) ** 2 + (y - 1) ** 2}, {"f": y**2 / 2 + 500 * y - 50 * x * y})),
    P("muu-quy-2003-1", "Muu and Quy, Vietnam J. Math. 31 (2003)", [2], [0, 0], -2.0769, lambda x, y: (
        {"f": x**2 - 4 * x + ca.sumsqr(y), "lbx": 0, "ubx": 2},
        {"f": y[0] ** 2 + y[1] ** 2 / 2 + y[0] * y[1] + (1 - 3 * x) * y[0] + (1 + x) * y[1],
         "g": 2 * y[0] + y[1] - 2 * x, "ubg": 1, "lbx": 0})),
    P("outrata-1990-1a", OUTRATA, [0, 0], [3, 3], -8.9172, _outrata(0.1, [[1, -2], [-2, 5]])),
    P("outrata-1990-1b", OUTRATA, [0, 0], [3, 3], -7.5783, _outrata(1, [[1, -2], [-2, 5]])),
    P("outrata-1990-1c", OUTRATA, [0, 0], [3, 3], -11.9985, _outrata(0, [[1, 3], [3, 10]])),
    P("outrata-1990-1d", OUTRATA, [6, -3], [3, 3], -3.6, _outrata(0.1, [[1, 3], [3, 10]])),
    P("outrata-1990-1e", OUTRATA, [6, -3], [3, 3], -3.92,
      _outrata(0.1, [[1, 3], [3, 10]], [[-1, 2], [3, -3]])),
    P("outrata-1990-2a", OUTRATA, [1], [1, 1], 0.5015, _outrata_2(0, 0)),
    P("outrata-1990-2c", OUTRATA, [0], [0, 0], 1.8605, _outrata_2(1, 0.1)),
    P("shimizu-aiyoshi-1981-1", SHIMIZU, [1], [1], 100, lambda x, y: (
        {"f": x**2 + (y - 10) ** 2, "g": y - x, "ubg": 0, "lbx": 0, "ubx": 15},
        {"f": (x + 2 * y - 30) ** 2, "g": x + y, "ubg": 20, "lbx": 0, "ubx": 20})),
    P("shimizu-aiyoshi-1981-2", SHIMIZU, [1, 1], [1, 1], 225, lambda x, y: (
        {"f": ca.sumsqr(x - ca.DM([30, 20])) - 20 * y[0] + 20 * y[1], "g": [x[0] + 2 * x[1], x[0] + x[1]],
         "lbg": [30, -float("inf")], "ubg": [float("inf"), 25], "ubx": [float("inf"), 15]},
        {"f": ca.sumsqr(x - y), "lbx": 0, "ubx": 10})),
    P("sinha-tp6", "Sinha, Malo and Deb, Evol. Comput. 22 (2014)", [1], [1, 1], -98 / 81, lambda x, y: (
        {"f": (x - 1) ** 2 - 2 * x + 2 * y[0], "lbx": 0},
        {"f": (2 * y[0] - 4) ** 2 + (2 * y[1] - 1) ** 2 + x * y[0], "lbx": 0, "ubg": [12, -4, 4, 4],
         "g": [4 * x + 5 * y[0] + 4 * y[1], -4 * x - 5 * y[0] + 4 * y[1], 4 * x - 4 * y[0] + 5 * y[1],
               -4 * x + 4 * y[0] + 5 * y[1]]})),
    P("tuy-2007", "Tuy, Migdalas and Hoai-Phuong, J. Global Optim. 38 (2007)", [5], [0], 22.5, lambda x, y: (
        {"f": x**2 + y**2, "lbx": 0, "g": y, "lbg": 0},
        {"f": -y, "g": [3 * x + y, x + y, x + 3 * y], "ubg": [15, 7, 15]})),
    P("yezza-1996-3.1", "Yezza, Optimization 38 (1996)", [1], [1], 1.5, lambda x, y: (
        {"f": -(4 * x - 3) * y + 2 * x + 1, "lbx": 0, "ubx": 1},
        {"f": -(1 - 4 * x) * y - 2 * x - 2, "lbx": 0, "ubx": 1})),
    P("yezza-1996-4.1", "Yezza, Optimization 38 (1996)", [-1], [-1], 0.5, lambda x, y: (
        {"f": (y - 2) ** 2 / 2 + (x - y - 2) ** 2 / 2}, {"f": y**2 / 2 + x - y, "g": y - x, "ubg": 0,
                                                                        "lbx": 0})),
)  # fmt: skip

NONCONVEX = tuple(
    P(*case, convex=False)
    for case in (
        ("mitsos-barton-3.5", MITSOS, [1], [1], 0.5, _unit(lambda x, y: y, lambda x, y: _quartic(y))),
        ("mitsos-barton-3.6", MITSOS, [1], [1], -1, _unit(lambda x, y: y, lambda x, y: y**3)),
        ("mitsos-barton-3.10", MITSOS, [1], [1], 0.5, _unit(
            lambda x, y: y, lambda x, y: x * _quartic(y), upper={"lbx": 0.1})),
        ("mitsos-barton-3.11", MITSOS, [1], [1], -0.8, _unit(
            lambda x, y: y, lambda x, y: x * _quartic(y), lower={"lbx": -0.8, "ubx": 1})),
        ("mitsos-barton-3.12", MITSOS, [1], [1], 0, _unit(
            lambda x, y: -x + x * y + 10 * y**2, lambda x, y: -x * y**2 + y**4 / 2)),
        ("mitsos-barton-3.13", MITSOS, [1], [1], -1, _unit(
            lambda x, y: x - y, lambda x, y: x * y**2 / 2 - x**3 * y)),
        ("mitsos-barton-3.14", MITSOS, [1], [1], 0.25, _unit(
            lambda x, y: (x - 0.25) ** 2 + y**2, lambda x, y: y**3 / 3 - x * y)),
        ("mitsos-barton-3.15", MITSOS, [1], [1], 0, _unit(
            lambda x, y: x + y, lambda x, y: x * y**2 / 2 - y**3 / 3)),
        ("mitsos-barton-3.16", MITSOS, [1], [1], -2, _unit(
            lambda x, y: 2 * x + y, lambda x, y: -x * y**2 / 2 - y**4 / 4)),
        ("mitsos-barton-3.17", MITSOS, [1], [1], 3 / 16, _unit(
            lambda x, y: (x + 0.5) ** 2 + y**2 / 2, lambda x, y: x * y**2 / 2 + y**4 / 4)),
        ("mitsos-barton-3.18", MITSOS, [1], [1], -1, _unit(
            lambda x, y: -(x**2) + y**2, lambda x, y: x * y**2 - y**4 / 2)),
        ("mitsos-barton-3.19", MITSOS, [1], [1], -0.2583, _unit(
            lambda x, y: x * y - y + y**2 / 2, lambda x, y: -x * y**2 + y**4 / 2)),
        ("mitsos-barton-3.20", MITSOS, [1], [1], 0.3125, _unit(
            lambda x, y: (x - 0.25) ** 2 + y**2, lambda x, y: y**3 / 3 - x**2 * y)),
        ("mitsos-barton-3.21", MITSOS, [1], [1], 0.2095, _unit(
            lambda x, y: (x + 0.6) ** 2 + y**2, lambda x, y: y**4 + 4 / 30 * (1 - x) * y**3
            + (-0.02 * x**2 + 0.16 * x - 0.4) * y**2 + (0.004 * x**3 - 0.036 * x**2 + 0.08 * x) * y)),
        ("mitsos-barton-3.24", MITSOS, [1], [1], -1.7550, _unit(
            lambda x, y: x**2 - y, lambda x, y: ((y - 1 - 0.1 * x) ** 2 - 0.5 - 0.5 * x) ** 2,
            upper={"lbx": 0, "ubx": 1}, lower={"lbx": 0, "ubx": 3})),
        ("mirrlees-1999", "Mirrlees, The theory of moral hazard, Rev. Econ. Studies 66 (1999)", [1], [1],
         1.0020,
         lambda x, y: ({"f": (x - 2) ** 2 + (y - 1) ** 2},
                       {"f": -x * ca.exp(-((y + 1) ** 2)) - ca.exp(-((y - 1) ** 2)), "lbx": -2, "ubx": 2})),
        ("paulavicius-2017-a", PAULAVICIUS, [1], [1], 0.25, _unit(
            lambda x, y: x**2 + y**2, lambda x, y: x * y**2 - y**4 / 2)),
        ("paulavicius-2017-b", PAULAVICIUS, [1], [1], -2, _unit(
            lambda x, y: x + y, lambda x, y: x * y**2 / 2 - x**3 * y)),
        ("vogel-2012", "Vogel, TU Freiberg (2012)", [-1], [-1], 1, lambda x, y: (
            {"f": (y + 1) ** 2, "lbx": -3, "ubx": 2}, {"f": y**3 - 3 * y, "g": y - x, "lbg": 0})),
        ("ye-zhu-2010-4.2", "Ye and Zhu, SIAM J. Optim. 20 (2010)", [-1], [-1], 1, lambda x, y: (
            {"f": (x - 1) ** 2 + y**2, "lbx": -3, "ubx": 2}, {"f": y**3 - 3 * y, "g": y - x, "lbg": 0})),
        ("ye-zhu-2010-4.3", "Ye and Zhu, SIAM J. Optim. 20 (2010)", [-1], [-1], 1, lambda x, y: (
            {"f": (x - 0.5) ** 2 + (y - 2) ** 2, "lbx": -3, "ubx": 2},
            {"f": y**3 - 3 * y, "g": y - x, "lbg": 0})),
    )
)  # fmt: skip

PROBLEMS = {problem.name: problem for problem in (*LINEAR, *NONLINEAR, *NONCONVEX)}


def names() -> list[str]:
    """Those with a convex lower level, for ``benchmark_mpcc.py``: their MPCC is the bilevel program."""
    return [problem.name for problem in PROBLEMS.values() if problem.convex]


def get(name: str) -> dict[str, Any]:
    """A problem in the form that ``benchmark_mpcc.py`` reads, its start completed by the lower level."""
    problem = PROBLEMS[name]
    mpcc = problem.program()
    fields = ("x", "f", "g", "G", "H", "lbx", "ubx", "lbg", "ubg")
    program = {field: getattr(mpcc, field) for field in fields}
    return {**program, "x0": mpcc.start(problem.x0), "target": problem.best}


def main(starts: int = 10) -> None:
    """Solve all and print those that end elsewhere; a success that 100 starts refute ends the program."""
    reached = 0
    for problem in PROBLEMS.values():
        x, y = ca.SX.sym("x", len(problem.x0)), ca.SX.sym("y", len(problem.y0))
        upper, lower = problem.levels(x, y)
        end = solve_bilevel({"x": x, **upper}, lower, problem.x0, variables=y, starts=starts)
        lowest = problem.program().lower_level.lowest(end.x, end.y, n=100, seed=1)  # type: ignore[union-attr]
        assert not end.success or end.result.lower_level.f <= lowest.f + 1e-5 * (1 + abs(lowest.f))  # type: ignore[union-attr]
        hit = end.success and abs(end.f - problem.best) <= 2e-3 * (1 + abs(problem.best))
        reached += hit
        if not hit:
            print(f"{problem.name}: {end.f:.6g}, known {problem.best:.6g}; {end}")
    print(f"{reached} of {len(PROBLEMS)} at the known optimum")


if __name__ == "__main__":
    main()
