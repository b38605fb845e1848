"""The problems of the benchmark, without boxes, and how the error of a mesh is measured on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import free_boundary
import hertz
import l_shape
import numpy as np
import plate_with_hole
import signorini
import wedge
from worth.reference import Reference, local_errors, reference

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.fields import constant_field
from rmesh_nlp.fem.objectives import error_energy
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.programs.levels import refined

RULE, JUDGE = 6, 10
REFERENCE_NODES = 12_000


@dataclass(frozen=True)
class Case:
    """A problem at several sizes.

    Attributes
    ----------
    name : str
    sizes : tuple of int
    problem : callable
        Of a size.
    error : callable
        Error of a mesh: of its energy, or half its square in the energy norm.
    local : callable
        (elements,) exact errors, for h-refinement with an oracle.
    measure : str
        What ``error`` is.
    """

    name: str
    sizes: tuple[int, ...]
    problem: Callable[[int], ContactProblem]
    error: Callable[[ContactProblem], float]
    local: Callable[[ContactProblem], np.ndarray]
    measure: str = "energy"


def _free(problem: ContactProblem, motion: Motion | None = None) -> ContactProblem:
    return replace(problem, motion=motion or Motion(None), quadrature=RULE)


def energy(problem: ContactProblem) -> float:
    """By the judge's rule."""
    return float(ContactModel(replace(problem, quadrature=JUDGE)).solve(problem.mesh.p).energy)


def exact_errors(problem: ContactProblem) -> np.ndarray:
    """(elements,) half the squared energy norm of the error against the exact solution."""
    judged = replace(problem, quadrature=JUDGE)
    model = ContactModel(judged)
    values = model.displacement.values(model.solve(problem.mesh.p).u)
    fields = (constant_field(problem.mesh.p), constant_field(values), constant_field(values))
    return element_values(error_energy(judged, *fields))(np.zeros(0))[0]


def _by_reference(
    name: str, sizes: tuple[int, ...], make: Callable[[int], ContactProblem], exact: float | None = None
) -> Case:
    @cache
    def fine() -> Reference:
        return reference(make(sizes[0]), REFERENCE_NODES)

    return Case(
        name,
        sizes,
        make,
        lambda problem: energy(problem) - (fine().limit if exact is None else exact),
        lambda problem: local_errors(problem, fine()),
    )


def _by_norm(name: str, sizes: tuple[int, ...], make: Callable[[int], ContactProblem]) -> Case:
    def norm(problem: ContactProblem) -> float:
        return float(exact_errors(problem).sum())

    return Case(name, sizes, make, norm, exact_errors, "energy norm")


def _times_refined(problem: ContactProblem, times: int) -> ContactProblem:
    for _ in range(times):
        problem = refined(problem)
    return problem


def _signorini_61(n: int) -> ContactProblem:
    return _free(EXAMPLES["6.1"](n=n))


def _error_61(problem: ContactProblem) -> float:
    assert problem.exact is not None
    return energy(problem) - problem.exact.energy


def _plate(times: int) -> ContactProblem:
    motion = Motion(None, curves={"hole": Circle((5.0, 5.0), 2.5)})
    return _times_refined(_free(plate_with_hole.problem(8), motion), times)


def _error_of_own_polygon(problem: ContactProblem) -> float:
    """The hole is a polygon with its nodes: another one has another least energy."""
    return energy(problem) - reference(problem, max(6_000, 8 * problem.mesh.p.shape[1])).limit


def _local_of_own_polygon(problem: ContactProblem) -> np.ndarray:
    return local_errors(problem, reference(problem, 4 * problem.mesh.p.shape[1]))


def _hertz(n: int) -> ContactProblem:
    return _free(hertz.problem(n), Motion(None, pinned=("arc", "top")))


def _hertz_norm(problem: ContactProblem) -> float:
    return float(_hertz_local(problem).sum())


def _hertz_local(problem: ContactProblem) -> np.ndarray:
    # the arc and its chord are those of the mesh as given
    return local_errors(problem, reference(problem, max(12_000, 12 * problem.mesh.p.shape[1])))


CASES = {
    case.name: case
    for case in (
        Case("6.1", (8, 16, 32, 64), _signorini_61, _error_61, exact_errors),
        _by_reference(
            "L-shape",
            (0, 1, 2),
            lambda times: _times_refined(_free(l_shape.problem(6)), times),
            l_shape.EXACT_ENERGY,
        ),
        _by_reference("6.3", (6, 12, 24), lambda n: _free(EXAMPLES["6.3"](n=(2 * n, n)))),
        _by_reference("wedge", (6, 12), lambda n: _free(wedge.problem(n))),
        _by_norm("free boundary", (8, 16, 32), lambda n: _free(free_boundary.problem(n))),
        Case("plate", (0, 1), _plate, _error_of_own_polygon, _local_of_own_polygon),
        Case("Hertz", (4, 8), _hertz, _hertz_norm, _hertz_local, "energy norm"),
        _by_norm("Signorini", (10, 20), lambda n: _free(signorini.problem(n))),
    )
}
