from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.programs.cascade import cascade
from rmesh_nlp.programs.curvature import Curvature
from rmesh_nlp.programs.stationary import finished
from rmesh_nlp.solving.outer import Outer


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size"), [("6.1", 5), ("6.2", (6, 3)), ("6.3", (6, 3))])
def test_the_way_from_a_cascade_to_a_stationary_point(name: str, size: int | tuple[int, int]) -> None:
    problem = EXAMPLES[name](n=size)
    problem = replace(problem, motion=replace(problem.motion, delta=None), quadrature=6)
    start = cascade(problem)
    outer = Outer(problem, start.energy.relocation.objective)
    residual = outer.residual
    before = start.energy(start.q).value
    end = finished(
        start.energy,
        start.q,
        residual,
        tolerance=1e-6,
        reference=before + start.gain_estimate,
        max_iterations=80,
    )
    assert end.result.status is Status.CONVERGED
    assert end.residual == residual(start.energy(end.result.x)) <= 1e-6
    assert end.result.value <= before
    # a minimum, not only a stationary point: no direction has negative curvature
    hessian = Curvature(start.energy).at(start.energy(end.result.x))
    matrix = np.column_stack([hessian(e) for e in np.eye(end.result.x.size)])
    eigenvalues = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    assert eigenvalues.min() > -1e-6 * eigenvalues.max()
