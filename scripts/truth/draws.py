"""Problems to check: random ones by seed, and aimed ones that invite exploitation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from skfem import MeshTri

import rmesh_nlp as rm
from truth.data import Data, Foundation, Hidden, Material, Text
from truth.reference import refined

Way = tuple[str, dict[str, Any]]
JOINT, NESTED, MPCC, AUTO, FIXED = (("joint", {}), ("nested", {}), ("mpcc", {}), ("auto", {}), ("fixed", {}))
WAYS = (JOINT,) * 4 + (NESTED,) * 7 + (MPCC,) * 4 + (AUTO,) * 4 + (FIXED,)
FAMILIES = ("membrane", "obstacle", "smooth", "waves", "friction", "regions", "curved")
LIMITS: tuple[Any, ...] = (1e-4, 0.02, 0.1, rm.Relative(0.3), None, None)
SIDES = dict.fromkeys(("left", "right", "bottom", "top"), (0.0,))
FLAT = Foundation("arc", "height", 0.0)


def block(nx: int, ny: int, width: float, rng: np.random.Generator | None = None) -> MeshTri:
    """A grid on (0, width) x (0, 1), its interior nodes up to a sixth of a cell off their places."""
    diagonal = "rising" if rng is None or rng.integers(2) else "falling"
    mesh = rm.shapes.rectangle(nx, ny, x=(0, width), diagonal=diagonal)
    p, inside = np.array(mesh.p), mesh.interior_nodes()
    if rng is not None:
        inside = inside[np.abs(p[0, inside] - width / 2) > 1e-9]  # there materials meet
        p[:, inside] += rng.uniform(-0.15, 0.15, (2, inside.size)) / max(nx, ny)
    return replace(mesh, doflocs=p)


def disc(n: int, radius: float, quarter: bool) -> MeshTri:
    """The lower half of a disc, or its right half, with centre (0, radius); boundaries axis, top and arc.

    A grid under the map (x sqrt(1 - y^2/2), y sqrt(1 - x^2/2)) of the square to the disc.
    """
    diagonals = ("falling",) if quarter else ("rising", "falling")
    halves = [rm.shapes.rectangle(2 * n, n, x=(-1, 1), y=(-1, 0), diagonal=d) for d in diagonals]
    sides = [1] if quarter else [-1, 1]
    t = np.hstack([m.t[:, s * m.p[0, m.t].mean(axis=0) > 0] for m, s in zip(halves, sides, strict=True)])
    used, t = np.unique(t, return_inverse=True)
    x, y = halves[0].p[:, used]
    names = {"top": lambda q: np.isclose(q[1], 0), "axis": lambda q: np.isclose(q[0], 0)}
    names["arc"] = lambda q: np.isclose(np.abs(q[0]), 1) | np.isclose(q[1], -1)
    mesh = MeshTri(np.stack([x, y]), t.reshape(3, -1)).with_boundaries(names)
    p = radius * np.stack([x * np.sqrt(1 - y**2 / 2), 1 + y * np.sqrt(1 - x**2 / 2)])
    return replace(mesh, doflocs=p, _boundaries={k: v for k, v in mesh.boundaries.items() if len(v)})


def ring(around: int, across: int, inner: float) -> MeshTri:
    """The upper half of a ring of radius 5 with centre (0, 0): hole, arc, and base, its two ends."""
    mesh = rm.shapes.rectangle(around, across)
    names, (s, t) = mesh.boundaries, mesh.p
    p = (inner + (5 - inner) * t) * np.stack([-np.cos(np.pi * s), np.sin(np.pi * s) * (s < 1)])
    base = np.concatenate([names["left"], names["right"]])
    return replace(mesh, doflocs=p, _boundaries={"hole": names["bottom"], "arc": names["top"], "base": base})


def segment(nx: int, ny: int, radius: float) -> MeshTri:
    """A block (-1, 1) x (., 1) whose bottom, the arc, is on the circle with centre (0, radius)."""
    mesh = rm.shapes.rectangle(nx, ny, x=(-1, 1))
    low = radius - np.sqrt(radius**2 - mesh.p[0] ** 2)
    p, names = np.stack([mesh.p[0], low + (1 - low) * mesh.p[1]]), mesh.boundaries
    return replace(mesh, doflocs=p, _boundaries={**names, "arc": names["bottom"]})


def random(seed: int) -> Data:
    """A random problem; one in fifteen presses a supported node into the foundation."""
    rng = np.random.default_rng([seed, 23])
    family, pressed = FAMILIES[rng.integers(len(FAMILIES))], rng.integers(15) == 0
    make = {"membrane": _membrane, "obstacle": _obstacle, "curved": _curved}.get(family, _elastic)
    (name, options), limits = WAYS[rng.integers(len(WAYS))], LIMITS[rng.integers(family == "curved", 6)]
    rule, gap = ("auto", "auto", "midpoint", 4)[rng.integers(4)], ("", "node", "edge")[rng.integers(3)]
    how = {"limits": limits, "rule": rule, "gap": gap, "formulation": name, "options": options}
    certify = bool(rng.integers(3) == 0)
    return replace(make(rng, family, pressed), name=f"{family} {seed}", certify=certify, **how)


def _number(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 5)


def _membrane(rng: np.random.Generator, family: str, pressed: bool) -> Data:
    nx, ny = (int(k) for k in rng.integers(3, 7, 2))
    a, b, k, bend, top = (_number(rng, *ends) for ends in ((-3, -1), (0, 4), (2, 12), (0, 0.02), (-0.5, 0.5)))
    load = Material("laplace", (f"{a}+{b}*sin({k}*x)*cos(4*y)",))
    bend = bend * rng.integers(3) / 2
    wave = Foundation("right", "offset", f"0.01+{bend}*(1+sin({_number(rng, 3, 12) * ny}*y))")
    held, tops = ({"top": (-0.2,)}, {}) if pressed else ({"left": (0.0,)}, {"top": (top,)})
    return Data(family, block(nx, ny, 2, rng), (load,), wave, held, tops)


def _obstacle(rng: np.random.Generator, family: str, pressed: bool) -> Data:
    n, x, y = int(rng.integers(4, 7)), _number(rng, 0.3, 0.7), _number(rng, 0.3, 0.7)
    a, b, k, high = (_number(rng, *ends) for ends in ((-3, -0.5), (0, 2), (2, 12), (0.05, 0.09)))
    load = Material("laplace", (f"{a}+{b}*sin({k}*x)",))
    psi = f"{0.02 if pressed else -0.05}+{high}*exp(-((x-{x})**2+(y-{y})**2)/{_number(rng, 0.2, 2.4) / n}**2)"
    return Data(family, block(n, n, 1, rng), (load,), Foundation("interior", "interior", psi), SIDES)


def _elastic(rng: np.random.Generator, family: str, pressed: bool) -> Data:
    nx, ny = (int(k) for k in rng.integers(3, 7, 2))
    nx = 4 + nx % 2 * 2 if family == "regions" else nx
    young, kind = float(rng.choice([100, 1000])), ("plane-strain", "plane-stress")[rng.integers(2)]
    h, size, bend, phase = 2 / nx, young / 100, _number(rng, 0, 0.012), _number(rng, 0, 6)
    force = f"{size * _number(rng, -1, 1)}*sin(5*x)*cos(4*y)"
    soft = Material(kind, (force, 0.0), young, _number(rng, 0.1, 0.4))
    stiff = replace(soft, young=young * _number(rng, 3, 30), where="x > 1")
    materials = (replace(soft, where="x < 1"), stiff) if family == "regions" else (soft,)
    length = h * (_number(rng, 0.5, 2) if family == "waves" else 4)
    height = f"{-0.002 - bend}+{bend}*sin({2 * np.pi / length}*x+{phase})"
    if family == "waves" and rng.integers(2):
        place, width = _number(rng, 0.6, 1.8), h * _number(rng, 0.15, 0.7)
        height = f"-0.01+{_number(rng, 0.008, 0.02)}*exp(-((x-{place})/{width})**2)"
    side, down, k = size * _number(rng, -0.6, 0.6), -size * _number(rng, 0.5, 1), _number(rng, 1, 12)
    foundation = Foundation("bottom", "height", height, 0.0 if family == "waves" else _bound(rng, size))
    held, top = {"left": (0.0, -0.2 if pressed else 0.0)}, (side, f"{down}*(1+0.7*sin({k}*x))")
    return Data(family, block(nx, ny, 2, rng), materials, foundation, held, {"top": top})


def _bound(rng: np.random.Generator, size: float) -> Text:
    """A friction bound: none, constant, or one that varies within elements."""
    g, k = size * _number(rng, 0.2, 0.6), rng.choice([2, 3, 5, 8, 16])
    bump = f"{g}*(0.1+4*exp(-((x-{_number(rng, 0.3, 1.7)})/{_number(rng, 0.03, 0.15)})**2))"
    return (0.0, g, f"{g}*(1+0.95*sin({k}*pi*x+0.3))", bump)[rng.integers(4)]


def jumps(number: int) -> Data:
    """A random problem whose loads, friction or foundation jump or kink at one to three places."""
    rng = np.random.default_rng([number, 40])
    places = tuple(sorted(_number(rng, 0.1, 1.95) for _ in range(rng.integers(1, 4))))
    (name, options), limits = WAYS[rng.integers(len(WAYS))], LIMITS[rng.integers(6)]
    how = {"limits": limits, "formulation": name, "options": options, "certify": bool(rng.integers(2))}
    nx, ny = (int(k) for k in rng.integers(3, 8, 2))

    def stepped(low: float, high: float) -> str:
        text = str(_number(rng, low, high))
        for at in places:
            text = f"where(x > {at}, {_number(rng, low, high)}, {text})"
        return text

    if rng.integers(3) == 0:
        wave = Foundation("right", "offset", f"0.05+0.01*(1+sin({_number(rng, 3, 9)}*y))")
        source, mesh = (Material("laplace", (stepped(-4, -0.5),)),), block(nx, ny, 2, rng)
        data = Data("jumps", mesh, source, wave, {"left": (0.0,)}, {"top": (stepped(-2, 2),)})
    else:
        steel = Material("plane-strain", (0.0, 0.0), 1000.0, _number(rng, 0.0, 0.4))
        kinks = f"-0.003-{_number(rng, 0, 0.01)}*fabs(x-{places[0]})"
        friction = (0.0, stepped(0, 5))[rng.integers(2)]
        foundation = Foundation("bottom", "height", kinks, friction)
        tops = {"top": (stepped(-3, 3), stepped(-9, -1))}
        data = Data("jumps", block(nx, ny, 2, rng), (steel,), foundation, {"left": (0.0, 0.0)}, tops)
    return replace(data, name=f"jumps {number}", jumps=places, **how)


def shared(number: int) -> Data:
    """A random block whose contact boundary begins or ends, at a node, where a support fixes the gap."""
    rng = np.random.default_rng([number, 60])
    nx, ny, kind = 2 * int(rng.integers(5, 10)), int(rng.integers(4, 8)), int(rng.integers(4))
    mesh = block(nx, ny, 2, rng)
    bottom, split = mesh.boundaries["bottom"], 2 / nx * int(rng.integers(nx // 4, 3 * nx // 4))
    is_held = mesh.p[0, mesh.facets[:, bottom]].mean(axis=0) < split
    names = {**mesh.boundaries, "held": bottom[is_held], "free": bottom[~is_held]}
    body = Material("plane-strain", (0.0, 0.0), 1000.0, _number(rng, 0, 0.4))
    push, tilt = (_number(rng, -1, 1) for _ in range(2))
    held: tuple[dict[str, tuple[float | None, ...]], ...] = (
        {"held": (None, 0.0), "left": (0.0, None)},  # the plane of symmetry of a crack that closes
        {"held": (0.0, 0.0)},  # glued: the stress is singular at the end
        {"left": (0.0, 0.0)},  # the corner of a clamped side
        {"left": (0.0, 0.0), "right": (None, 0.0)},
    )
    return Data(
        f"shared {number}",
        replace(mesh, _boundaries=names),
        (body,),
        Foundation("free" if kind < 2 else "bottom", "height", 0.0),
        held[kind],
        {"top": (push, f"-5-4*{tilt}*(x-1)")},
        formulation="fixed",
        certify=True,
    )


def graded(number: int) -> Data:
    """A random block refined ten times at one of its corners, whose contact boundary is straight or wavy."""
    rng = np.random.default_rng([number, 70])
    data = _elastic(rng, ("friction", "waves")[rng.integers(2)], False)
    mesh, corner = data.mesh, np.array([[2.0 * rng.integers(2)], [float(rng.integers(2))]])
    for _ in range(10):
        at = int(np.argmin(np.linalg.norm(mesh.p - corner, axis=0)))
        mesh = refined(data, mesh, np.flatnonzero(np.any(mesh.t == at, axis=0)))
    return replace(data, name=f"graded {number}", mesh=mesh, formulation="fixed", certify=True)


STEPS = (
    "(1-arctan2(1e-30,x-{0})/pi)",
    "(0.5+arctan(1/(1e-9*(x-{0})))/pi)",
    "(0.5+arctan(1e12*(x-{0}))/pi)",
    "(0.5+0.5*tanh(1e9*(x-{0})))",
    "(0.5+0.5*(x-{0})/sqrt((x-{0})**2+1e-24))",
    "(0.5+0.5*(x-{0})/fabs(x-{0}))",
    "(0.5+0.5*sqrt((x-{0})**2)/(x-{0}))",
    "1/(1+exp(-1e9*(x-{0})))",
    "fmin(fmax(1e10*(x-{0}),0),1)",
    "arctan2(1e-30,({0}-x)*(2+sin(3*x)))/pi",
    "where(arctan(1e9*(x-{0}))>0,1,0)",
    "(0.5+0.5*cos(arctan2(1e-30,x-{0})))",
    "where((x-{0})/fabs(x-{0})>0,1,0)",
    "where(fabs(fabs(x-{0}-5)-5)<2*(x-{0}),1,0)",
    "fmin(exp(1e9*(x-{0})),1)**2",
)
"""Texts of ``where(x > {0}, 1, 0)`` for x in (0, 2), but for a width of 1e-9."""

KINKS = (
    "sqrt((x-{0})**2)",
    "((x-{0})**2)**0.5",
    "(x-{0})*arctan(1e10*(x-{0}))*2/pi",
    "(x-{0})*tanh(1e8*(x-{0}))",
    "sqrt((x-{0})**2+1e-20)",
    "(x-{0})**2/fabs(x-{0})",
    "(3-fabs(fabs(x-{0})-3))",
)
"""Texts of ``fabs(x - {0})``."""


def hidden(number: int) -> Data:
    """A random problem of order 1 or 2 whose jumps and kinks hide in other functions, beside nodes."""
    rng = np.random.default_rng([number, 41])
    nx, ny = (int(k) for k in rng.integers(3, 7, 2))
    places: list[float] = []

    def disguised(template: str, plain: str, disguises: tuple[str, ...]) -> Hidden:
        # coefficients that are undefined there may not be looked at in the very place
        places.append(2 * float(rng.integers(nx) + rng.choice([1, 2, 3, 32, 61, 62, 63]) / 64) / nx + 1e-7)
        disguise = str(rng.choice(disguises))
        return Hidden.of(template, plain.format(places[-1]), disguise.format(places[-1]))

    def stepped(low: float, high: float) -> Text:
        first, last = _number(rng, low, high), _number(rng, low, high)
        if rng.integers(3) == 0:
            return disguised(f"{first}+{(last - first) / 2}*{{}}", "fabs(x-{0})", KINKS)
        return disguised(f"{first}+{last - first}*{{}}", "where(x>{0},1,0)", STEPS)

    few = [rng.integers(2) == 0 for _ in range(4)]
    if rng.integers(3) == 0:
        source = stepped(-4, -0.5) if few[0] else -1.0
        wave = f"0.05+0.01*(1+sin({_number(rng, 3, 9)}*y))"
        top = stepped(-2, 2) if few[1] or not few[0] else -0.5
        material, foundation = Material("laplace", (source,)), Foundation("right", "offset", wave)
        data = Data(
            "hidden", block(nx, ny, 2, rng), (material,), foundation, {"left": (0.0,)}, {"top": (top,)}
        )
    else:
        steel = Material("plane-strain", (0.0, 0.0), 1000.0, _number(rng, 0.0, 0.4))
        bend = _number(rng, 0, 0.01)
        kinks = disguised(f"-0.003-{bend}*{{}}", "fabs(x-{0})", KINKS) if few[0] else -0.003
        foundation = Foundation("bottom", "height", kinks, stepped(0.1, 5) if few[1] else 0.0)
        down = stepped(-9, -1) if few[2] or not (few[0] or few[1]) else -5.0
        mesh, tops = block(nx, ny, 2, rng), {"top": (_number(rng, -3, 3), down)}
        data = Data("hidden", mesh, (steel,), foundation, {"left": (0.0, 0.0)}, tops)
    weight = disguised("{}", "where(x>{0},1,0)", STEPS) if few[3] else None
    order, (name, options) = int(rng.integers(1, 3)), (FIXED, FIXED, JOINT)[rng.integers(3)]
    how = {"limits": 0.02, "formulation": name, "options": options, "certify": True, "order": order}
    return replace(data, name=f"hidden {number}", jumps=tuple(sorted(places)), weight=weight, **how)


def _curved(rng: np.random.Generator, family: str, pressed: bool) -> Data:
    material = (Material("plane-strain", (0.0, 0.0), 1000.0, _number(rng, 0.2, 0.4)),)
    g, k, shape = _number(rng, 1, 5), _number(rng, 1, 6), rng.integers(4)
    bound = (0.0, f"{g}*(1+0.9*sin({k}*x))")[rng.integers(2)]
    if shape == 3:
        inner, base = _number(rng, 2, 3.5), {"base": (0.0, _number(rng, 0.05, 0.3))}
        mesh = ring(int(rng.integers(8, 13)), int(rng.integers(2, 4)), inner)
        circles = {"arc": (0.0, 0.0, 5.0), "hole": (0.0, 0.0, inner)}
        return Data(family, mesh, material, Foundation("arc", "level", "5-y", bound), base, {}, circles)
    (nx, ny), radius = rng.integers(4, 8, 2).tolist(), (10.0, 1.0, _number(rng, 1.2, 5))[shape]
    mesh = segment(nx, ny, radius) if shape == 2 else disc((nx + 2) // 2 + shape, radius, shape == 1)
    under = _number(rng, 1.5, 4) * radius  # of a round foundation below, or around the body
    bowl, hill = f"{under}-sqrt(x**2+(y-{under})**2)", f"sqrt(x**2+(y+{under})**2)-{under}"
    round_ones = Foundation("arc", "level", bowl), Foundation("arc", "level", hill)
    foundation = (FLAT, FLAT, *round_ones)[rng.integers(4)]
    held: dict[str, Any] = {"top": (0.0, -_number(rng, 0.003, 0.02) * (1 if shape == 2 else radius))}
    tractions: dict[str, Any] = {}
    if shape and rng.integers(2):  # a half-disc would roll
        held, tractions = {"axis" if shape == 1 else "left": (0.0, None)}, {"top": (0.0, -_number(rng, 1, 8))}
        bound = 0.0  # the package refuses it at nodes that are held in one direction
    circles = {"arc": (0.0, radius, radius)}
    return Data(family, mesh, material, replace(foundation, friction=bound), held, tractions, circles)


def aimed() -> list[Data]:
    """Problems made to be exploited; the name says the family and the number."""
    first = list(_aimed())
    by_joint = [data for data in first if data.formulation == "joint" and data.name != "waves"]
    every = [*first, *(replace(data, formulation="mpcc") for data in by_joint)]
    return [replace(data, name=f"{data.name} #{i}") for i, data in enumerate(every)]


def _aimed() -> Iterator[Data]:
    steel, left = (Material("plane-strain", (0.0, 0.0), 1000.0, 0.3),), {"left": (0.0, 0.0)}
    strip, three = block(16, 4, 2), (JOINT, NESTED, AUTO)

    def by(data: Data, way: Way, **more: Any) -> Data:
        return replace(data, formulation=way[0], options=way[1], **more)

    for k, limits, ways in ((3, None, (AUTO,)), (8, 0.04, three), (16, 0.04, three)):
        rough = Foundation("bottom", "height", 0.0, f"8*(1+0.95*sin({k}*pi*x+0.3))")
        one = Data("friction", strip, steel, rough, left, {"top": (6.0, -10.0)}, limits=limits)
        yield from (by(one, way) for way in ways)
    for one in _round(steel):
        yield from (by(one, way) for way in (AUTO, JOINT))
    for width in (0.03, 0.02, 0.06, 0.1):
        bump = f"-0.05+0.08*exp(-((x-0.5)**2+(y-0.5)**2)/{width}**2)"
        source, psi = (Material("laplace", (-1.0,)),), Foundation("interior", "interior", bump)
        one = Data("bump", block(8, 8, 1), source, psi, SIDES, limits=0.06, certify=width == 0.1)
        yield from (by(one, way, gap=gap) for way, gap in ((JOINT, ""), (AUTO, ""), (NESTED, "edge")))
    for k in (24, 8, 12, 16, 40):
        wave, load = Foundation("bottom", "height", f"-0.02+0.004*sin({k}*pi*x)"), {"top": (0.0, -10.0)}
        one = Data("waves", strip, steel, wave, left, load, limits=0.04, certify=k == 8)
        ways = ((JOINT, "edge"), (AUTO, ""), (NESTED, "node"), (MPCC, "edge"))
        yield from (by(one, way, gap=gap) for way, gap in ways)
    for bend in (0.025, 0.05, 0.1):
        mesh, bowl = rm.shapes.rectangle(4, 3, x=(-1, 1)), Foundation("bottom", "height", f"-{bend}*x**2")
        one = Data("bowl", mesh, steel, bowl, {"top": (0.0, -0.03)}, rule=6, certify=True)
        ways = ((JOINT, rm.Relative(0.3)), (AUTO, None), (NESTED, 0.1))
        yield from (by(one, way, limits=limits) for way, limits in ways)
    for k in (0, 3, 7, 11):
        source = (Material("laplace", (f"-2+3*sin({k}*x)*cos(4*y)",)),)
        offset = Foundation("right", "offset", "0.01+0.02*(1+sin(9*y))" if k == 7 else 0.01)
        for mesh in (block(4, 4, 1), block(8, 2, 2), block(5, 4, 2)):
            yield Data("coarse", mesh, source, offset, {"left": (0.0,)}, certify=k == 3)
    for k, mesh in ((k, mesh) for k in (1, 5, 9) for mesh in (block(6, 3, 2), block(4, 4, 2))):
        for bound in (0.0, "3*(1+0.9*sin(5*pi*x))"):
            ramp, load = Foundation("bottom", "height", "-0.01*x", bound), f"-10*(1+0.7*sin({k}*x))"
            yield Data("coarse", mesh, steel, ramp, left, {"top": ("2*sin(3*x)", load)})


def _round(steel: tuple[Material, ...]) -> Iterator[Data]:
    """Bodies whose nodes slide along an arc that touches."""
    rubber, lid = (Material("plane-strain", (0.0, 0.0), 5.0, 0.45),), Foundation("arc", "level", "5-y")
    for n in (8, 4):
        circle, down = {"arc": (0.0, 10.0, 10.0)}, {"top": (0.0, -2.0)}
        yield Data("half-disc", disc(n, 10.0, False), steel, FLAT, {"top": (0.0, -0.1)}, {}, circle)
        yield Data("quarter", disc(n + 2, 10.0, True), steel, FLAT, {"axis": (0.0, None)}, down, circle)
        circle = {"arc": (0.0, 0.0, 5.0), "hole": (0.0, 0.0, 3.0)}
        yield Data("ring", ring(4 * n, n // 2, 3.0), rubber, lid, {"base": (0.0, 0.3)}, {}, circle)
        circle = {"arc": (0.0, 2.0, 2.0)}
        yield Data("segment", segment(2 * n, n, 2.0), steel, FLAT, {"top": (0.0, -0.02)}, {}, circle)


KINDS: dict[str, Callable[[int], Data]] = {
    "random": random,
    "jumps": jumps,
    "shared": shared,
    "graded": graded,
    "hidden": hidden,
    "aimed": lambda number: aimed()[number],
}
"""Problems by kind, of a seed or a number."""
