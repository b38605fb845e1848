"""The data of a problem, from which both are made: the package's problem and the arrays of the check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
from skfem import MeshTri

import rmesh_nlp as rm

Text = str | float
"""A coefficient: a number, or a text such as "8*(1+0.9*sin(pi*x))"."""

FUNCTIONS = ("arctan2", "sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "arctan", "fabs", "fmax", "fmin")


class Hidden(str):
    """A text for the check, whose jumps and kinks are said, and ``given``, the same one for the package."""

    given: str

    @classmethod
    def of(cls, template: str, plain: str, disguise: str) -> Hidden:
        """Both by a template with one ``{}``."""
        text = cls(template.format(plain))
        text.given = template.format(disguise)
        return text


def formula(text: Text, library: ModuleType = np) -> Callable[[Any, Any], Any]:
    """A function of position with the functions of numpy (the check) or CasADi (the package)."""
    code = compile(str(text), str(text), "eval")
    names = {"pi": np.pi, "__builtins__": {}, **{name: getattr(library, name) for name in FUNCTIONS}}
    names["where"] = np.where if library is np else rm.where
    return lambda x, y: eval(code, names, {"x": x, "y": y})


def coefficient(text: Text) -> Any:
    """A number, or a function for the package."""
    return formula(getattr(text, "given", text), ca) if isinstance(text, str) else float(text)


def values(text: Text, points: np.ndarray) -> np.ndarray:
    """A coefficient at points (2, ...)."""
    return formula(text)(*points) + np.zeros(points.shape[1:])


@dataclass(frozen=True)
class Material:
    """A law "laplace", "plane-strain" or "plane-stress"; of the first, ``young`` is the conductivity.

    ``where`` is a condition on the centroids of its triangles.
    """

    kind: str
    loads: tuple[Text, ...]
    young: float = 1.0
    poisson: float = 0.0
    where: str = "x == x"

    @property
    def tensor(self) -> np.ndarray:
        """C (c, 2, c, 2) of the energy density ``grad u : C : grad u / 2``."""
        E, nu, one = self.young, self.poisson, np.eye(2)
        if len(self.loads) == 1:
            return E * one.reshape(1, 2, 1, 2)
        lam = E * nu / ((1 - nu**2) if self.kind == "plane-stress" else (1 + nu) * (1 - 2 * nu))
        shear = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
        return lam * np.einsum("ij,kl->ijkl", one, one) + E / (2 * (1 + nu)) * shear

    def law(self) -> Any:
        """The package's law."""
        loads = tuple(coefficient(text) for text in self.loads)
        if len(loads) == 1:
            return rm.Laplace(loads[0], self.young)
        kind = rm.PlaneStress if self.kind == "plane-stress" else rm.PlaneStrain
        return kind.from_young(self.young, self.poisson, loads)

    def triangles(self, mesh: MeshTri) -> np.ndarray:
        """Numbers of its triangles."""
        return np.flatnonzero(formula(self.where)(*mesh.p[:, mesh.t].mean(axis=1)))


@dataclass(frozen=True)
class Foundation:
    """Where contact may be: gaps ``n(x) . u + d(x)``, linear in the displacement, with friction bound g(x).

    ``kind`` says what ``shape`` is: the "offset" of a scalar problem, an "interior" obstacle u >= shape, the
    "height" of a foundation below the body, or a "level" function that is positive where the body may be: its
    gap is linearised at the undeformed place.
    """

    boundary: str
    kind: str
    shape: Text
    friction: Text = 0.0

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normals (c, ...) and distances (...) at points (2, ...)."""
        one, zero = np.ones(points.shape[1:]), np.zeros(points.shape[1:])
        if self.kind in ("offset", "interior"):
            return one[None], values(self.shape, points) * (1 if self.kind == "offset" else -1)
        if self.kind == "height":
            return np.stack([zero, one]), points[1] - values(self.shape, points)
        step = 1e-30j * np.eye(2).reshape(2, 2, *[1] * one.ndim)  # complex steps have no rounding
        slope = np.stack([values(self.shape, points + part).imag / 1e-30 for part in step])
        size = np.linalg.norm(slope, axis=0)
        return slope / size, values(self.shape, points) / size

    def obstacle(self, gap: str) -> Any:
        """The package's obstacle, with gaps at nodes or along edges."""
        shape, friction = coefficient(self.shape), coefficient(self.friction)
        made = {
            "interior": lambda: rm.Obstacle.interior(shape),
            "offset": lambda: rm.Obstacle(self.boundary, (1.0,), shape),
            "height": lambda: rm.Obstacle.graph(self.boundary, shape, friction),
            "level": lambda: rm.Obstacle.curve(self.boundary, shape, friction),
        }[self.kind]()
        return replace(made, gap=gap) if gap and hasattr(made, "gap") else made


@dataclass(frozen=True)
class Data:
    """A problem, and how the package is to solve it.

    ``held`` and ``tractions`` map names of boundaries to one entry per component (None: free), ``circles``
    to centre and radius of the curve that a boundary is on; its nodes slide along it. Displacements are of
    ``order`` 1 or 2. Loads may jump at ``jumps``, values of x. A quantity is the integral of ``weight`` times
    the last component of the displacement along the top.
    """

    name: str
    mesh: MeshTri
    materials: tuple[Material, ...]
    foundation: Foundation
    held: Mapping[str, tuple[float | None, ...]]
    tractions: Mapping[str, tuple[Text, ...]] = field(default_factory=dict)
    circles: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    limits: Any = None
    rule: str | int = "auto"
    gap: str = ""
    formulation: str = "auto"
    options: Mapping[str, Any] = field(default_factory=dict)
    certify: bool = False
    order: int = 1
    jumps: tuple[float, ...] = ()
    weight: Hidden | None = None

    @property
    def components(self) -> int:
        """1 or 2."""
        return len(self.materials[0].loads)

    def problem(self) -> rm.ContactProblem:
        """The package's problem."""
        zones = {f"part {i}": one for i, one in enumerate(self.materials)}
        mesh = self.mesh.with_subdomains({name: one.triangles(self.mesh) for name, one in zones.items()})
        return rm.ContactProblem(
            mesh,
            {name: one.law() for name, one in zones.items()},
            tuple(rm.Dirichlet(*item) for item in self.held.items()),
            self.foundation.obstacle(self.gap),
            rm.Motion(self.limits, curves={k: rm.Circle(c[:2], c[2]) for k, c in self.circles.items()}),
            tuple(rm.Traction(k, tuple(map(coefficient, parts))) for k, parts in self.tractions.items()),
            quadrature=self.rule,
            name=self.name,
            order=self.order,
        )
