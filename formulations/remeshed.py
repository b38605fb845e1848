"""The metric start: a mesh by Mmg that suits the solution, on which the nodes are relocated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.meshes.mmg import LARGEST, MISSING, is_available
from rmesh_nlp.models.remeshing import Solved, metric_start
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.motion import Relative
from rmesh_nlp.solving.formulation import Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Work


@dataclass(frozen=True)
class Remeshed(Wrapper):
    """Runs a formulation on a new mesh of the domain, made for the solution; without absolute move limits.

    Names of boundaries and subdomains are kept; nodes that cannot move stay. Energies are compared with those
    of the given mesh.

    Attributes
    ----------
    nodes : int or True
        Nodes of the new mesh, up to two percent; True for as many as the given one has.
    """

    nodes: int | bool = True
    begins_by_itself: ClassVar[tuple[str, ...]] = ("starts", "seed", "start")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nodes is not True and not (isinstance(self.nodes, int) and 3 <= self.nodes <= LARGEST):
            said = f"remesh must be true or a number of nodes from 3 to {LARGEST}"
            raise BadInputError(f"{said}, got {self.nodes!r}")

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        super().accepts(problem, objective)
        if not is_available():
            raise BadInputError(MISSING)
        if not objective.is_energy:
            raise BadInputError(f"remeshing lowers the error of the energy, not {objective.text!r}")
        delta = problem.motion.delta
        if delta is not None and not isinstance(delta, Relative):
            said = "move limits in units of length belong to the nodes of the given mesh"
            raise BadInputError(f'{said}: remeshing needs relative ones, or none (delta = "none")')

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        nodes = outer.problem.n_vertices if self.nodes is True else int(self.nodes)
        with monitor.budget.during("build"):
            start = metric_start(Solved(outer.contact, outer.contact.given), nodes)
        monitor.work += Work(len(start.nodes), len(start.nodes))
        remeshed = Outer(
            start.solved.solver, outer.objective, outer.tolerance, is_near=True, gain=start.solved.error
        )
        outcome = monitor.run(self.inner, remeshed, remeshed.variables())
        made = f"on a mesh of {start.solved.problem.n_vertices} nodes that Mmg made for the solution"
        meshes = {"remeshed_nodes": start.nodes, "remeshed_energies": start.energies}
        return outcome.having(meshes, remarks=(made, *outcome.remarks))
