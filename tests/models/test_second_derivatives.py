"""Second derivatives of the reduced model: differences of its gradients converge to them at rate 2."""

import numpy as np
import pytest

from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models import second_derivatives
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.models.second_derivatives import Curvature, ObjectiveCurvature
from support.curved import HOLE, plate
from support.orders import slow_but
from support.reduced import CONTACTS, FREE, QUADRATIC, reduced
from support.taylor import difference_order

PROBLEMS = {
    **CONTACTS,
    "along a curve": lambda: plate({"hole": HOLE}, delta=0.4, load=(lambda x, y: x * y, lambda x, y: x)),
    **QUADRATIC,
}


@pytest.mark.parametrize("name", slow_but(PROBLEMS))
def test_products_of_the_energy_are_derivatives_of_its_gradient(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    energy, rng = reduced(PROBLEMS[name]()), np.random.default_rng(1)
    q, d, other = rng.uniform(-1, 1, (3, energy.relocation.n_q)) * [[0.3], [1], [1]]
    hessian = Curvature(energy).at(energy(q))
    product = hessian(d)
    assert difference_order(lambda x: energy(x).gradient, product, q, d, 2e-3) > 1.9
    assert other @ product == pytest.approx(d @ hessian(other), rel=1e-9)
    assert np.all(hessian.diagonal() > 0)
    # one by one, in columns, or all at once
    both = hessian(np.column_stack([d, other]))
    monkeypatch.setattr(second_derivatives, "DENSE", 0)
    alone = Curvature(energy).at(energy(q))
    size = np.max(np.abs(both))
    np.testing.assert_allclose(both, np.column_stack([alone(d), alone(other)]), atol=1e-10 * size)
    np.testing.assert_allclose(both[:, 0], product, atol=1e-10 * size)
    # the same as a Schur complement of a sparse matrix
    width = rng.uniform(0.5, 2, d.size)
    sparse, n = hessian.joint(width)
    matrix = sparse.toarray()
    schur = matrix[:n, :n] - matrix[:n, n:] @ np.linalg.solve(matrix[n:, n:], matrix[n:, :n])
    np.testing.assert_allclose(schur @ d, width * hessian(width * d), atol=1e-9 * np.max(np.abs(schur)))
    assert np.linalg.eigvalsh(matrix[n:, n:]).min() > 0


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_distortions_are_part_of_both_derivatives(distortion: str) -> None:
    plain, energy = (reduced(FREE["6.1"](), text) for text in ("energy", f"energy + 0.1*{distortion}"))
    q, d = 0.1 * np.random.default_rng(3).uniform(-1, 1, (2, energy.relocation.n_q))
    product = Curvature(energy).at(energy(q))(d)
    assert difference_order(lambda x: energy(x).gradient, product, q, d, 4e-2) > 1.9
    # the part of the distortion is no small one
    assert np.max(np.abs(product - Curvature(plain).at(plain(q))(d))) > 1e-2 * np.max(np.abs(product))


@pytest.mark.parametrize(
    ("name", "objective"),
    [
        ("6.1", "error-l2"),
        ("6.3", "energy + 0.1*quality"),
        ("6.3", "energy"),
        ("6.1, order 2", "error-energy"),
        ("curved foundation, stick and slip, order 2", "energy"),
    ],
)
def test_products_of_objectives_are_derivatives_of_the_gradient(name: str, objective: str) -> None:
    energy, wanted, rng = reduced(PROBLEMS[name]()), parse_objective(objective), np.random.default_rng(1)
    function = ReducedObjective(energy, wanted)
    q, d = rng.uniform(-1, 1, (2, energy.relocation.n_q)) * [[0.3], [1]]
    hessian = ObjectiveCurvature(energy, wanted).at(function(q))
    np.testing.assert_allclose(hessian.gradient, function(q).gradient, atol=1e-12)
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d) > 1.9
    if objective == "energy":
        known = Curvature(energy).at(energy(q))(d)
        np.testing.assert_allclose(hessian(d), known, atol=1e-9 * np.max(np.abs(known)))
