"""Brackets of displacements of both orders around energies that are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.certificate.bracket import Bracket, bracket, refined_bracket
from rmesh_nlp.certificate.equilibration import Guess
from rmesh_nlp.certificate.lower_bound import LowerBound
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.paper import EXACT_ENERGY_61
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Obstacle, Place, Traction
from support.certificates import distorted, guess_on, of_values
from support.problems import renumbered

Field = Callable


def on(problem: ContactProblem) -> Bracket:
    return bracket(problem, problem.mesh.p, guess_on(problem))


def smooth(n: int, order: int) -> ContactProblem:
    """u = sin(pi x) sin(pi y) under its source, on the right under its traction; least energy -pi^2 / 4."""
    source = Laplace(lambda x, y: 2 * np.pi**2 * ca.sin(np.pi * x) * ca.sin(np.pi * y))
    pull = Traction("right", (lambda x, y: -np.pi * ca.sin(np.pi * y),))
    return ContactProblem(rectangle(n, n), source, ("left", "bottom", "top"), tractions=pull, order=order)


def pulled(mesh: MeshTri, slope: tuple[Field, Field], **settings) -> ContactProblem:
    """A harmonic displacement with this gradient, pulled by its fluxes at the sides of a box."""
    (ux, uy), sides = slope, mesh.boundaries
    out = {
        "left": lambda x, y: -ux(x, y),
        "right": ux,
        "bottom": lambda x, y: -uy(x, y),
        "top": uy,
    }
    loads = tuple(Traction(side, (flux,)) for side, flux in out.items() if side in sides)
    return ContactProblem(mesh, Laplace(), tractions=loads, **settings)


def l_shape(n: int, order: int) -> ContactProblem:
    """r^(2/3) sin(2 t / 3) on three squares of n x n cells around the re-entrant corner at the origin."""
    mesh = rectangle(2 * n, 2 * n, x=(-1, 1), y=(-1, 1))
    middle = mesh.p[:, mesh.t].mean(axis=1)
    mesh = mesh.remove_elements(np.flatnonzero((middle[0] > 0) & (middle[1] < 0)))
    sides = {"left": (0, -1), "right": (0, 1), "bottom": (1, -1), "top": (1, 1)}
    mesh = mesh.with_boundaries(
        {name: lambda x, i=i, at=at: np.isclose(x[i], at) for name, (i, at) in sides.items()}
        | {"corner": lambda x: (x[0] > -1e-9) & (x[1] < 1e-9) & (np.min(np.abs(x), axis=0) < 1e-9)}
    )

    def turned(x, y):  # the angle, from the left part of the negative y axis on
        return ca.atan2(-x - y, x - y) / 3 + np.pi / 4

    def slope(shape: Field) -> Field:
        return lambda x, y: 2 / 3 * (x * x + y * y) ** (-1 / 6) * shape(turned(x, y))

    return pulled(
        mesh, (slope(lambda t: -ca.sin(t)), slope(ca.cos)), dirichlet=("corner",), order=order
    )


def signorini(n: int, order: int) -> ContactProblem:
    """r^(3/2) cos(3 t / 2), which leaves the obstacle at the origin; held where it touches left of -1/2."""
    mesh = rectangle(2 * n + 1, n, x=(-1, 1))
    bottom = np.asarray(mesh.boundaries["bottom"])
    held = mesh.p[0, mesh.facets[:, bottom]].mean(axis=0) < -0.5
    parts = {name: part for name, part in mesh.boundaries.items() if name != "bottom"}
    mesh = replace(mesh, _boundaries=parts | {"held": bottom[held], "free": bottom[~held]})
    root = lambda x, y: 1.5 * (x * x + y * y + 1e-30) ** 0.25  # noqa: E731
    slope = (
        lambda x, y: root(x, y) * ca.cos(ca.atan2(y, x) / 2),
        lambda x, y: -root(x, y) * ca.sin(ca.atan2(y, x) / 2),
    )
    return pulled(mesh, slope, dirichlet=("held",), obstacle=Obstacle("free", (1.0,)), order=order)


@lru_cache
def least_energy(name: str) -> float:
    """Less half the work of the tractions of the harmonic problems, by Gauss's rule on whole sides."""
    s, weights = np.polynomial.legendre.leggauss(200)
    s, weights = (1 + s) / 2, weights / 2
    if name == "smooth":
        return -(np.pi**2) / 4
    power, first, shape = {"l_shape": (2 / 3, 0.0, np.sin), "signorini": (3 / 2, -1.0, np.cos)}[name]
    corners = [(1, 0), (1, 1), (-1, 1), (-1, 0)]
    if name == "l_shape":
        corners = [*corners[:3], (-1, -1), (0, -1)]
    total = 0.0
    for a, b in zip(np.array(corners, dtype=float), np.array(corners[1:], dtype=float), strict=False):
        x, y = a[:, None] + (b - a)[:, None] * s
        z = x + 1j * y
        z = np.abs(z) * np.exp(1j * np.mod(np.angle(z), 2 * np.pi))
        r, t = np.abs(z), np.mod(np.angle(z), 2 * np.pi)
        turn = np.exp(1j * (power - 1) * t) * power * r ** (power - 1)  # derivative of z^power
        slope = (turn.imag, turn.real) if shape is np.sin else (turn.real, -turn.imag)
        normal = (b - a)[1], -(b - a)[0]
        total += weights @ (r**power * shape(power * t) * (slope[0] * normal[0] + slope[1] * normal[1]))
    return -total / 2
