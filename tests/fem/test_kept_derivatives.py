"""Derivatives of element functions are made once for all meshes of a problem."""

from dataclasses import replace

import numpy as np

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.element import differentiated
from rmesh_nlp.fem.energy import strain_energy
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.problem import PlaneStrain


def test_equal_functions_share_their_derivatives_and_others_do_not() -> None:
    laws = PlaneStrain(1.0, 2.0), PlaneStrain(1.0, 2.0), PlaneStrain(1.0, 3.0)
    one, same, other = (differentiated(strain_energy(law), None, [0, 1]) for law in laws)
    assert one is same
    assert one is not other
    assert differentiated(strain_energy(laws[0]), None, [1]) is not one
    x = np.random.default_rng(0).uniform(0, 1, 12)
    values = [np.ravel(d.gradient(x[:6], x[6:])[1]) for d in (one, other)]
    assert np.max(np.abs(values[0] - values[1])) > 1e-3


def test_a_problem_that_differs_in_its_load_alone_has_its_own_derivatives() -> None:
    problem = EXAMPLES["6.1"](n=3)
    loads = [
        replace(problem, law=replace(problem.law, source=f)) for f in (lambda x, y: x, lambda x, y: x + y)
    ]
    gradients = []
    for stated in loads:
        program = relocation(stated)
        x = np.linspace(0, 1, program.nlp.n_x)
        gradients.append(np.ravel(program.assembled.grad_f(x, [])[1]))
    assert np.max(np.abs(gradients[0] - gradients[1])) > 1e-3
