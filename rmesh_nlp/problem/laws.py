"""Material laws: a scalar diffusion law and isotropic elasticity, plane or of a body of revolution."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import casadi as ca
import numpy as np
from skfem.models.elasticity import lame_parameters

from rmesh_nlp.display import describe
from rmesh_nlp.errors import BadInputError, require
from rmesh_nlp.evaluation import Array, Expression, is_finite
from rmesh_nlp.problem.coefficients import Coefficient, Parameter, convert, is_number, numeric
from rmesh_nlp.settings import Number, check_positive

YOUNGS = 100
"""Lamé's lambda over a mu below 0.5 from which on the two are rather Young's modulus and Poisson's ratio."""

LOCKING = 0.45
"""Poisson's ratio from which on linear triangles in plane strain are too stiff."""


def revolution(x: Expression, y: Expression) -> Expression:
    """The measure of a body of revolution with x = r, y = z: the length of the circle."""
    return 2 * np.pi * x


def entries(matrix: Expression) -> list[list[Expression]]:
    """A matrix of CasADi row by row."""
    return [ca.horzsplit(row) for row in ca.vertsplit(matrix)]


class Law(ABC):
    """A linear material law; a law of your own derives from it, and needs no other change.

    Gradients of the displacement are ``gradient[i][j]``: numbers, arrays or expressions.
    """

    components: ClassVar[int]
    """Number of displacement components, 1 or 2."""

    @property
    @abstractmethod
    def load(self) -> tuple[Coefficient, ...]:
        """Source or body force, one coefficient per component."""

    @property
    @abstractmethod
    def least_modulus(self) -> float:
        """The least ratio of ``energy_product`` to the square of a gradient, or of a strain."""

    @abstractmethod
    def in_words(self, stress: str) -> str:
        """The law's numbers, with ``stress`` as the unit of moduli, and its load."""

    @property
    def axisymmetric(self) -> bool:
        """Whether the body is one of revolution about x = 0: forces and energies are of the whole body."""
        return False

    @property
    def measure(self) -> Coefficient:
        """What a unit of area counts in all integrals, and on boundaries a unit of length, by its place."""
        return revolution if self.axisymmetric else 1.0

    def extended(self, gradient: Any, u: Any, x: Any) -> Any:
        """What energy density and stress are functions of, the gradient (components, 2, ...) by default.

        Columns that follow it are linear in gradient and displacement u (components, ...) at the place
        x (2, ...); all are arrays or CasADi expressions. The stress has as many columns.
        """
        return gradient

    @property
    def takes_displacement(self) -> bool:
        """Whether the energy depends on more than the gradient of the displacement."""
        return type(self).extended is not Law.extended

    @property
    def has_hoop(self) -> bool:
        """Whether the energy depends on the hoop strain u_r / r of a body of revolution."""
        return self.axisymmetric and self.takes_displacement

    @property
    def varies(self) -> bool:
        """Whether the energy depends on the place, or on more than the gradient."""
        return callable(self.measure) or self.takes_displacement

    def energy_density(self, gradient: Expression) -> Expression:
        """Energy per measure, a quadratic function of what :meth:`extended` makes of a gradient of CasADi."""
        return 0.5 * self.energy_product(entries(gradient))

    @abstractmethod
    def stress(self, gradient: Any) -> list[list[Any]]:
        """Stress, or flux, by component and direction."""

    def written(self, gradient: Any) -> list[Any]:
        """What files and pictures have: the flux, or sigma_xx, sigma_yy, sigma_xy and sigma_zz."""
        return self.stress(gradient)[0]

    def energy_product(self, gradient: Any) -> Any:
        """Stress times gradient: twice the energy density."""
        rows = zip(self.stress(gradient), gradient, strict=True)
        return sum(s * g for row in rows for s, g in zip(*row, strict=True))

    @property
    def locking(self) -> float:
        """Poisson's ratio where linear triangles are much too stiff; else 0."""
        return 0.0

    @property
    def moduli(self) -> Array:
        """(components, columns, components, columns) stresses of unit gradients, as :meth:`extended`."""
        one = np.zeros((self.components, 2)), np.zeros(self.components), np.ones(2)
        shape = self.extended(*one).shape
        units = np.eye(shape[0] * shape[1]).reshape(-1, *shape)
        return np.array([self.stress(unit) for unit in units], dtype=float).reshape(*shape, *shape)

    @property
    def stiffness(self) -> Array:
        """(values, values) stresses of a unit gradient, or of unit strains xx, yy, twice xy, any hoop."""
        values = self.components + self.moduli.shape[1] - 1
        places = ((0, 0), (0, 1)) if self.components == 1 else ((0, 0), (1, 1), (0, 1), (0, 2))
        i, j = zip(*places[:values], strict=True)
        return self.moduli[i, j][:, i, j]

    @property
    def compliance(self) -> Array:
        """Its inverse."""
        return np.asarray(np.linalg.inv(self.stiffness), dtype=float)


@dataclass(frozen=True)
class Laplace(Law):
    """Scalar problem (3.1): ``-div(conductivity grad u) = source``.

    Energy 1/2 (conductivity grad u, grad u) - (source, u).

    Parameters
    ----------
    source : float or function of position
        Right-hand side, per area; 0 by default.
    conductivity : float
        Positive; 1 by default.
    axisymmetric : bool
        Whether the body is one of revolution about x = 0, with x = r and y = z; False by default.
    """

    source: Coefficient = 0.0
    conductivity: Parameter = 1.0
    axisymmetric: bool = False
    components: ClassVar[int] = 1

    def __post_init__(self) -> None:
        convert(self)
        if is_number(self.conductivity):
            check_positive(conductivity=self.conductivity)

    @property
    def load(self) -> tuple[Coefficient, ...]:
        """Source, one coefficient per component."""
        return (self.source,)

    def in_words(self, stress: str) -> str:
        """Conductivity and source."""
        round_ = ", axisymmetric" * self.axisymmetric
        return f"Laplace{round_}, conductivity {describe(self.conductivity)}, source {describe(self.source)}"

    @property
    def least_modulus(self) -> float:
        """The conductivity."""
        return self.conductivity

    def stress(self, gradient: Any) -> list[list[Any]]:
        """The flux, conductivity times grad u."""
        return [[self.conductivity * slope for slope in gradient[0]]]


E = TypeVar("E", bound="Elastic")


@dataclass(frozen=True)
class Elastic(Law):
    """Isotropic elasticity (3.7) with Lamé coefficients in N/m^2: the base of the two plane laws.

    Parameters
    ----------
    lame_lambda, lame_mu : float
        In units of stress; mu and lambda + mu are positive.
    body_force : tuple of float or function of position
        Force per volume, one entry per displacement component; zero by default.
    """

    lame_lambda: Parameter
    lame_mu: Parameter
    body_force: tuple[Coefficient, Coefficient] = (0.0, 0.0)
    components: ClassVar[int] = 2

    def __post_init__(self) -> None:
        convert(self)
        if is_number(self.lame_mu) and is_number(self.lame_lambda):
            a, mu = self.lame_lambda, self.lame_mu
            if not (is_finite([a, mu]) and mu > 0 and a + 2 * mu > 0 and self.in_plane_lambda + mu > 0):
                said = "are not those of an elastic solid: mu > 0 and lambda + mu > 0 are needed"
                raise BadInputError(f"Lamé coefficients lambda={a}, mu={mu} {said}", "lame_mu")
            if mu < 0.5 and a > YOUNGS * mu:
                said = f"lambda={a:g}, mu={mu:g} are Lamé coefficients: Young's modulus and Poisson's ratio"
                warnings.warn(f"{said} go to {type(self).__name__}.from_young", stacklevel=3)
        require(len(self.body_force) == 2, "body_force", "have 2 components", self.body_force)

    @classmethod
    def from_young(
        cls: type[E],
        young: Parameter,
        poisson: Parameter,
        body_force: tuple[Coefficient, Coefficient] = (0.0, 0.0),
    ) -> E:
        """The law with Young's modulus E in N/m^2 and Poisson's ratio nu, -1 < nu < 0.5."""
        young, poisson = numeric("young", young), numeric("poisson", poisson)
        if is_number(young):
            Number().check("young", young)
        require(not is_number(poisson) or -1 < poisson < 0.5, "poisson", "lie between -1 and 0.5", poisson)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # these are Lamé coefficients
            lame_lambda, lame_mu = lame_parameters(young, poisson)
            return cls(lame_lambda, lame_mu, body_force)

    @property
    def load(self) -> tuple[Coefficient, ...]:
        """Body force."""
        return self.body_force

    def in_words(self, stress: str) -> str:
        """Lamé coefficients, with ``stress`` as their unit, and body force."""
        force = ", ".join(map(describe, self.body_force))
        lame = f"lambda {describe(self.lame_lambda)}, mu {describe(self.lame_mu)}{stress}"
        return f"{type(self).__name__}, {lame}, body force ({force})"

    @property
    def least_modulus(self) -> float:
        """The lesser of 2 mu and 2 (lambda + mu), lambda that in the plane."""
        return 2 * min(self.lame_mu, self.in_plane_lambda + self.lame_mu)

    @property
    def compliance(self) -> Array:
        """The inverse of ``stiffness``, also of a body that is almost incompressible."""
        share = self.in_plane_lambda / (2 * (self.in_plane_lambda + self.lame_mu))
        return np.array([[1 - share, -share, 0], [-share, 1 - share, 0], [0, 0, 2]]) / (2 * self.lame_mu)

    def stress(self, gradient: Any) -> list[list[Any]]:
        """The stress in the plane."""
        trace = self.in_plane_lambda * (gradient[0][0] + gradient[1][1])
        shear = self.lame_mu * (gradient[0][1] + gradient[1][0])
        xx, yy = (trace + 2 * self.lame_mu * gradient[i][i] for i in range(2))
        return [[xx, shear], [shear, yy]]

    def written(self, gradient: Any) -> list[Any]:
        """sigma_xx, sigma_yy, sigma_xy and sigma_zz."""
        (xx, xy), (_, yy) = self.stress(gradient)
        return [xx, yy, xy, self.out_of_plane_stress(gradient[0][0] + gradient[1][1])]

    @property
    @abstractmethod
    def in_plane_lambda(self) -> float:
        """Factor of ``trace(strain) I`` in the in-plane stress."""

    @abstractmethod
    def out_of_plane_stress(self, trace: Expression) -> Expression:
        """sigma_zz for the trace of the in-plane strain."""


@dataclass(frozen=True)
class PlaneStrain(Elastic):
    """Elasticity of a long body: no strain out of the plane (3.7)."""

    @property
    def poisson(self) -> float:
        """Poisson's ratio."""
        return self.lame_lambda / (2 * (self.lame_lambda + self.lame_mu))

    @property
    def locking(self) -> float:
        """Poisson's ratio of a body that is almost incompressible."""
        return self.poisson if self.poisson > LOCKING else 0.0

    @property
    def in_plane_lambda(self) -> float:
        """Lambda itself."""
        return self.lame_lambda

    def out_of_plane_stress(self, trace: Expression) -> Expression:
        """Lambda times the trace."""
        return self.lame_lambda * trace


@dataclass(frozen=True)
class Axisymmetric(PlaneStrain):
    """Elasticity of a body of revolution about x = 0, with x = r and y = z: plane strain and u_r / r.

    Energies and forces are of the whole body, also those of point loads: on r > 0 of a circle of them. Nodes
    on r = 0 have u_r = 0 without being asked.
    """

    compliance = Law.compliance

    @property
    def axisymmetric(self) -> bool:
        """True."""
        return True

    def extended(self, gradient: Any, u: Any, x: Any) -> Any:
        """The gradient with the column (u_r / r, 0), the hoop strain."""
        hoop = u[0] / x[0]
        if isinstance(gradient, np.ndarray):
            return np.concatenate([gradient, np.stack([hoop, 0 * hoop])[:, None]], axis=1)
        return ca.horzcat(gradient, ca.vertcat(hoop, 0))

    def stress(self, gradient: Any) -> list[list[Any]]:
        """The stress in the half-plane, and beside it the hoop stress; of a bare gradient without u_r / r."""
        (rr, rz), (_, zz) = super().stress(gradient)
        if len(gradient[0]) == 2:
            return [[rr, rz], [rz, zz]]
        hoop, push = gradient[0][2], self.lame_lambda * gradient[0][2]
        around = self.out_of_plane_stress(gradient[0][0] + gradient[1][1]) + push + 2 * self.lame_mu * hoop
        return [[rr + push, rz, around], [rz, zz + push, 0 * hoop]]

    def written(self, gradient: Any) -> list[Any]:
        """sigma_rr, sigma_zz, sigma_rz and the hoop stress."""
        (rr, rz, around), (_, zz, _) = self.stress(gradient)
        return [rr, zz, rz, around]


@dataclass(frozen=True)
class PlaneStress(Elastic):
    """Elasticity of a thin plate: no stress out of the plane.

    The condition sigma_zz = 0 replaces lambda by 2 lambda mu / (lambda + 2 mu).
    """

    @property
    def in_plane_lambda(self) -> float:
        """2 lambda mu / (lambda + 2 mu)."""
        return 2 * self.lame_lambda * self.lame_mu / (self.lame_lambda + 2 * self.lame_mu)

    def out_of_plane_stress(self, trace: Expression) -> Expression:
        """Zero."""
        return 0 * trace
