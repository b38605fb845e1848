"""A law of one's own is one class."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.evaluation import Expression
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

    def energy_density(self, gradient: Expression) -> Expression:
        return 0.5 * (self.x * gradient[0] ** 2 + self.y * gradient[1] ** 2)

    def stress(self, gradient: Any) -> list[list[Any]]:
        return [[self.x * gradient[0][0], self.y * gradient[0][1]]]


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
