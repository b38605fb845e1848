"""What can be attained before anything moves: relocation, a new mesh, refinement, displacements of order 2.

Two contact solves, on the given mesh and on its uniform refinement, give the error of the energy, and
derivatives from which the least error of a mesh of as many triangles follows
(:mod:`rmesh_nlp.fem.interpolation_error`). That error is extrapolated to the limit of fine meshes from both.
What moving the nodes gains is measured on a coarse mesh: the best positions are a map of the domain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from rmesh_nlp.assessment.error_reduction import SLOWEST
from rmesh_nlp.display import figure
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import difference
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.meshes.mmg import MISSING, is_available
from rmesh_nlp.models.attainable import LeastErrors
from rmesh_nlp.models.levels import coarsened
from rmesh_nlp.models.remeshing import Solved
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.problem.switches import polynomial_degree
from rmesh_nlp.solving.driver import solve

NODES = 300
"""Largest number of nodes of the mesh on which nodes are moved."""

WORTHWHILE = 1.25
"""Factor of the error below which no mesh of as many nodes is recommended."""

SHARE, ROUGH, BEST = 1.1, 1.2, 0.6
"""A metric start and relocation end at ``SHARE (1 + ROUGH / sqrt(N)) e^(1 - BEST) b^BEST``, where of N
triangles b is the least error and e that of those equilateral in the best metric. Remeshing leaves e, and
relocation comes near b where a solution varies in one direction. Fitted to six problems of
``scripts/benchmark_mesh.py`` and the random ones with seeds 90000 to 90019; within 20 % on 18 of 20 others.
"""

AGREE = (0.9, 2.5)
"""Range of the least error by the refined mesh over that by the given one. On random problems of 12 to 30
nodes (seeds 90000 to 90015) all factors that were 3 to 15 times too large are outside. Of 40 others (91000 to
91039) it leaves 21: 17 are right within a factor of two, two are 4 and 7 times too large."""

UNKNOWN = "not known: this mesh is too coarse for a prediction"

SOLVES = {"relocate": 80, "remesh": 80, "refine": 5}
"""What each takes, about, in contact solves of the given mesh."""


@dataclass(frozen=True)
class Advice:
    """What ``rmesh advise`` finds; factors are errors of the given mesh over those of another one.

    Those by derivatives of the solution are None where the given mesh and its refinement do not agree about
    them; refining is recommended then. They are not to be relied on where ``is_rough``.

    Attributes
    ----------
    error : float
        Of the energy of the given mesh, estimated.
    rate : float
        It falls like (number of nodes)^-rate with uniform refinement.
    attainable_factor : float
        By the best mesh of as many triangles.
    attainable_same_connectivity : float
        By moving the nodes alone, at least: what the assessment claims for a mesh of at most ``NODES`` nodes;
        None where it claims nothing.
    attainable_by_refinement : float
        By local refinement to as many triangles, at best.
    remeshing_factor : float
        By a metric start and relocation on it, predicted.
    recommended : str
        "remesh", "relocate" or "refine", see :func:`recommended`.
    predicted_factor : float
        With as many nodes by what is recommended; by a uniform refinement where that is refining.
    second_order_factor, second_order_remeshing_factor : float or None
        Of a problem of order 1: by displacements of order 2 on the given mesh, and on a new mesh of as many
        triangles that is relocated too.
    is_rough : bool
        Whether the error falls from the given mesh to its refinement at less than half the rate by their
        derivatives that it has by their energies. What is predicted for a new mesh is then the upper end, and
        ``attainable_same_connectivity`` the lower one. On random problems of 20 nodes (seeds 91000 to 91039)
        the prediction that was 7 times too large is one of them.
    """

    error: float
    rate: float
    attainable_factor: float | None
    attainable_same_connectivity: float | None
    attainable_by_refinement: float | None
    remeshing_factor: float | None
    recommended: str
    predicted_factor: float
    second_order_factor: float | None = None
    second_order_remeshing_factor: float | None = None
    is_rough: bool = False
    command: str = "rmesh solve"

    def record(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)

    def rows(self) -> list[tuple[str, str]]:
        """As (label, value) for people."""
        least = (self.attainable_same_connectivity or 1.0) if self.is_rough else np.inf
        rows = [
            ("error of the energy", figure(self.error)),
            ("best mesh of as many triangles", _less(self.attainable_factor, " error", least=least)),
            (f"{self.command} --remesh", _less(self.remeshing_factor, _cost("remesh"), least=least)),
            (f"{self.command}: nodes move", _less(self.attainable_same_connectivity, _cost("relocate"))),
            ("refined locally, as many triangles", _less(self.attainable_by_refinement, ", at best")),
            ("refined uniformly, four times as many", _less(4**self.rate, _cost("refine"))),
            ("recommended with as many nodes", self.sentence),
        ]
        if self.second_order_factor is not None:
            rows.append(("order 2 on this mesh", _less(self.second_order_factor)))
            remeshed = _less(self.second_order_remeshing_factor, about="roughly ")
            rows.append((f"{self.command} --order 2 --remesh", remeshed))
        return rows

    @property
    def sentence(self) -> str:
        """The recommendation in words."""
        if self.attainable_factor is None:
            return "refine, then ask again"
        if self.recommended == "refine":
            return "refine: this mesh suits the solution already"
        if self.recommended == "relocate":
            return f"relocate: {self.command}"
        return f"remesh and relocate: {self.command} --remesh" + ("" if is_available() else f" ({MISSING})")


def _less(factor: float | None, more: str = "", *, about: str = "", least: float = np.inf) -> str:
    if factor is None:
        return UNKNOWN
    return f"{about}{f'{least:.2g} to ' if least < factor else ''}{factor:.2g} times less{more}"


def _cost(what: str) -> str:
    return f", for about {SOLVES[what]} contact solves"


def advise(problem: ContactProblem) -> Advice:
    """Say what relocation, a new mesh, refinement and order 2 can attain, and recommend one.

    Move limits are not regarded, nor by the ``command`` that is recommended; over curved foundations gaps
    hold along edges, as in ``auto``.
    """
    if problem.steps:
        raise BadInputError("advice is about one load: leave out the load steps")
    if not problem.has_energy:
        raise BadInputError(
            "advice is about the error of the energy: with Coulomb friction none is minimised"
        )
    motion = replace(problem.motion, delta=None)
    given = replace(with_edge_gaps(problem), motion=motion, quadrature="auto")
    prospect, moved = _Prospect.of(given), _moved(given)
    chosen, predicted = "refine", {"refine": 4**prospect.rate, "relocate": moved or 1.0}
    if prospect.remeshed is not None:
        chosen = recommended(prospect.remeshed, moved or 1.0)
        predicted["remesh"] = prospect.remeshed
    factor = remeshed = None
    if problem.order == 1:
        second = _Prospect.of(replace(given, order=2))
        factor = prospect.error / second.error if second.error > 0 else 1.0
        remeshed = None if second.remeshed is None or second.is_rough else factor * second.remeshed
    return Advice(
        prospect.error,
        prospect.rate,
        attainable_factor=prospect.best,
        attainable_same_connectivity=moved,
        attainable_by_refinement=prospect.refinement,
        remeshing_factor=prospect.remeshed,
        recommended=chosen,
        predicted_factor=predicted[chosen],
        second_order_factor=factor,
        second_order_remeshing_factor=remeshed,
        is_rough=prospect.is_rough,
        command="rmesh solve" + ("" if problem.motion.delta is None else " --delta none"),
    )


def _moved(problem: ContactProblem) -> float | None:
    """Least factor by which moving the nodes of a coarse mesh lowers the error there."""
    while problem.n_vertices > NODES and (coarse := coarsened(problem, 0)) is not None:
        problem = coarse
    solution = solve(problem)
    if solution.is_interrupted:
        raise KeyboardInterrupt
    reduction = solution.error_reduction
    return None if reduction is None else reduction.factor


@dataclass(frozen=True)
class _Prospect:
    """Error of the energy of a mesh, and factors by which other meshes lower it.

    ``rate``: the error falls like (number of nodes)^-rate; ``best`` is the factor of any mesh of as many
    triangles, ``remeshed`` that of a metric start and relocation, ``refinement`` that of local refinement.
    All three are None where the two meshes do not agree about the first of these. ``is_rough``: by
    derivatives the error falls at less than half of the rate.
    """

    error: float
    rate: float
    is_rough: bool
    best: float | None = None
    remeshed: float | None = None
    refinement: float | None = None

    @staticmethod
    def of(given: ContactProblem) -> _Prospect:
        """By contact solves on a mesh and on its uniform refinement."""
        coarse, finer = Solved.of(given), Solved.of(refined(given))
        fall, order = max(difference(coarse.state.energy, finer.state.energy), 0.0), given.order
        if order == 2:  # nearly always limited by singularities, whose rate the estimates show
            smooth = 4.0**order
            times = np.clip(coarse.error / finer.error, SLOWEST, smooth) if finer.error > 0 else smooth
            error = fall * float(times / (times - 1))
        elif _has_curved_data(given):  # the energies of two meshes do not compare
            error, fall = 4 * finer.error, 3 * finer.error
        else:
            error = fall + max(finer.error, fall / 3)
        rate = float(order)
        if error > fall:
            rate = float(np.clip(np.log(error / (error - fall)) / np.log(4), 0.0, order))
        is_rough = coarse.error < 2**rate * finer.error
        return _Prospect(error, rate, is_rough, *_factors(coarse, finer, error))


def _has_curved_data(problem: ContactProblem) -> bool:
    """Whether given displacements are not linear along a boundary: meshes represent them differently."""
    values = (part for support in problem.supports for part in support.value if part is not None)
    degrees = [polynomial_degree(value) for value in values]
    return any(degree is None or degree > 1 for degree in degrees)


def _factors(here: Solved, finer: Solved, error: float) -> Sequence[float]:
    """By the best mesh, by a metric start and relocation, by local refinement; 1 at least.

    Empty where the two meshes do not agree about the best mesh.
    """
    triangles = here.problem.mesh.nelements
    coarse, fine = (LeastErrors.of(first.problem.mesh.p, first.regions, triangles) for first in (here, finer))
    if not AGREE[0] * coarse.any_mesh <= fine.any_mesh <= AGREE[1] * coarse.any_mesh:
        return ()
    order, pairs = here.problem.order, zip(vars(coarse).values(), vars(fine).values(), strict=True)
    any_mesh, equilateral, isotropic = (_limit(a, b, order) for a, b in pairs)
    made = SHARE * (1 + ROUGH / np.sqrt(triangles)) * equilateral ** (1 - BEST) * any_mesh**BEST
    least = any_mesh, max(made, any_mesh), isotropic
    return [max(1.0, error / value) if value > 0 else 1.0 for value in least]


def _limit(coarse: float, fine: float, order: int) -> float:
    """The value on ever finer meshes from those on two.

    At order 2 singularities are in every problem, whose third derivatives coarse meshes hardly show: the
    logarithm grows with each refinement by two thirds of what it grew by before, about (Example 6.3, wedge,
    L-shape).
    """
    if order == 1:
        return fine + max(fine - coarse, 0.0) / 3
    return fine * max(fine / coarse, 1.0) ** 2 if coarse > 0 else fine


def recommended(remeshing: float, relocation: float) -> str:
    """What lowers the error most with as many nodes, from the factors of both.

    On 37 meshes of ``scripts/benchmark_mesh.py`` relocation alone was better than a new mesh once, by 1 %.
    """
    if remeshing >= WORTHWHILE:
        return "remesh"
    return "relocate" if relocation >= WORTHWHILE else "refine"
