import json
from pathlib import Path
from typing import Any

import pytest

from rmesh_nlp.cli import app as cli

SQUARE = """\
[mesh]
shape = "rectangle"
nx = 4
ny = 4

[material]
law = "laplace"
source = "20*x*y"

[dirichlet]
left = 0.0

[contact]
boundary = "right"

[motion]
delta = "none"
"""


@pytest.fixture
def square(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "square.toml"
    path.write_text(SQUARE)
    return path


def solved(arguments: list[str]) -> dict[str, Any]:
    assert cli.run([*arguments, "--out", "one", "--no-figures", "-q"]) == 0
    record: dict[str, Any] = json.loads(Path("one/record.json").read_text())
    return record


@pytest.mark.slow
def test_weights_and_flips_are_given_in_the_file_or_on_the_command_line(square: Path) -> None:
    by_option = solved(["solve", str(square), "-f", "joint", "--regularisation", "0.1,0.02"])
    assert by_option["regularisation"] == [0.1, 0.02]
    assert "flip_rounds" not in by_option
    square.write_text(
        f"{SQUARE}\n[solve]\nformulation = 'joint'\nregularisation = [0.1, 0.02]\nflips = true\n"
    )
    by_file = solved(["solve", str(square)])
    assert by_file["regularisation"] == [0.1, 0.02]
    assert "flip_rounds" in by_file
    assert solved(["solve", str(square), "--regularisation", "0.5"])["regularisation"] == 0.5


@pytest.mark.slow
def test_compare_gives_the_weight_to_those_that_take_it(square: Path) -> None:
    chosen = ["--formulations", "fixed,joint", "--regularisation", "0.1"]
    cli.run(["compare", "6.1", "--n", "3", *chosen, "--out", "both", "-q", "--no-figures"])
    rows = [json.loads(line) for line in Path("both/records.jsonl").read_text().splitlines()]
    assert {row["formulation"]: row.get("regularisation") for row in rows} == {"fixed": None, "joint": 0.1}


@pytest.mark.parametrize("text", ["-1", "1,0,0.1", "much", "nan"])
def test_bad_weights_are_refused(square: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["solve", str(square), f"--regularisation={text}"]) == 2
    assert repr(text) in capsys.readouterr().err
    square.write_text(f"{SQUARE}\n[solve]\nregularisation = [1, 0, 0.1]\n")
    assert cli.run(["solve", str(square)]) == 2
    assert "solve.regularisation = [1, 0, 0.1]: expected" in capsys.readouterr().err


@pytest.mark.slow
def test_an_example_without_boxes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["solve", "6.1", "--n", "3", "--delta", "none", "--quadrature", "8", "-f", "joint"]
    record = solved([*arguments, "--regularisation", "0.1"])
    assert record["delta"] is None
    assert record["gain_audited"] > 0
