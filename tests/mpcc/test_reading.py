"""Files of each public format, written by hand from the specification, and the command that reads them."""

import json

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.cli import app
from rmesh_nlp.mpcc import MPCC, read, solve
from support.nl_files import NL, SOLUTION, binary
from support.scripted_run import XY, x, y


@pytest.fixture
def nl(tmp_path):
    """Write a .nl file, the one above by default."""

    def written(text=NL, name="handmade.nl"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


def values(mpcc, parts, *at):
    """Expressions of an MPCC at a point (and parameters)."""
    found = ca.Function("v", [mpcc.x, mpcc.p][: len(at)], [getattr(mpcc, part) for part in parts])(*at)
    return [part.full().ravel().tolist() for part in (found if len(parts) > 1 else [found])]


def test_nl_file_with_complementarity_rows(nl):
    problem = read(nl())
    mpcc = problem.mpcc
    assert (problem.name, list(problem.x0)) == ("handmade", [0.5, 0.2, 0])
    assert (mpcc.n_own, mpcc.n_x, mpcc.n_pairs, mpcc.n_g) == (3, 5, 3, 2)
    # x, y, z, up, down; rows: x + z <= 5, and x^2 + z - 3 = up - down
    f, g, G, H = values(mpcc, "fgGH", [3.0, 0.0, 0.5, 1.0, 2.0])
    assert (f, g) == ([4 + 1 - 1], [3.5, 9 + 0.5 - 3 - 1 + 2])
    assert (G, H) == ([2, 1, 2], [0, 1.5, 1.5])  # x + y - 1 with y; up, down
    assert (list(mpcc.lbg), list(mpcc.ubg)) == ([-np.inf, 0], [5, 0])
    assert (list(mpcc.lbx[:3]), list(mpcc.ubx[:3])) == ([-np.inf, 0, -1], [np.inf, np.inf, 2])
    result = solve(mpcc, problem.x0)
    assert result.success
    assert (result.x[:3], result.f) == (pytest.approx(SOLUTION[0], abs=1e-6), pytest.approx(SOLUTION[1]))


@pytest.mark.parametrize(
    ("bits", "bound", "G", "H"),
    [
        *((1, "2 0", 4, 1), (1, "0 0 7", 4, 1), (2, "1 3", -4, 2), (2, "0 0 3", -4, 2)),
        *((3, "2 0", 4, 1), (3, "1 3", -4, 2), (3, "4 1", None, None), (0, "3", None, None)),
    ],
)
def test_bits_of_a_complementarity_row_say_which_bound_takes_part(bits, bound, G, H, nl):
    """The row is >= 0 at a lower bound of y and <= 0 at an upper one; x + y = 4 at (3, 1)."""
    text = NL.replace("5 1 2	# compl", f"5 {bits} 2	# compl")
    text = text.replace("\n2 0\n0 -1 2", f"\n{bound}\n0 -1 2")
    mpcc = read(nl(text.replace("C1	# orthant\nn-1", "C1	# orthant\nn0"))).mpcc
    pairs = list(zip(*values(mpcc, "GH", np.append([3.0, 1.0, 0.0], [9.0, 9.0])), strict=True))
    assert ((G, H) in pairs) == (G is not None)
    assert len(pairs) == 2 + (G is not None)


def test_defined_variables_of_an_nl_file_are_numbered_after_the_unknowns(nl):
    """v3 = 2 x + 3 z + y^2, which v4 = v3 - 1 uses; the objective is (x - 1)^2 + v4 - 2 z."""
    defined = "V3 2 0\n0 2\n2 3\no76\nv1\nV4 1 0\n3 1\nn-1\n"
    text = NL.replace("C0	# mixed", defined + "C0	# mixed").replace("o44	# exp\nv1\n", "v4\n")
    f = 4 + (2 * 3 + 3 * 0.5 + 2**2 - 1) - 2 * 0.5
    assert values(read(nl(text)).mpcc, "f", [3, 2, 0.5, 0, 0]) == [[pytest.approx(f)]]
    with pytest.raises(ValueError, match="defined variable v5 out of order"):
        read(nl(text.replace("V4", "V5")))


def test_maximised_objective_and_a_deep_sum(nl):
    """3000 nested additions are deeper than Python's own stack; a second objective does not count."""
    deep = "o0\nn1\n" * 3000 + "v1\n"
    text = NL.replace("O0 0", "O0 1").replace("o44	# exp\nv1\n", deep) + "O1 0\nn7\nG1 1\n0 5\n"
    problem = read(str(nl(text)))
    ((f,),) = values(problem.mpcc, "f", [3.0, 0.5, 0.25, 0, 0])
    assert problem.sign * f == pytest.approx((3 - 1) ** 2 + 3000 + 0.5 - 2 * 0.25)


OPERATIONS = {
    "o13\nn2.5": 2, "o14\nn2.5": 3, "o15\nn-2": 2, "o16\nn2": -2, "o37\nn1": np.tanh(1), "o38\nn1": np.tan(1),
    "o39\nn9": 3, "o40\nn1": np.sinh(1), "o41\nn1": np.sin(1), "o42\nn100": 2, "o43\nn2": np.log(2),
    "o45\nn1": np.cosh(1), "o46\nn1": np.cos(1), "o47\nn0.5": np.arctanh(0.5), "o49\nn1": np.arctan(1),
    "o50\nn1": np.arcsinh(1), "o51\nn0.5": np.arcsin(0.5), "o52\nn2": np.arccosh(2),
    "o53\nn0.5": np.arccos(0.5),
    "o3\nn1\nn4": 0.25, "o2\nn3\nn4": 12, "o6\nn3\nn1": 2, "o6\nn1\nn3": 0, "o48\nn1\nn2": np.arctan2(1, 2),
    "o4\nn5\nn3": 2, "o75\nn2\nn3": 8, "o77\nn2\nn3": 8, "o11\n3\nn2\nn1\nn3": 1, "o12\n3\nn2\nn1\nn3": 3,
    "o35\no22\nn1\nn2\nn7\nn8": 7, "o35\no29\nn1\nn2\nn7\nn8": 8,
}  # fmt: skip


@pytest.mark.parametrize("code", OPERATIONS)
def test_every_operation_of_an_nl_file(nl, code):
    mpcc = read(nl(NL.replace("o44	# exp\nv1\n", code + "\n"))).mpcc
    assert values(mpcc, "f", np.zeros(mpcc.n_x)) == [[pytest.approx(1 + OPERATIONS[code])]]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("g3 1 1 0", "z3 1 1 0", "must begin with 'g' .text. or 'b' .binary., not with 'z'"),
        ("g3 1 1 0", "hello", "must begin with 'g'"),
        ("0 0.5", "0", "2 numbers are expected, got '0'"),
        ("J0 2\n0 0", "J0 2\n0 0 1", "2 numbers are expected, got '0 0 1'"),  # old files without segment k
        ("C0", "L0", r"segment L .logical rows. is not supported"),
        ("o44", "f0 1", r"line 29: expression f .imported functions. is not"),
        ("o44", "h3:abc", r"expression h is not supported"),
        ("o44", "o64", r"operation o64 .a piecewise-linear term. is not supported"),
        ("k2", "S0 1 sosno\n0 1\nk2", "special ordered sets .suffix sosno."),
        ("k2", "Q2", "segment Q is not supported"),
        ("n-3", "nnan", "line 17: expected a finite number, got nan"),
        ("G0 3\n0 0\n1 0\n2 -2\n", "", "its segments G have 0 of 3 nonzeros"),
        (" 0 0 0 0 0	# discrete", " 1 0 0 0 0	# discrete", "integer"),
        ("o44", "o99", "line 29: operation o99 is not supported"),
        ("v1\nx2", "v17\nx2", "index 17 out of range"),
        ("5 3 3", "5 3 9", "out of range"),
        ("5 3 3", "9 3 3", "unknown bound type 9"),
        ("G0 3\n0 0\n1 0\n2 -2\n", "G0 3\n", "ends too early"),
        ("x2	# initial", "F0 1 1 f", "segment F .imported functions."),
        ("0 0.5", "0 half", "half"),
        ("J0 2", "J1 2", "segment J1 stands twice"),
        ("C1	", "C0	", "segment C0 stands twice"),
        ("0 -1 2", "3", r"row 0 .g.0.. complements an infinite bound of x.2."),
        ("2 0\n", "0 3 2\n", r"lbx.1. = 3.0 and ubx.1. = 2.0 leave no value"),
    ],
)
def test_malformed_nl_file_is_refused_with_its_place(nl, old, new, words):
    assert old in NL
    with pytest.raises(ValueError, match=words) as error:
        read(nl(NL.replace(old, new, 1), "bad.nl"))
    assert "bad.nl" in str(error.value)


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_nl_file_is_the_text_one_and_a_malformed_one_is_refused(nl, tmp_path, order):
    path = tmp_path / "binary.nl"
    path.write_bytes(binary(NL, order))
    text, other = read(nl()), read(path)
    at = np.linspace(0.3, 1.7, text.mpcc.n_x)
    assert values(other.mpcc, "fgGH", at) == values(text.mpcc, "fgGH", at)
    for name in ("lbx", "ubx", "lbg", "ubg"):
        np.testing.assert_array_equal(getattr(other.mpcc, name), getattr(text.mpcc, name))
    assert list(other.x0) == list(text.x0)
    data = binary(NL, order)
    for bad, words in (
        (data[:-3], "ends too early"),
        (data[:60], "ends too early"),
        (data.replace(b"0 0 1 1", b"0 0 5 1", 1).replace(b"0 0 2 1", b"0 0 5 1", 1), "arithmetic of kind 5"),
        (data + b"L", "byte .*: segment L .logical rows."),
    ):
        path.write_bytes(bad)
        with pytest.raises(ValueError, match=rf"binary\.nl.*{words}"):
            read(path)


def test_names_beside_an_nl_file_are_in_messages(nl, tmp_path):
    """A name holds what the modelling language called it, spaces and brackets included."""
    (tmp_path / "handmade.col").write_text("speed\nforce[2]\nthe gap\n")
    (tmp_path / "handmade.row").write_text("limit\nlaw\nsum\ncost\n")
    with pytest.raises(ValueError, match=r"row 0 .limit. complements an infinite bound of x.2. .the gap."):
        read(nl(NL.replace("0 -1 2", "3")))
    with pytest.raises(ValueError, match=r"lbx.1. .force.2.. = 3.0 and ubx.1. = 2.0 leave no value"):
        read(nl(NL.replace("2 0\n", "0 3 2\n", 1)))
    (tmp_path / "handmade.col").write_text("speed\n")  # of another model
    with pytest.raises(ValueError, match=r"bound of x.2.$"):
        read(nl(NL.replace("0 -1 2", "3")))


def write_nosbench(path, mpcc, **fields):
    parts = {"g_fun": mpcc.g, "G_fun": mpcc.G, "H_fun": mpcc.H, "augmented_objective_fun": mpcc.f}
    data = {
        name: ca.Function(name, [mpcc.x, mpcc.p], [part], ["w", "p"], [name[:-4]]).serialize()
        for name, part in parts.items()
    }
    path.write_text(json.dumps(data | {"w0": [1.0, 1.0]} | fields), encoding="utf-8")
    return path


def test_nosbench_file_has_its_numbers_and_functions(tmp_path):
    """Bounds of w are infinite, those of g zero, where they are not given; null and 1e20 mean infinity."""
    p = ca.SX.sym("p")
    mpcc = MPCC(XY, (x - p) ** 2 + (y - 1) ** 2, x + 2 * y, x, 3 * y, p=p)
    bounds = {"lbw": [None, -1e20], "ubw": [5.0, 1e21], "lbg": [[-9]], "ubg": 8}
    problem = read(write_nosbench(tmp_path / "p.json", mpcc, p0=[3.0], w0=[[0.5], [0.25]], **bounds))
    read_ = problem.mpcc
    assert (problem.name, list(problem.x0), list(problem.p0), problem.sign) == ("p", [0.5, 0.25], [3], 1)
    assert (list(read_.lbx), list(read_.ubx)) == ([-np.inf, -np.inf], [5, np.inf])
    assert (list(read_.lbg), list(read_.ubg)) == ([-9], [8])
    assert values(read_, "fgGH", [1, 2], 3) == [[4 + 1], [5], [1], [6]]
    assert solve(read_, problem.x0, p=problem.p0).x == pytest.approx([3, 0], abs=1e-7)
    plain = read(write_nosbench(tmp_path / "plain.json", MPCC(XY, x, x - 1, x, y))).mpcc
    assert (list(plain.lbx), list(plain.ubx)) == ([-np.inf] * 2, [np.inf] * 2)
    assert (list(plain.lbg), list(plain.ubg)) == ([0], [0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.pop("G_fun"), "G_fun is missing"),
        (lambda data: data.update(H_fun=""), "H_fun is missing or no serialised Function"),
        (lambda data: data.update(H_fun="junk"), "H_fun is no serialised Function"),
        (lambda data: data.pop("w0"), "w0 is missing"),
        (lambda data: data.update(lbw=["low"]), "lbw must be a list of numbers"),
        (lambda data: data.update(w0=[1.0, 1.0, 1.0]), "does not take w of length 3"),
    ],
)
def test_a_malformed_nosbench_file_is_refused_with_its_field(tmp_path, change, words):
    path = write_nosbench(tmp_path / "bad.json", MPCC(XY, x + y, None, x, y))
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    with pytest.raises(ValueError, match=words):
        read(path)


def test_what_is_no_problem_is_refused(tmp_path):
    with pytest.raises(ValueError, match="expected a path or a Pyomo model, got dict"):
        read({})
    path = tmp_path / "deep.json"
    path.write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"deep.json: not a JSON file"):
        read(path)


def test_command_solves_files(nl, capsys):
    path = nl()
    assert app.run(["mpcc", str(path), "--log"]) == 0
    out = capsys.readouterr().out
    assert "converged: Converged to the tolerance." in out
    assert "objective        -3" in out
    assert "stationarity     S" in out
    assert "relaxed" in out
    assert app.run(["mpcc", str(path), "--json"]) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["success"]
    assert row["x"] == pytest.approx(SOLUTION[0], abs=1e-6)
    assert row["starts"] == []
    former = path.with_suffix(".former.json")
    former.write_text(json.dumps(row))
    assert app.run(["mpcc", str(path), "--json", "--start", str(former)]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["iterations"] < row["iterations"]
    assert again["x"] == pytest.approx(row["x"], abs=1e-9)
    former.write_text("[]")
    assert app.run(["mpcc", str(path), "--start", str(former)]) == 2
    assert "is not what rmesh mpcc --json prints" in capsys.readouterr().err
    assert app.run(["mpcc", str(path), "--json", "--starts", "3"]) == 0
    ends = json.loads(capsys.readouterr().out)["starts"]
    assert sum(end["number"] for end in ends) == 3
    assert ends[0]["f"] == pytest.approx(-3, abs=1e-6)  # the sign of the file
    assert app.run(["mpcc", str(path), "--max-iterations", "2"]) == 1
    assert "iteration_limit" in capsys.readouterr().out
