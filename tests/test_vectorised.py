"""Element functions, and sums of their results, in numpy."""

import gc

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.evaluation import Evaluator
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import Sums
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.vectorised import CHUNK, NUMPY_FROM, Mapped, Vectorised, columnwise, is_vectorisable


def every_operation() -> ca.Function:
    """A Function with all operations that are known, and an argument that it ignores."""
    x, y, unused = ca.SX.sym("x", 2), ca.SX.sym("y"), ca.SX.sym("unused")
    a, b = x[0], x[1]
    results = [
        -a, a * a, 2 * a, 1 / a, ca.sqrt(a), ca.sin(a), ca.cos(b), ca.tan(y), ca.exp(y), ca.log(a),
        ca.fabs(y), ca.sign(y), ca.if_else(y < b, a, b), ca.if_else(y <= 0, a, 7), ca.if_else(y == a, 1, 2),
        ca.logic_not(y < 0), ca.if_else(a != b, y, 0), a + b, a - y, a * b, a / b, a**b, a**1.5,
        ca.fmin(a, b), ca.fmax(a, y), ca.SX(3.0),
    ]  # fmt: skip
    return ca.Function("every", [x, y, unused], [ca.vertcat(*results), ca.SX(0, 1), ca.diag(x)])


@pytest.mark.parametrize("n", [1, 3, CHUNK, CHUNK + 5])
def test_the_same_as_a_map(n: int) -> None:
    function = every_operation()
    assert is_vectorisable(function)
    rng = np.random.default_rng(n)
    arguments = [rng.uniform(0.1, 2, (2, n)), rng.uniform(-2, 2, (1, n)), rng.uniform(size=(1, n))]
    given = [a.copy() for a in arguments]
    results = Vectorised(function, n)(arguments), Mapped(function, n)(arguments)
    for ours, theirs in zip(*results, strict=True):
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-14)  # libm may differ in the last bits
    for before, after in zip(given, arguments, strict=True):
        np.testing.assert_array_equal(before, after)


def test_an_argument_may_be_left_out() -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    function = ca.Function("f", [x, y], [x * y, ca.cos(y)])
    for kernel in (Vectorised(function, 3), Mapped(function, 3)):
        product, cosine = kernel([np.ones((2, 3)), None])
        assert not product.any()
        np.testing.assert_array_equal(cosine, np.ones((1, 3)))
    x = ca.SX.sym("x")
    kernel = columnwise(ca.Function("f", [x], [ca.erf(x)]), NUMPY_FROM)
    assert isinstance(kernel, Mapped)
    assert kernel([np.zeros((1, NUMPY_FROM))])[0].shape == (1, NUMPY_FROM)


def test_an_interruption_comes_through_casadi(monkeypatch) -> None:
    nlp = relocation(EXAMPLES["6.1"](24)).nlp
    # CasADi does not own Python callbacks: a kernel that nobody keeps cannot be called
    gc.collect()
    gradient, x = Evaluator(nlp.derivatives.grad_f), np.zeros(nlp.n_x)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Sums, "__call__", interrupted)
        with pytest.raises(KeyboardInterrupt):
            gradient(x, [])
    assert np.any(gradient(x, [])[1])
