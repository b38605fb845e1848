"""Material laws: a scalar diffusion law and isotropic elasticity in the plane."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from numbers import Real
from typing import ClassVar, TypeVar

import casadi as ca
from skfem.models.elasticity import lame_parameters

from rmesh_nlp.display import describe
from rmesh_nlp.errors import BadInputError, require
from rmesh_nlp.evaluation import Expression, is_finite
from rmesh_nlp.problem.coefficients import Coefficient, is_number
from rmesh_nlp.problem.conditions import as_tuple
from rmesh_nlp.settings import Number, check_positive

YOUNGS = 100
"""Lamé's lambda over a mu below 0.5 from which on the two are rather Young's modulus and Poisson's ratio."""

LOCKING = 0.45
"""Poisson's ratio from which on linear triangles in plane strain are too stiff."""


@dataclass(frozen=True)
class Laplace:
    """Scalar problem (3.1): ``-div(conductivity grad u) = source``.

    Energy 1/2 (conductivity grad u, grad u) - (source, u).

    Parameters
    ----------
    source : float or function of position
        Right-hand side, per area; 0 by default.
    conductivity : float
        Positive; 1 by default.
    """

    source: Coefficient = 0.0
    conductivity: float | ca.SX = 1.0
    components: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if is_number(self.conductivity):
            check_positive(conductivity=self.conductivity)

    @property
    def load(self) -> tuple[Coefficient, ...]:
        """Source, one coefficient per component."""
        return (self.source,)

    def in_words(self, stress: str) -> str:
        """Conductivity and source."""
        return f"Laplace, conductivity {describe(self.conductivity)}, source {describe(self.source)}"


E = TypeVar("E", bound="Elastic")


@dataclass(frozen=True)
class Elastic(ABC):
    """Isotropic elasticity (3.7) with Lamé coefficients in N/m^2: the base of the two plane laws.

    Parameters
    ----------
    lame_lambda, lame_mu : float
        In units of stress; mu and lambda + mu are positive.
    body_force : tuple of float or function of position
        Force per volume, one entry per displacement component; zero by default.
    """

    lame_lambda: float | ca.SX
    lame_mu: float | ca.SX
    body_force: tuple[Coefficient, Coefficient] = (0.0, 0.0)
    components: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if is_number(self.lame_mu) and is_number(self.lame_lambda):
            a, mu = self.lame_lambda, self.lame_mu
            if not (is_finite([a, mu]) and mu > 0 and a + 2 * mu > 0 and self.in_plane_lambda + mu > 0):
                said = "are not those of an elastic solid: mu > 0 and lambda + mu > 0 are needed"
                raise BadInputError(f"Lamé coefficients lambda={a}, mu={mu} {said}", "lame_mu")
            if mu < 0.5 and a > YOUNGS * mu:
                said = f"lambda={a:g}, mu={mu:g} are Lamé coefficients: Young's modulus and Poisson's ratio"
                warnings.warn(f"{said} go to {type(self).__name__}.from_young", stacklevel=3)
        require(len(as_tuple(self.body_force)) == 2, "body_force", "have 2 components", self.body_force)

    @classmethod
    def from_young(
        cls: type[E],
        young: float | ca.SX,
        poisson: float | ca.SX,
        body_force: tuple[Coefficient, Coefficient] = (0.0, 0.0),
    ) -> E:
        """The law with Young's modulus E in N/m^2 and Poisson's ratio nu, -1 < nu < 0.5."""
        if not isinstance(young, ca.SX):
            Number().check("young", young)
        is_ratio = isinstance(poisson, ca.SX) or (isinstance(poisson, Real) and -1 < float(poisson) < 0.5)
        require(is_ratio, "poisson", "lie between -1 and 0.5", poisson)
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
    def in_plane_lambda(self) -> float:
        """Lambda itself."""
        return self.lame_lambda

    def out_of_plane_stress(self, trace: Expression) -> Expression:
        """Lambda times the trace."""
        return self.lame_lambda * trace


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


Law = Laplace | Elastic


def energy_density(law: Law, gradient: Expression) -> Expression:
    """Energy per area as a function of the displacement gradient (components, 2)."""
    if isinstance(law, Laplace):
        return 0.5 * law.conductivity * ca.sumsqr(gradient)
    strain = (gradient + gradient.T) / 2
    return 0.5 * law.in_plane_lambda * ca.trace(strain) ** 2 + law.lame_mu * ca.sumsqr(strain)
