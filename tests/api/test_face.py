"""What ``import rmesh_nlp as rm`` offers: names, laziness, what type checkers see."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rmesh_nlp as rm

STUB = Path(rm.__file__).with_suffix(".pyi")


def test_every_public_name_is_there() -> None:
    for name in rm.__all__:
        assert getattr(rm, name) is not None
        assert name in dir(rm)
    assert {"importlib", "Any"}.isdisjoint(dir(rm))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'slove'"):
        rm.slove  # noqa: B018


def test_type_checkers_see_what_python_sees() -> None:
    seen = {}
    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if alias.asname is not None:  # a stub re-exports only what it names again
                    module = __import__(node.module or "", fromlist=[alias.name])
                    seen[alias.asname] = getattr(module, alias.name)
    assert {*seen, "__version__", "objective", "read_problem", "solve_mpcc"} == set(rm.__all__)
    for name, value in seen.items():
        assert getattr(rm, name) is value, name


def test_nothing_heavy_is_loaded_before_it_is_used() -> None:
    code = "import sys, rmesh_nlp; dir(rmesh_nlp); print({'casadi', 'numpy', 'rich'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_the_solver_of_mpccs_stays_a_package() -> None:
    assert rm.mpcc.solve is rm.solve_mpcc
    assert rm.mpcc.MPCC is rm.MPCC


@pytest.mark.slow
def test_a_type_checker_knows_every_name(tmp_path: Path) -> None:
    """Mypy sees the types themselves, not Any."""
    names = [name for name in rm.__all__ if name not in ("__version__", "mpcc", "quantities", "shapes")]
    lines = ["import rmesh_nlp as rm", *(f"reveal_type(rm.{name})" for name in names)]
    script = tmp_path / "script.py"
    script.write_text("\n".join(lines))
    command = [sys.executable, "-m", "mypy", "--follow-imports", "silent", str(script)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=STUB.parent.parent)
    revealed = [line for line in done.stdout.splitlines() if "Revealed type" in line]
    assert len(revealed) == len(names), done.stdout
    assert not [line for line in revealed if 'is "Any"' in line]
