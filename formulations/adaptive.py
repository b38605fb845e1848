"""h-adaptive refinement until the estimated errors of quantities are below an accuracy.

Each mesh is solved, the errors are estimated (:mod:`rmesh_nlp.certificate.estimates`), and the triangles that
add most to those above the accuracy are bisected: as many as have ``BULK`` of the sum [1]_. Around one node,
such as the end of a crack, where the error goes like the edges, they are halved as often as it takes at once.
Where contact ends they are bisected once more, and alone before the end where the place of that end is more
than a third of the error: what it is worth in a force falls like the square of the edges, and is known
roughly.

References
----------
.. [1] W. Doerfler, A convergent adaptive algorithm for Poisson's equation, SIAM J. Numer. Anal. 33 (1996)
   1106-1124.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from formulations.fixed import Fixed
from rmesh_nlp.assessment.contact_results import unlimited_peaks
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.estimates import (
    ENERGY,
    Estimate,
    OnMesh,
    check,
    ended,
    estimates,
    of_contact,
    unknown,
)
from rmesh_nlp.errors import BadInputError, ProblemError, one_line
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.coefficients import as_tuple
from rmesh_nlp.problem.contact_problem import bisected, on_mesh
from rmesh_nlp.settings import Part
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.certify import bounded
from rmesh_nlp.solving.formulation import Choice, Wrapper
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Step, Work
from rmesh_nlp.solving.summary import estimate_in_words

BULK = 0.6
"""Share of the indicators in the triangles that are refined."""

FEW = 0.02
"""Part of the triangles below which those that are refined, if about one node, are at a corner or a crack's
end."""

FIRST = 0.05
"""Part of the accuracy that the estimate on the first mesh must meet, which no other mesh confirms. On random
problems errors of 1.3 times the accuracy were estimated as 0.2 of it, and 0.5 as 0.07: contact went on beyond
the edges on which nodes showed it."""

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
        See :func:`rmesh_nlp.certificate.estimates.check`; by default the displacement of each tool that a
        force moves and the normal force of each other contact boundary, without contact the energy.
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

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        super().accepts(problem, objective)
        for text in self.quantities or unknown(problem):
            check(text, problem)

    def choose(self, problem: ContactProblem, objective: Objective, *, is_started: bool = False) -> Choice:
        choice = super().choose(problem, objective, is_started=is_started)
        problem = choice.problem.at_design()  # the first one
        return replace(choice, problem=problem if self.own_order else replace(problem, order=2))

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        wanted, meshes = self.quantities or unknown(outer.problem), list[Any]()
        sequence = list[list[Estimate]]()
        every = wanted + (ENERGY,) * self.guaranteed
        every = tuple(dict.fromkeys(every + of_contact(outer.problem, "resultant", "peak", "contact_length")))
        # the square of the energy norm is twice an energy; of its bounds all of the width counts
        energy = self.accuracy**2 / (1 + self.guaranteed)
        parts = np.array([energy if text == ENERGY else self.accuracy for text in wanted])
        reached = Outcome(outer, np.zeros(outer.n), Status.STALLED)

        def refine() -> None:
            nonlocal reached
            outer, budget, only_ends = reached.outer, monitor.budget, False
            while True:
                before = budget.elapsed
                on, number, nodes = OnMesh.of(outer.contact), len(meshes), outer.problem.n_vertices
                budget.iterations = number
                monitor.work += Work(1, 1, on.state.iterations)
                sequence.append(estimates(on, every))
                ends = dict(zip(every, map(ended, zip(*sequence, strict=True)), strict=True))
                peaks = {f"peak({name})" for name in unlimited_peaks(on.space, on.nodes, on.state)}
                figures = {text: end.record(text not in peaks) for text, end in ends.items()}
                reached = Outcome(
                    outer,
                    np.zeros(outer.n),
                    Status.STALLED,
                    label="",
                    details={"estimates": figures, "meshes": meshes},
                )
                likely = [ends[text] for text in wanted]
                allowed = np.maximum(parts * np.abs([end.value for end in likely]), 1e-300)
                errors = np.array([end.error * end.converges / (1.0 if number else FIRST) for end in likely])
                if self.guaranteed:
                    errors = np.array([end.half for end in likely])
                    if not 1 < np.max(errors / allowed) < LARGEST / nodes or budget.is_over():
                        proved = bounded(assess(outer, reached, relocates=False), wanted, 0).bounds
                        for i, text in enumerate(wanted):
                            if text in proved:  # else it is given beforehand
                                low, _, high, is_sure, _ = proved[text]
                                errors[i] = (high - low) / 2 if is_sure else np.inf
                                figures[text] = {**proved[text]._asdict(), **figures[text]}
                excess = errors / allowed
                worst, seconds = np.max(excess), budget.elapsed
                meshes.append({"nodes": nodes, "seconds": seconds, "quantities": figures})
                budget.kept = seconds - before  # its audit takes about as long
                said = ", ".join(
                    [f"{nodes} nodes", *(f"{text} {estimate_in_words(figures[text])}" for text in wanted)]
                )
                monitor.note(Step(number, on.state.energy, 0.0, 0.0, np.nan, number + 1, seconds, said=said))
                places = on.ends(any(one.touching for one in likely))  # peaks are anywhere in contact
                is_doubted = places.size > 0 and any(one.doubt > one.error / 3 for one in likely)
                only_ends = worst <= 1 and is_doubted and not (self.guaranteed or only_ends)
                grow = [text for text in wanted if not figures[text]["converges"]]
                if worst <= 1 and not grow:
                    reached = replace(reached, status=Status.CONVERGED)
                if worst <= 1 and not only_ends:
                    if grow:
                        raise NotCertifiableError(f"{grow[0]} may have no limit on finer meshes")
                    return
                budget.check()
                with budget.during("build"):
                    local = [ends[ENERGY if self.guaranteed else text].local for text in wanted]
                    weights = np.where(excess <= 1, 0.0, np.fmax(np.minimum(excess, 1e9), 1.0))
                    adds = weights / np.maximum(np.sum(local, axis=1), 1e-300) @ local
                    order = np.argsort(-adds, kind="stable")
                    share = np.cumsum(adds[order])
                    most = order[: 1 + np.searchsorted(share, BULK * share[-1])]
                    problem = outer.problem
                    finer = problem.mesh if only_ends else bisected(problem, problem.mesh, most)
                    halved = [cKDTree(finer.p.T).query(places.T)[1]] * (not self.guaranteed)
                    around = np.bincount(problem.mesh.t.ravel(), np.tile(adds, 3))
                    if most.size < FEW * adds.size and np.max(around) > BULK * share[-1]:
                        halved += [np.argmax(around)] * int(np.log2(np.clip(np.nan_to_num(worst), 1, 64)))
                    for near in halved:
                        finer = bisected(problem, finer, np.nonzero(np.isin(finer.t, near))[1])
                    is_known = number > 1 and nodes > LARGEST / 100  # that it narrows about like 1 / nodes
                    narrowing = nodes * worst if self.guaranteed and is_known else 0
                    if max(narrowing, finer.p.shape[1]) > LARGEST:
                        raise NotCertifiableError(
                            f"on {nodes} nodes the error, or half the width of bounds, is {worst:.3g} times "
                            f"too large (inf: not guaranteed), and {LARGEST} nodes would not suffice"
                        )
                    outer = replace(outer, contact=on.solver(on_mesh(problem, finer, problem.motion)))

        why = ""
        try:
            monitor.attempt(refine)
        except (NotCertifiableError, ProblemError) as error:
            reached = reached.having({"estimates_remark": (said := one_line(error))})
            why = f": {said}{'; errors are estimated without --guaranteed' * self.guaranteed}"
        if reached.status is Status.CONVERGED:  # a limit may have ended one mesh more
            if not self.relocates:
                return reached
            return monitor.run(self.inner, reached.outer, reached.q).having({"meshes": meshes})
        lacks = f"The accuracy {self.accuracy:g} was not reached{why}."
        return replace(reached, status=monitor.budget.stopped or reached.status, lacks=lacks)
