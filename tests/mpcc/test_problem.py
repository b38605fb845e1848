"""MPCCs as users write them: what is refused, mixed pairs, rows of an NLP as pairs, extension."""

import itertools

import casadi as ca
import numpy as np
import pytest

from formulations import joint, mpcc
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mpcc import MPCC, Options, solve
from rmesh_nlp.mpcc.lifting import automatic_derivatives
from rmesh_nlp.optimize.nlp import Derivatives
from support.derivatives import assert_derivatives_are_casadis
from support.scripted_run import XY, x, y

stray = ca.SX.sym("stray")
INF = np.inf


def corner(**changes):
    return MPCC(**{"x": XY, "f": x + y, "g": x - y, "G": x, "H": y, "lbg": -1, "ubg": 1} | changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"lbx": [0.0]}, "lbx has length 1, expected 2"),
        ({"ubg": [1.0, 2.0]}, "ubg has length 2, expected 1"),
        ({"lbx": [np.nan, 0.0]}, r"lbx\[0\] .x. is nan, not a number"),
        ({"lbx": [0.0, 2.0], "ubx": [1.0, 1.0]}, r"lbx\[1\] .y. = 2.0 and ubx\[1\] = 1.0"),
        ({"lbg": INF, "ubg": INF}, r"lbg\[0\]"),
        ({"lbg": -INF, "ubg": -INF}, r"ubg\[0\]"),
        ({"lbx": "low"}, "lbx must be numeric"),
        ({"x": np.zeros(2)}, "x must be a column of CasADi SX or MX symbols"),
        ({"x": ca.vertcat(x, 2 * y)}, "x must be a column of CasADi SX or MX symbols"),
        ({"f": XY}, "f must be a scalar"),
        ({"f": x + stray}, "free symbols.*stray"),
        ({"H": XY}, "G has length 1 and H has length 2"),
        ({"p": 2 * stray}, "p must be a column of symbols"),
        ({"p": x}, "distinct symbols"),
        ({"f": ca.MX.sym("m")}, "f must be a column of SX"),
        ({"g": ca.SX.zeros(2, 2)}, r"g must be a column, its shape is \(2, 2\)"),
        # H is missing
        ({"derivatives": automatic_derivatives(XY, ca.SX(0, 1), x + y, ca.vertcat(x - y, x))},
         r"shape \(2, 2\), vertcat\(g, G, H\) needs \(3, 2\)"),
    ],
)  # fmt: skip
def test_malformed_problem_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        corner(**changes)


def test_bad_starts_parameters_and_options_are_refused():
    starts = {"x0 has length 1": [0.0], r"x0\[1\] .y. is nan": [0.0, np.nan], "is inf": [0.0, INF]}
    for words, x0 in starts.items():
        with pytest.raises(ValueError, match=words):
            solve(corner(), x0)
    with pytest.raises(ValueError, match="p has length 0, expected 1"):
        solve(corner(f=x * stray, p=stray), [0, 0])
    with pytest.raises(ValueError, match="unknown relaxation 'none': choose from scholtes"):
        solve(corner(), [0, 0], relaxation="none")
    for name, value, words in (
        ("factor", 2.0, r"factor must be below 1, got 2\.0"),
        ("t0", 0.0, r"t0 must be positive and finite, got 0\.0"),
        ("t_final", 2.0, r"t_final = 2\.0 lies above t0 = 1\.0"),
        *((name, 0, f"{name} must be ") for name in ("time_limit_s", "max_iterations", "max_pivots")),
        *((name, -1, f"{name} must be .* got -1") for name in ("seed", "moves")),
        *(("starts", value, f"starts must be .* got {value}") for value in (0, 2.5)),
    ):
        with pytest.raises(ValueError, match=words):
            Options(**{name: value})
    assert Options(t_final=1.0, t0=1.0).t_final == 1.0


def test_lists_scalars_rows_and_omitted_parts_are_accepted():
    mpcc = MPCC([x, y], (x - 1) ** 2 + y**2, None, [x], [y], lbx=-5, ubx=[5, 5])
    assert (mpcc.n_x, mpcc.n_g, mpcc.n_pairs, mpcc.n_own) == (2, 0, 1, 2)
    assert (list(mpcc.lbx), list(mpcc.ubx), list(mpcc.start(3))) == ([-5, -5], [5, 5], [3, 3])
    assert corner(g=ca.horzcat(x, y)).n_g == 2
    assert "2 unknowns, 1 constraints, 1 complementarity pairs, 1 parameters; SX" in repr(corner(p=stray))


def _boxed(value, partner):
    inside = -1 <= value <= 2 and partner == 0
    return inside or (value == -1 and partner >= 0) or (value == 2 and partner <= 0)


# (bounds of G, bounds of H) of a mixed pair, and whether (G, H) satisfies it
MIXED = [
    ((-INF, INF), (-1, 2), lambda G, H: _boxed(H, G)),
    ((-1, 2), (-INF, INF), lambda G, H: _boxed(G, H)),
    ((2, INF), (-INF, 3), lambda G, H: G >= 2 and H <= 3 and (G == 2 or H == 3)),
    ((-INF, 1), (-1, INF), lambda G, H: G <= 1 and H >= -1 and (G == 1 or H == -1)),
    ((1, INF), (0, INF), lambda G, H: G >= 1 and H >= 0 and (G == 1 or H == 0)),
    ((-INF, 1), (-INF, 0), lambda G, H: G <= 1 and H <= 0 and (G == 1 or H == 0)),
    ((-INF, INF), (2, 2), lambda G, H: H == 2),
    ((-INF, INF), (-INF, INF), lambda G, H: G == 0),
]  # fmt: skip


@pytest.mark.parametrize(("of_G", "of_H", "satisfied"), MIXED)
def test_mixed_pair_has_the_feasible_points_of_its_definition(of_G, of_H, satisfied):
    """Over a grid of points; a start is completed by the parts of the free member."""
    program = MPCC.mixed(XY, x, None, x, y, lbG=of_G[0], ubG=of_G[1], lbH=of_H[0], ubH=of_H[1])
    values = ca.Function("values", [program.x], [program.g, program.G, program.H])
    for point in itertools.product((-2, -1, 0, 1, 2, 3), repeat=2):
        g, G, H = (np.array(part).ravel() for part in values(program.start(point)))
        inside = not np.any(g) and np.all(np.minimum(G, H) >= 0) and not np.any(G * H)
        assert inside == satisfied(*point), point


def test_bounds_that_make_no_pair_are_refused():
    for bounds, words in (
        ({"lbG": 0}, "pair 0 has the bounds"),
        ({"lbG": 0, "ubG": 1, "lbH": 0}, "pair 0 has the bounds"),
        ({"lbH": 2, "ubH": 1}, r"lbH\[0\] = 2.0 and ubH\[0\] = 1.0 leave no value"),
        ({"lbG": 2, "ubG": 1}, r"lbG\[0\] = 2.0"),
        ({"lbH": [0, 0]}, "lbH has length 2, expected 1"),
    ):
        with pytest.raises(ValueError, match=words):
            MPCC.mixed(XY, x, None, x, y, **bounds)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("with_hessian", [True, False])
def test_extended_mpcc_keeps_assembled_derivatives(kind, with_hessian):
    """Against CasADi's own of the whole: rows of g, G and H are each appended at their own place."""
    v, p, w, q = kind.sym("v", 3), kind.sym("p"), kind.sym("w", 2), kind.sym("q")
    f, g = v[0] ** 3 * v[1] + p * v[2], ca.vertcat(v[0] * v[1], v[2] ** 2)
    G, H = ca.vertcat(v[0] * p, ca.sin(v[1])), ca.vertcat(v[1] ** 2, v[2] * v[0])
    own = automatic_derivatives(v, p, f, ca.vertcat(g, G, H))
    if not with_hessian:
        own = Derivatives(own.grad_f, own.jac_g, None)
    longer = MPCC(v, f, g, G, H, p=p, lbg=-1, ubg=2, derivatives=own).extended(
        x=w, p=q, f=q * w[0] ** 2 * v[0], g=w[1] * v[2], G=w[0] * q, H=w[1] + v[1], lbx=[0, -1], ubg=7
    )
    assert (longer.n_x, longer.n_g, longer.n_pairs) == (5, 3, 3)
    assert list(longer.lbx) == [-INF] * 3 + [0, -1]
    assert (list(longer.lbg), list(longer.ubg)) == ([-1, -1, -INF], [2, 2, 7])
    assert_derivatives_are_casadis(longer, ca.vertcat(longer.g, longer.G, longer.H))
    assert (longer.derivatives.hess_lag is not None) == with_hessian


def test_models_of_contact_have_parts_by_name_and_can_be_extended():
    program = mpcc.build(EXAMPLES["6.3"]((4, 2)))
    parts = ["q", "u", "normal_force", "slip", "friction_minus", "friction_plus"]
    assert list(program.parts) == parts
    assert sum(part.shape[0] for part in program.parts.values()) == program.n_x
    longer = program.extended(g=ca.dot(program.parts["q"], program.parts["q"]), ubg=1.0)
    assert (longer.n_g, longer.ubg[-1]) == (program.n_g + 1, 1.0)
    energy = joint.build(EXAMPLES["6.3"]((4, 2)))
    assert list(energy.parts) == ["q", "u", "slip"]
    assert sum(part.shape[0] for part in energy.parts.values()) == energy.n_x
