"""A law of one's own is one class."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.stress import gradients, stresses
from rmesh_nlp.problem import Law
from rmesh_nlp.problem.coefficients import Coefficient


@dataclass(frozen=True)
class TwoConductivities(Law):
    x: float
    y: float
    source: Coefficient
    components: ClassVar[int] = 1

    @property
    def load(self) -> tuple[Coefficient, ...]:
        return (self.source,)

    @property
    def least_modulus(self) -> float:
        return min(self.x, self.y)

    def in_words(self, stress: str) -> str:
        return f"conductivities {self.x} and {self.y}"

    def stress(self, gradient: Any) -> list[list[Any]]:
        return [[self.x * gradient[0][0], self.y * gradient[0][1]]]


@dataclass(frozen=True)
class RoundMode(TwoConductivities):
    """The mode ``u cos(theta)`` of a body of revolution: its measure is x, its energy depends on u / x."""

    measure = staticmethod(lambda x, y: x)  # type: ignore[assignment]

    def extended(self, gradient: Any, u: Any, x: Any) -> Any:
        around = u[0] / x[0]
        if isinstance(gradient, np.ndarray):
            return np.concatenate([gradient, around[None, None]], axis=1)
        return ca.horzcat(gradient, around)

    def stress(self, gradient: Any) -> list[list[Any]]:
        return [list(gradient[0])]


@pytest.mark.parametrize("order", [1, 2])
def test_measure_and_displacement_are_those_of_law(order: int) -> None:
    problem = rm.ContactProblem(
        mesh=rm.shapes.rectangle(3, 2, x=(1.0, 2.0)),
        law=RoundMode(1.0, 1.0, 0.0),
        dirichlet=(rm.Dirichlet("left", (1.0,)), rm.Dirichlet("right", (2.0,))),
        obstacle=rm.Obstacle("bottom", normal=(1.0,), offset=0.5),
        order=order,
    )
    record = rm.solve(problem, "fixed").record()  # the solution is u = x
    assert record["energy"] == pytest.approx(1.5, rel=1e-13)
    assert record["energy_audited"] == pytest.approx(1.5, rel=1e-13)
    # of the nodes between the ends of the bottom: 3/2, the integral of x, without the shape functions at ends
    weights = DisplacementSpace(problem).weights(problem.mesh.p)
    assert weights.sum() == pytest.approx(1.0 if order == 1 else 7 / 6, rel=1e-13)
    area = rm.solve(problem, "fixed", objective="area").record()["objective_value"]
    assert area == pytest.approx(1.5, rel=1e-13)
    loaded = replace(problem, law=RoundMode(1.0, 1.0, lambda x, y: 3 * y))
    assert rm.verify_gradient(loaded).order == pytest.approx(2, abs=0.1)


@pytest.mark.slow
def test_it_is_solved_measured_and_certified_as_the_one_it_equals() -> None:
    known = rm.EXAMPLES["6.1"](2)
    source = known.laws[0].load[0]
    own = replace(known, law=TwoConductivities(2.0, 2.0, source), exact=None)
    known = replace(known, law=rm.Laplace(source, 2.0), exact=None)
    first, second = (rm.solve(problem, "fixed", certify=True).record() for problem in (own, known))
    for name in ("energy", "energy_audited", "energy_lower_bound", "error_bound", "u_max"):
        assert first[name] == pytest.approx(second[name], rel=1e-9), name


@pytest.mark.slow
def test_its_bounds_enclose_the_energy_and_its_flux_has_both_conductivities() -> None:
    problem = rm.EXAMPLES["6.1"](4)
    problem = replace(problem, law=TwoConductivities(4.0, 1.0, problem.laws[0].load[0]), exact=None)
    record = rm.solve(problem, "joint", certify=True).record()
    assert record["energy_lower_bound"] <= record["energy_audited"] <= record["energy_upper_bound"] + 1e-9
    assert record["gain"] > 0
    u = np.random.default_rng(0).random((1, problem.mesh.p.shape[1]))
    slope = gradients(problem, problem.mesh.p, u)[0]
    np.testing.assert_allclose(stresses(problem, problem.mesh.p, u), slope * [[4.0], [1.0]])
    assert float(ca.DM(problem.laws[0].energy_density(ca.DM([[1, 2]])))) == 4.0
