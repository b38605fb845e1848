"""A contact problem as a user describes it: mesh, laws, supports, loads, contact, and how nodes may move."""

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem.coefficients import Coefficient, PiecewiseLinear, PositionFunction, at, where
from rmesh_nlp.problem.conditions import Dirichlet, ExactSolution, LoadStep, PointLoad, Traction
from rmesh_nlp.problem.contact_problem import ContactProblem, locally_refined, refined
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.design import Constraint, DesignVariable, Shape
from rmesh_nlp.problem.laws import Axisymmetric, Elastic, Laplace, Law, PlaneStrain, PlaneStress
from rmesh_nlp.problem.motion import Motion, Relative
from rmesh_nlp.problem.obstacle import NO_CONTACT, Obstacle, Place
from rmesh_nlp.problem.units import Units

__all__ = [
    "NO_CONTACT",
    "Axisymmetric",
    "Coefficient",
    "Constraint",
    "ContactProblem",
    "ContactSet",
    "DesignVariable",
    "Dirichlet",
    "Elastic",
    "ExactSolution",
    "Laplace",
    "Law",
    "LoadStep",
    "Motion",
    "Obstacle",
    "PiecewiseLinear",
    "Place",
    "PlaneStrain",
    "PlaneStress",
    "PointLoad",
    "PositionFunction",
    "ProblemError",
    "Relative",
    "Shape",
    "Traction",
    "Units",
    "at",
    "locally_refined",
    "refined",
    "signed_areas",
    "where",
]
