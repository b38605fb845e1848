"""h-adaptive refinement until the estimated errors of quantities are below an accuracy.

Each mesh is solved, the errors are estimated (:mod:`rmesh_nlp.certificate.estimates`), and the triangles that
add most to those above the accuracy are bisected: as many as have ``BULK`` of the sum [1]_.

References
----------
.. [1] W. Doerfler, A convergent adaptive algorithm for Poisson's equation, SIAM J. Numer. Anal. 33 (1996)
   1106-1124.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from formulations.fixed import Fixed
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.estimates import ENERGY, Estimate, OnMesh, check, ended, estimates, of_contact
from rmesh_nlp.errors import BadInputError, ProblemError, one_line
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.conditions import as_tuple
from rmesh_nlp.problem.contact_problem import locally_refined
from rmesh_nlp.settings import Part
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.certify import bounded
from rmesh_nlp.solving.formulation import Choice, Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Bounds, Step, Work
from rmesh_nlp.solving.summary import estimate_in_words

BULK = 0.7
"""Share of the indicators in the triangles that are refined."""

FIRST = 0.2
"""Part of the accuracy that the estimate on the first mesh must meet, which no other mesh confirms. Of 30
random problems one stopped on its first mesh with an error of 1.3 times the accuracy."""

GROWTH = 1.5
"""Times as many nodes as of the last mesh that was certified, from which on another one is."""

LARGEST = 20_000
"""Vertices of a mesh, beyond which no finer one is made."""


@dataclass(frozen=True)
class Adaptive(Wrapper):
    """Refines where the errors of quantities are made, until all are below the accuracy.

    ``inner`` then relocates the nodes of the last mesh; by default it moves none.

    Attributes
    ----------
    accuracy : float or str
        Largest estimated error of a quantity, relative to its value, such as 0.01 or "1%"; of "energy" the
        error in the energy norm relative to the norm.
    quantities : tuple of str
        See :func:`rmesh_nlp.certificate.estimates.check`; by default the normal force of each contact
        boundary, without contact the energy.
    guaranteed : bool
        Whether half the width of guaranteed bounds decides, in the place of the estimated error.
    own_order : bool
        Whether displacements are of the problem's own order; else they are of order 2.
    """

    inner: Any = field(default_factory=Fixed)
    accuracy: Part = 0.01
    quantities: tuple[str, ...] = ()
    guaranteed: bool = False
    own_order: bool = False

    def __post_init__(self) -> None:
        text = str(self.accuracy)
        try:
            share = float(text.rstrip("%")) / (100 if "%" in text else 1)
        except ValueError:
            said = f"accuracy must be a number such as 0.01 or 1%, got {self.accuracy!r}"
            raise BadInputError(said, "accuracy") from None
        object.__setattr__(self, "accuracy", share)
        object.__setattr__(self, "quantities", as_tuple(self.quantities))
        super().__post_init__()

    @property
    def name(self) -> str:
        """That of the entry point."""
        return "adaptive"

    @property
    def relocates(self) -> bool:  # type: ignore[override]
        """Whether ``inner`` does."""
        return bool(self.inner.relocates)

    def asked(self, problem: ContactProblem) -> tuple[str, ...]:
        """The quantities that the accuracy is for."""
        return self.quantities or of_contact(problem, "resultant") or (ENERGY,)

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        super().accepts(problem, objective)
        for text in self.asked(problem):
            check(text, problem)

    def choose(self, problem: ContactProblem, objective: Objective, *, is_started: bool = False) -> Choice:
        choice = super().choose(problem, objective, is_started=is_started)
        problem = choice.problem.at_design()  # the first one
        return replace(choice, problem=problem if self.own_order else replace(problem, order=2))

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        wanted, meshes, sequence = self.asked(outer.problem), list[Any](), list[list[Estimate]]()
        told = of_contact(outer.problem, "resultant", "peak", "contact_length")
        every = tuple(dict.fromkeys(wanted + (ENERGY,) * self.guaranteed + told))
        certified, proved = 0, dict[str, Bounds]()
        reached = Outcome(outer, np.zeros(outer.n), Status.STALLED)

        def refine() -> None:
            nonlocal reached, certified, proved
            outer = reached.outer
            while reached.status is Status.STALLED:
                on, number, nodes = OnMesh.of(outer.contact), len(meshes), outer.problem.mesh.p.shape[1]
                monitor.work += Work(1, 1, (state := on.state).iterations)
                if state.status is not Status.CONVERGED:
                    raise NotCertifiableError(f"on {nodes} nodes: {state.status.message}")
                sequence.append(estimates(on, every))
                seconds = monitor.budget.elapsed
                ends = dict(zip(every, map(ended, zip(*sequence, strict=True)), strict=True))
                solved = Outcome(outer, np.zeros(outer.n), Status.STALLED, label="")
                if self.guaranteed and nodes > GROWTH * certified:
                    certified = nodes
                    proved = dict(bounded(assess(outer, solved, relocates=False), wanted).bounds)
                bounds = {text: of._asdict() for text, of in proved.items()}
                figures = {text: {**bounds.get(text, {}), **end.record()} for text, end in ends.items()}
                meshes.append({"nodes": nodes, "seconds": seconds, "quantities": figures})
                reached = solved.having({"estimates": figures, "meshes": meshes})
                each = (f"{text} {estimate_in_words(figures[text])}" for text in wanted)
                said = ", ".join([f"{nodes} nodes", *each])
                monitor.note(Step(number, state.energy, 0.0, 0.0, np.nan, number + 1, seconds, said=said))
                lacking = [
                    self._lacking(text, ends[text], proved.get(text), 1.0 if number else FIRST)
                    for text in wanted
                ]
                local, excess = sum(lacking, np.zeros(1)), max(map(np.sum, lacking))
                if proved and excess:
                    local = ends[ENERGY].local  # bounds narrow with the gap
                    if number and nodes == certified > LARGEST / excess:
                        raise NotCertifiableError(
                            f"guaranteed bounds are {excess:.3g} times too wide on {certified} nodes (1e+09: "
                            f"not guaranteed), and narrow about like 1 / nodes: {LARGEST} would not suffice"
                        )
                if not excess:
                    if grow := [text for text in wanted if not ends[text].converges]:
                        raise NotCertifiableError(f"{grow[0]} has no limit on finer meshes")
                    reached = replace(reached, status=Status.CONVERGED)
                monitor.budget.check()
                if excess:
                    with monitor.budget.during("build"):
                        order = np.argsort(-local, kind="stable")
                        share = np.cumsum(local[order])
                        most = order[: 1 + np.searchsorted(share, BULK * share[-1])]
                        finer = locally_refined(outer.problem, most)
                        if finer.mesh.p.shape[1] > LARGEST:
                            raise NotCertifiableError(f"a finer mesh has more than {LARGEST} nodes")
                        outer = Outer.of(finer, outer.objective, outer.tolerance)

        try:
            monitor.attempt(refine)
        except (NotCertifiableError, ProblemError) as error:
            reached = reached.having({"estimates_remark": one_line(error)})
        if self.relocates and reached.status is Status.CONVERGED:
            return monitor.run(self.inner, reached.outer, reached.q).having({"meshes": meshes})
        lacks = f"The accuracy {self.accuracy:g} was not reached." * (reached.status is Status.STALLED)
        return replace(reached, status=monitor.budget.stopped or reached.status, lacks=lacks)

    def _lacking(self, text: str, end: Estimate, bounds: Bounds | None, part: float) -> Array:
        """(elements,) indicators of a quantity whose error is above a part of the accuracy; else zero.

        Their sum is the error over that part.
        """
        # the square of the energy norm is twice an energy
        limit, error = abs(end.value) * self.accuracy ** (2 if text == ENERGY else 1), end.error / part
        if bounds is not None:
            width = (bounds.upper - bounds.lower) / (1 if text == ENERGY else 2)
            error = width if bounds.guaranteed else np.inf
        if error <= limit or not end.converges:
            return np.zeros(end.local.size)
        share = end.local / max(np.sum(end.local), 1e-300)
        return share * np.clip(np.nan_to_num(error / max(limit, 1e-300)), 1.0, 1e9)
