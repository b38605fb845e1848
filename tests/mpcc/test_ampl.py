"""The solver as AMPL, Pyomo and JuMP call it: ``stub.nl`` in, ``stub.sol`` out."""

import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca
import pytest

from rmesh_nlp import __version__
from rmesh_nlp.cli import app
from rmesh_nlp.mpcc import ampl, read, solve
from rmesh_nlp.mpcc.nl import read_rows
from rmesh_nlp.mpcc.sol import solve_code, write_sol
from rmesh_nlp.optimize.status import Status
from support.nl_files import NL, SOLUTION, binary

ACTIVE = NL.replace("1 5\nb", "1 2.5\nb")
"""With x + z <= 2.5, which is active at the minimum: its dual is not zero."""
MAXIMUM = ACTIVE.replace("O0 0", "O0 1").replace("o0	#+\no76", "o16\no0\no76").replace("2 -2\n", "2 2\n")
"""The same as the maximum of the negative objective."""


@dataclass
class Sol:
    """What JuMP's AmplNLWriter reads of a ``.sol`` file."""

    message: str
    options: list[str]
    duals: list[float]
    x: list[float]
    code: int
    suffixes: dict[str, dict[int, float]] = field(default_factory=dict)


def read_sol(path: Path) -> Sol:
    """Read a file in the order in which MathOptInterface's ``sol.jl`` does."""
    lines = iter(path.read_text().splitlines())
    words: list[str] = []
    for line in lines:
        if line.startswith("Options"):
            break
        words.append(line)
    options = [next(lines)]
    count, has_tolerance = int(options[0]), False
    options += [next(lines), next(lines)]
    if options[2] == "3":
        count, has_tolerance = count - 2, True
    options += [next(lines) for _ in range(3, count + 1)]
    _, n_duals, _, n_values = (int(next(lines)) for _ in range(4))
    if has_tolerance:
        options.append(next(lines))
    duals = [float(next(lines)) for _ in range(n_duals)]
    x = [float(next(lines)) for _ in range(n_values)]
    kind, number, code = next(lines).split()
    assert (kind, number) == ("objno", "0")
    found = Sol("\n".join(words).strip(), options, duals, x, int(code))
    for line in lines:
        suffix, _, n, *_ = line.split()
        assert suffix == "suffix"
        name = next(lines)
        pairs = (next(lines).split() for _ in range(int(n)))
        found.suffixes[name] = {int(j): float(value) for j, value in pairs}
    return found


@pytest.fixture
def stub(tmp_path):
    """Write a model and give its path without the ending."""

    def written(text=NL):
        (tmp_path / "model.nl").write_text(text)
        return tmp_path / "model"

    return written


def called(stub, *options):
    """The solution that a call within this process writes."""
    assert app.run(["mpcc", str(stub), "-AMPL", "outlev=0", *options]) == 0
    return read_sol(stub.with_suffix(".sol"))


@pytest.mark.slow
def test_executable_is_called_as_jump_calls_it(tmp_path):
    """AmplNLWriter.jl runs ``solver model.nl -AMPL key=value`` and takes an exit code but 0 for an error.

    AMPL's ``solve`` writes binary files.
    """
    path = tmp_path / "n=3" / "model.nl"
    path.parent.mkdir()
    path.write_bytes(binary(NL))
    command = [sys.executable, "-c", "from rmesh_nlp.cli.entry import mpcc; mpcc()", path, "-AMPL"]
    done = subprocess.run([*command, "time_limit_s=60"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "relaxed" in done.stdout
    sol = read_sol(path.with_suffix(".sol"))
    assert (sol.code, sol.x) == (0, pytest.approx(SOLUTION[0], abs=1e-6))
    assert "objective -3" in sol.message
    assert "stationarity S" in sol.message


JUMP = """g3 1 1 0
 2 1 1 0 0 0
 0 1
 0 0
 0 2 0
 0 0 0 1
 0 0 0 0 0
 1 2
 0 0
 0 0 0 0 0
C0
n0
O0 0
o0
o5
o1
v0
n3
n2
o5
o1
v1
n1
n2
x2
0 1
1 0.1
r
5 1 2
b
2 0
2 0
k1
1
J0 1
0 1
G0 2
0 0
1 0
"""
"""Least (x - 3)^2 + (y - 1)^2 on 0 <= x _|_ y >= 0 in the layout of MathOptInterface, without names."""


def test_model_in_the_layout_of_jump(stub):
    sol = called(stub(JUMP))
    assert (sol.code, sol.x) == (0, pytest.approx([3, 0], abs=1e-6))
    assert sol.suffixes["ipopt_zL_out"][1] == pytest.approx(-2, abs=1e-5)  # y >= 0 is y = 0 on this branch
    sol = called(stub(JUMP.replace("b\n2 0", "b\n1 -1")))  # x <= -1 where it must not be negative
    assert sol.code == 200
    assert "Locally infeasible" in sol.message


@pytest.mark.parametrize("text", [ACTIVE, MAXIMUM])
def test_duals_make_up_the_gradient_and_are_changes_with_the_right_hand_side(stub, text):
    """The signs of AMPL: gradient of f = sum of dual times gradient of row + zL + zU, minimum or maximum."""
    path = stub(text)
    sol, rows = called(path), read_rows(path.with_suffix(".nl"))
    f, g = ca.gradient(rows.f, rows.x), ca.jacobian(ca.vertcat(*rows.bodies), rows.x)
    gradient, jacobian = (part.full() for part in ca.Function("at", [rows.x], [f, g])(sol.x))
    sums = jacobian.T @ sol.duals
    for values in sol.suffixes.values():
        for j, value in values.items():
            sums[j] += value
    assert sums == pytest.approx(gradient.ravel(), abs=1e-6)
    assert set(sol.suffixes) == {"ipopt_zL_out", "ipopt_zU_out"}
    wider, value = called(stub(text.replace("1 2.5", "1 2.501"))), ca.Function("f", [rows.x], [rows.f])
    assert sol.duals[2] == pytest.approx(float(value(wider.x) - value(sol.x)) / 1e-3, abs=0.01)
    assert abs(sol.duals[2]) > 0.1


def test_options_of_the_first_line_come_back(stub):
    """With 3 in second place the tolerance of basic variables follows, after two more that are counted."""
    assert called(stub(NL.replace("g3 1 1 0", "g3 1 3 0 1e-4"))).options == ["5", "1", "3", "0", "1e-4"]
    assert called(stub(NL.replace("g3 1 1 0", "g"))).options == ["3", "1", "1", "0"]


@pytest.mark.parametrize("status", Status)
def test_code_is_in_the_hundred_of_its_kind(status):
    kinds = {"converged": 0, "acceptable": 1, "infeasible": 2, "unbounded": 3}
    limits = dict.fromkeys(("iteration_limit", "time_limit", "interrupted"), 4)
    assert solve_code(status) // 100 == (kinds | limits).get(status.value, 5)


def test_options_come_from_the_environment_and_then_from_the_command(stub, monkeypatch):
    monkeypatch.setenv(ampl.VARIABLE, "max_iterations=2 outlev=0")
    path = stub()
    assert app.run(["mpcc", str(path), "-AMPL"]) == 0
    limited = read_sol(path.with_suffix(".sol"))
    assert (limited.code, limited.duals, len(limited.x)) == (400, [], 3)
    assert "Stopped at the iteration limit" in limited.message
    assert app.run(["mpcc", str(path), "-AMPL", "max_iterations=none"]) == 0
    assert read_sol(path.with_suffix(".sol")).code == 0


@pytest.mark.parametrize("text", ["t0=0.5 relaxation=l1-penalty", "t0 0.5 relaxation = 'l1-penalty'"])
def test_words_of_options_become_numbers_and_names(text, stub, monkeypatch):
    """In the environment also as AMPL writes them."""
    monkeypatch.setenv(ampl.VARIABLE, text)
    given = []
    monkeypatch.setattr(
        ampl, "solve", lambda *of, **more: given.append(more["options"]) or solve(*of, **more)
    )
    called(stub(), "time_limit_s=50", "warm_duals=yes", "ipopt.tol=1e-9")
    (options,) = given
    assert (options.t0, options.relaxation) == (0.5, "l1-penalty")
    assert (options.time_limit_s, options.warm_duals) == (50, True)
    assert options.ipopt == {"tol": 1e-9}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-AMPL"], "no stub given"),
        (["one", "two", "-AMPL"], "option must be NAME=VALUE, got 'two'"),
        (["absent", "-AMPL"], "absent.nl"),
        (["x", "-AMPL", "tt0=1"], "unknown setting 'tt0': did you mean t0"),
        (["x", "-AMPL", "t0=small"], "t0 must be positive and finite, got 'small'"),
        (["x", "-AMPL", "ipopt_warm=1"], "ipopt_warm must be a mapping .* got 1"),
        (["x", "-AMPL", "tol=1e-9"], r"unknown setting 'tol'.* ipopt,"),
        (["x", "-AMPL", "-q"], "unknown flag '-q'"),
        (["x", "-AMPL", "=3"], "option must be NAME=VALUE, got '=3'"),
        # without the flag of AMPL
        ([], "no file given"),
        (["absent.nl"], "absent.nl"),
        (["x.gms"], "unknown format"),
        (["x.nl", "--frob"], "no such option: --frob"),
        (["x.nl", "--starts", "0"], "Invalid value for '--starts'"),
        (["x.nl", "--time-limit", "0"], "Invalid value for '--time-limit'"),
    ],
)
def test_bad_calls_are_refused_in_one_line(arguments, words, capsys):
    assert app.run(["mpcc", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(words, error)


def test_interrupted_call_writes_nothing(stub, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(ampl, "solve", interrupted)
    path = stub()
    assert app.run(["mpcc", str(path), "-AMPL"]) == 130
    assert capsys.readouterr().err == "rmesh: interrupted\n"
    assert not path.with_suffix(".sol").exists()


def test_flags_of_asl(stub, capsys):
    assert app.run(["mpcc", "-v"]) == 0
    assert capsys.readouterr().out == f"rmesh-mpcc {__version__}\n"
    assert app.run(["mpcc", "-="]) == 0
    assert {"relaxation", "time_limit_s", "outlev"} <= set(capsys.readouterr().out.split())
    path = stub()
    assert app.run(["mpcc", str(path), "-s", "outlev=0"]) == 0
    assert "stationarity S" in capsys.readouterr().out
    assert read_sol(path.with_suffix(".sol")).code == 0


def test_only_an_nl_file_has_a_solution_file(stub, tmp_path):
    given = read(stub().with_suffix(".nl"))
    with pytest.raises(ValueError, match="made was not read from an"):
        write_sol(tmp_path / "made.sol", type(given)("made", given.mpcc, given.x0), None)


def test_a_full_disk_leaves_no_part_of_a_solution_file(stub, capsys, monkeypatch):
    path = stub()

    def half(self, text, **options):
        self.write_bytes(text.encode()[:9])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", half)
    assert app.run(["mpcc", str(path), "-AMPL"]) == 2
    assert capsys.readouterr().err == f"rmesh: error: {path}.sol: No space left on device\n"
    assert not path.with_suffix(".sol").exists()
