"""The public names: type checkers read them here, and ``__init__.py`` loads them from here on first use."""

from rmesh_nlp import mpcc as mpcc
from rmesh_nlp.api.results import Comparison as Comparison
from rmesh_nlp.api.results import compare as compare
from rmesh_nlp.api.results import plot as plot
from rmesh_nlp.api.results import read_records as read_records
from rmesh_nlp.contact.setup_warnings import check as check
from rmesh_nlp.errors import BadInputError as BadInputError
from rmesh_nlp.examples import EXAMPLES as EXAMPLES
from rmesh_nlp.fem import objective_text
from rmesh_nlp.fem import quantities as quantities
from rmesh_nlp.io import problem_file
from rmesh_nlp.io.export import write_solution as write_solution
from rmesh_nlp.meshes import shapes as shapes
from rmesh_nlp.meshes.curves import Circle as Circle
from rmesh_nlp.meshes.curves import Parametrised as Parametrised
from rmesh_nlp.meshes.curves import Spline as Spline
from rmesh_nlp.meshes.reading import read_mesh as read_mesh
from rmesh_nlp.mpcc import MPCC as MPCC
from rmesh_nlp.optimize.budget import Limits as Limits
from rmesh_nlp.optimize.status import Status as Status
from rmesh_nlp.problem import Axisymmetric as Axisymmetric
from rmesh_nlp.problem import Constraint as Constraint
from rmesh_nlp.problem import ContactProblem as ContactProblem
from rmesh_nlp.problem import DesignVariable as DesignVariable
from rmesh_nlp.problem import Dirichlet as Dirichlet
from rmesh_nlp.problem import ExactSolution as ExactSolution
from rmesh_nlp.problem import Laplace as Laplace
from rmesh_nlp.problem import LoadStep as LoadStep
from rmesh_nlp.problem import Motion as Motion
from rmesh_nlp.problem import Obstacle as Obstacle
from rmesh_nlp.problem import PlaneStrain as PlaneStrain
from rmesh_nlp.problem import PlaneStress as PlaneStress
from rmesh_nlp.problem import PointLoad as PointLoad
from rmesh_nlp.problem import ProblemError as ProblemError
from rmesh_nlp.problem import Relative as Relative
from rmesh_nlp.problem import Shape as Shape
from rmesh_nlp.problem import Traction as Traction
from rmesh_nlp.problem import Units as Units
from rmesh_nlp.problem import refined as refined
from rmesh_nlp.problem import where as where
from rmesh_nlp.solving.certify import certify as certify
from rmesh_nlp.solving.driver import solve as solve
from rmesh_nlp.solving.formulation import Formulation as Formulation
from rmesh_nlp.solving.formulation import formulations as formulations
from rmesh_nlp.solving.monitor import Monitor as Monitor
from rmesh_nlp.solving.outcome import Outcome as Outcome
from rmesh_nlp.solving.outer import Outer as Outer
from rmesh_nlp.solving.solution import Solution as Solution
from rmesh_nlp.solving.verification import verify_gradient as verify_gradient

__version__: str

objective = objective_text.parse_objective
read_problem = problem_file.load_problem
solve_mpcc = mpcc.solve
