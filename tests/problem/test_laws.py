"""Material laws against numbers worked out by hand."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.problem import Elastic, Laplace, PlaneStrain, PlaneStress
from rmesh_nlp.problem.laws import energy_density


@pytest.mark.parametrize(
    ("law", "in_plane", "out_of_plane"),
    [(PlaneStrain(12.0, 8.0), 12.0, 24.0), (PlaneStress(12.0, 8.0), 192 / 28, 0.0)],
)
def test_stress_and_energy_of_an_elastic_law(law: Elastic, in_plane: float, out_of_plane: float) -> None:
    assert law.in_plane_lambda == pytest.approx(in_plane, rel=1e-15)
    assert law.out_of_plane_stress(2.0) == out_of_plane
    # strain ((1, 2.5), (2.5, 4)): trace 5, sum of squares 29.5
    density = energy_density(law, ca.DM([[1, 2], [3, 4]]))
    assert float(density) == pytest.approx(0.5 * in_plane * 25 + 8 * 29.5, rel=1e-15)
    assert law.components == 2


def test_energy_of_laplace_has_its_conductivity() -> None:
    assert float(energy_density(Laplace(conductivity=3.0), ca.DM([[1, 2]]))) == 7.5
    assert Laplace(5.0).load == (5.0,)
    assert (Laplace().source, Laplace().conductivity, Laplace().components) == (0.0, 1.0, 1)


@pytest.mark.parametrize("kind", [PlaneStrain, PlaneStress])
def test_moduli_of_engineers_become_lame_coefficients(kind: type[Elastic]) -> None:
    law = kind.from_young(2600.0, 0.3, (1.0, -2.0))
    assert (law.lame_lambda, law.lame_mu) == pytest.approx((1500.0, 1000.0), rel=1e-14)
    assert type(law) is kind
    assert law.load == (1.0, -2.0)
    assert kind(1.0, 1.0).load == (0.0, 0.0)
    assert kind.from_young(1e-9, 0.4999).lame_mu > 0
    assert kind.from_young(1.0, -0.9999).in_plane_lambda < 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Laplace(1.0, 0.0), "conductivity must be positive, got 0.0"),
        (lambda: PlaneStrain(1.0, 0.0), "lame_mu must be positive, got 0.0"),
        (lambda: PlaneStrain(np.nan, 1.0), "lambda=nan"),
        (lambda: PlaneStrain(-8.0, 8.0), "lambda=-8.0, mu=8.0 are not those of an elastic solid"),
        (lambda: PlaneStress(-0.67, 1.0), "lambda=-0.67"),
        (lambda: PlaneStrain(1.0, 1.0, (1.0,)), "needs 2 components"),
        (lambda: PlaneStrain.from_young(0.0, 0.3), "young must be positive, got 0.0"),
        (lambda: PlaneStrain.from_young(1.0, 0.5), "poisson must lie between -1 and 0.5, got 0.5"),
        (lambda: PlaneStrain.from_young(1.0, -1.0), "between -1 and 0.5, got -1.0"),
    ],
)
def test_constants_of_no_material_are_refused(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_constants_at_the_edge_of_what_is_elastic_are_taken() -> None:
    # mu > 0 and lambda + mu > 0 in the plane; for plane stress that is lambda > -2/3 mu
    for law in (PlaneStrain(-7.99, 8.0), PlaneStress(-0.66, 1.0)):
        assert float(energy_density(law, ca.DM.eye(2))) > 0


def test_laws_in_words() -> None:
    assert PlaneStrain(2.5, 1.5).in_words(" N") == ("PlaneStrain, lambda 2.5, mu 1.5 N, body force (0, 0)")
    assert Laplace(2.0, 3.0).in_words("") == "Laplace, conductivity 3, source 2"
