"""The command line itself: help, exit codes, Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rmesh_nlp import __version__
from rmesh_nlp.cli import app, commands, entry


@pytest.mark.parametrize("command", ["solve", "compare", "table", "figures", "study"])
def test_help_has_examples(rmesh, command: str) -> None:
    said = rmesh(f"{command} --help")
    assert said.code == 0
    assert f"  rmesh {command} " in said.out
    assert rmesh("--version")[:2] == (0, f"rmesh {__version__}\n")


def test_an_interruption_is_said_when_there_is_nothing_to_keep(rmesh, monkeypatch) -> None:
    def interrupted(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "load", interrupted)
    assert rmesh("table results") == (130, "", "rmesh: interrupted\n")


IMPORTS = """
class Presses:
    def find_spec(self, name, *_):
        try: name == 'casadi' and press()
        except KeyboardInterrupt: raise ImportError('initialization failed')
sys.meta_path.insert(0, Presses())
"""
COMMANDS = "import typer.main; typer.main.get_command = press"
ENDS = "import atexit; atexit.register(press)"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    ("during", "number"), [(IMPORTS, "SIGINT"), (IMPORTS, "SIGTERM"), (COMMANDS, "SIGINT"), (ENDS, "SIGINT")]
)
def test_an_interruption_before_and_after_the_work_is_one_line(during: str, number: str) -> None:
    """Libraries in C make an ImportError of a KeyboardInterrupt that comes while they begin."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"press = lambda *_: signal.raise_signal(signal.{number})\n{during}\n"
        "from rmesh_nlp.cli.entry import main; main()"
    )
    words = ["--version"] if during == ENDS else ["table", "x"]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "rmesh: interrupted\n")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("formulation", ["joint", "nested", "mpcc"])
def test_interrupt_keeps_finished_rows(rmesh, formulation: str) -> None:
    """CasADi swallows Ctrl-C, and mpcc would go on with its next program."""
    arguments = ["compare", "6.1", "--formulations", f"fixed,{formulation}", "--n", "40", "--out", "cut"]
    with subprocess.Popen(
        [sys.executable, "-c", "from rmesh_nlp.cli.entry import main; main()", *arguments],
        stderr=subprocess.PIPE,
        text=True,
        # a test run in the background of a script ignores SIGINT, and so would its children
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        assert "6.1 fixed: converged" in process.stderr.readline()  # the other solve begins now
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        assert process.wait(timeout=20) == 130
        assert time.monotonic() - sent < 10
        assert "1 of 2 solves are kept in cut" in process.stderr.read()
    first, *rest = map(json.loads, Path("cut/records.jsonl").read_text().splitlines())
    assert first["formulation"] == "fixed"
    # the other one has a row if it had a valid mesh to keep by then
    assert all(row["status"] == "interrupted" for row in rest)
    assert rmesh("table cut").code == 0


@pytest.mark.parametrize(
    ("given", "threads"),
    [({}, ["1"] * 3), ({"OMP": "3"}, ["3", None, None]), ({"OPENBLAS": "2"}, [None, "2", None])],
)
def test_the_command_takes_one_thread_unless_told(given, threads, monkeypatch) -> None:
    """That numpy is not loaded before is tested with the public names."""
    names = ("OMP", "OPENBLAS", "MKL")
    environment = {f"{name}_NUM_THREADS": value for name, value in given.items()}
    monkeypatch.setattr(os, "environ", environment)
    monkeypatch.setattr(app, "run", lambda _: 0)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    with pytest.raises(SystemExit):
        entry.main()
    assert [environment.get(f"{name}_NUM_THREADS") for name in names] == threads
