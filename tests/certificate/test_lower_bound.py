"""The lower bound as a function of the nodes: a bound, and its gradient is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.certificate.bracket import bracket
from rmesh_nlp.certificate.lower_bound import LowerBound
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Obstacle, Place, PlaneStrain, Traction
from support.certificates import distorted, guess_on
from support.problems import renumbered


def plate(**changes) -> ContactProblem:
    """A source, a given displacement, a traction and a gap that all vary."""
    mesh = rectangle(3, 3).with_subdomains({"left half": lambda x: x[0] < 0.5, "rest": lambda x: x[0] > 0.5})
    settings = {
        "mesh": distorted(mesh, 0.2, 1),
        "law": {
            "left half": Laplace(lambda x, y: -5 * ca.exp(x * y)),
            "rest": Laplace(lambda x, y: -8 * ca.sin(4 * y), 3.0),
        },
        "dirichlet": (Dirichlet("left", (lambda x, y: 0.1 * y,)),),
        "obstacle": Obstacle("right", (1.0,), lambda x, y: 0.05 + 0.1 * y),
        "tractions": (Traction("top", (lambda x, y: 0.3 * x,)),),
    }
    return ContactProblem(**{**settings, **changes})


PROBLEMS: dict[str, Callable[[], ContactProblem]] = {
    "signorini": lambda: EXAMPLES["6.1"](4),
    "everything varies": plate,
    "above": lambda: plate(
        law=Laplace(lambda x, y: 6 * ca.exp(x * y), 2.0),
        obstacle=Obstacle("right", (-1.0,), lambda x, y: 0.02 + 0.1 * y),
    ),
    "membrane": lambda: random_problem(1, kind="membrane"),
    "membrane, everything varies": lambda: plate(
        law=Laplace(lambda x, y: -9 * ca.exp(x)),
        obstacle=Obstacle(Place.INTERIOR, (1.0,), lambda x, y: 0.3 + 0.2 * x),
    ),
    "constant source": lambda: plate(law=Laplace(-6.0)),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_taylor_remainder_is_of_second_order(name):
    """In a direction that moves the boundary too, so that everything on it counts."""
    problem = PROBLEMS[name]()
    bound, nodes = LowerBound(problem), np.asarray(problem.mesh.p)
    u = guess_on(problem).displacement
    value, gradient = bound(nodes, u)
    direction = np.random.default_rng(2).uniform(-1, 1, nodes.shape)
    steps = 1e-3 * 0.5 ** np.arange(3)
    remainders = [
        abs(bound(nodes + h * direction, u)[0] - value - h * np.sum(gradient * direction)) for h in steps
    ]
    assert np.log2(remainders[-2] / remainders[-1]) > 1.9
    assert remainders[-1] < 1e-2 * abs(steps[-1] * np.sum(gradient * direction))


def test_another_numbering_of_the_displacement_has_the_same_bound(monkeypatch) -> None:
    """The base has no influence on the value, so what it is has to be looked at."""
    problem, bases = PROBLEMS["signorini"](), []
    parts = renumbered(problem)
    nodes, u = problem.mesh.p, guess_on(problem).displacement
    solve = LowerBound._equilibrated
    monkeypatch.setattr(LowerBound, "_equilibrated", lambda *given: bases.append(given[2]) or solve(*given))
    value, _ = LowerBound(problem)(nodes, u)
    assert LowerBound(problem, parts.space)(nodes, parts.space.of_linear(u))[0] == pytest.approx(value)
    np.testing.assert_array_equal(bases[-1], u)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_it_is_a_bound_and_close_to_that_of_the_certificate(name):
    problem = PROBLEMS[name]()
    guess = guess_on(problem)
    value, _ = LowerBound(problem)(np.asarray(problem.mesh.p), guess.displacement)
    found = bracket(problem, problem.mesh.p, guess)
    fine = replace(problem, mesh=problem.mesh.refined(2))
    assert found.guaranteed_lower
    assert value <= bracket(fine, fine.mesh.p, guess_on(fine)).upper
    assert value >= found.lower - 0.02 * (found.upper - found.lower)


def test_what_it_cannot_do_is_refused():
    with pytest.raises(ValueError, match="displacements of order 1: take order = 1"):
        LowerBound(replace(plate(), order=2))
    with pytest.raises(ValueError, match="scalar"):
        LowerBound(ContactProblem(rectangle(2, 2), PlaneStrain(1.0, 1.0, (0.0, -1.0)), ("left",)))
    with pytest.raises(ValueError, match="linear along"):
        LowerBound(plate(tractions=(Traction("top", (lambda x, y: ca.sin(5 * x),)),)))
