"""Objectives of contact forces: derivatives by two adjoints that share nothing, and by differences."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import ElementGroup, element_group
from rmesh_nlp.fem.functional import Functional
from rmesh_nlp.fem.objective import Fields, Objective, Term
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.models.second_derivatives import ObjectiveCurvature
from rmesh_nlp.problem import ContactProblem
from support.orders import ORDERS
from support.reduced import CONTACTS, OTHERS, reduced
from support.taylor import difference_order, taylor_order


def slab(coulomb: Any, n: tuple[int, int] = (6, 4)) -> ContactProblem:
    """Example 6.3 with Coulomb friction."""
    problem = EXAMPLES["6.3"](n)
    return replace(problem, obstacle=replace(problem.obstacle, friction=0.0, coulomb=coulomb))


COULOMB = {
    "Coulomb": lambda: slab(0.4),
    "Coulomb, varying": lambda: slab(lambda x, y: 0.8 + 0.1 * x + 0.05 * y),
}
PROBLEMS = (
    CONTACTS | COULOMB | {name: OTHERS[name] for name in ("two foundations", "two obstacles at a node")}
)


def of_forces(on: Fields) -> list[ElementGroup]:
    """A function of position, slip, normal force and both multipliers of friction at each contact node."""
    assert on.forces is not None
    x, s, normal, minus, plus = (ca.SX.sym(name, n) for name, n in zip("Xslmp", (2, 1, 1, 1, 1), strict=True))
    value = (1 + x[0] * x[1]) * normal * (1 + normal / 10 + plus / 7) + minus**2 * (1 + s) + plus * (3 + x[0])
    function = ca.Function("of_forces", [x, s, normal, minus, plus], [value, NO_ROWS])
    groups = []
    for part in on.space.contact_sets:
        which, vertices, _ = next(on.space.kinds(part.nodes))
        fields = (on.slip, *on.forces)
        local = (field.component(part.number).at(part.nodes[None, which]) for field in fields)
        groups.append(element_group(function, on.positions, (on.positions.at(vertices), *local)))
    return groups


def of_sums(on: Fields) -> Functional:
    """A function of three sums, one of which stands for itself."""
    first, second = Functional(of_forces(on)), Functional(of_forces(on)[:1])
    ratio = first.then(lambda a: a**2) + second.then(lambda b: ca.sqrt(1 + b**2))
    return Functional(of_forces(on)) + ratio.then(lambda c: 1e-3 * c * ca.log(1 + c**2)).scaled(0.1)


FORMS = {"sum": of_forces, "function of sums": of_sums}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_derivatives_of_a_function_of_forces(name: str, order: int, form: str) -> None:
    energy = reduced(replace(PROBLEMS[name](), order=order))
    wanted = Objective(((2.0, Term(form, FORMS[form])),))
    function, rng = ReducedObjective(energy, wanted), np.random.default_rng(6)
    q, d = rng.uniform(-1, 1, (2, energy.relocation.n_q)) * [[0.2], [1]]
    here = function(q)
    assert not np.any(here.weak)
    assert abs(taylor_order(function, q, d) - 2) < 0.02
    hessian = ObjectiveCurvature(energy, wanted).at(here)
    size = np.max(np.abs(here.gradient))
    np.testing.assert_allclose(hessian.gradient, here.gradient, atol=1e-9 * size)
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d, 2e-3) > 1.9
