"""The command ``rmesh``: it runs a command line, and every error is one line."""

from __future__ import annotations

import sys
from typing import Any

import typer
from typer.main import get_command

from rmesh_nlp.cli import Exit
from rmesh_nlp.cli.commands import app
from rmesh_nlp.errors import BadInputError, InterruptedSolveError, one_line

# typer brings its own click, or uses the installed one: its exceptions are found either way
ClickException: Any = typer.BadParameter.__mro__[2]
COMMAND: Any = get_command(app)


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code; what is wrong is said in one line on stderr."""
    try:
        code = int(COMMAND.main(args=arguments, prog_name="rmesh", standalone_mode=False) or 0)
        if code == Exit.INTERRUPTED:  # Ctrl-C, of which some versions of typer say nothing
            raise KeyboardInterrupt
        return code
    except ClickException as error:
        return _complain(f"{one_line(error.format_message())}{_got(error.__cause__)}")
    except OSError as error:  # the file first, without the number of the error
        return _complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except BadInputError as error:
        return _complain(str(error))
    except InterruptedSolveError as error:
        print(f"rmesh: interrupted: {error}", file=sys.stderr)
        return Exit.INTERRUPTED
    except (KeyboardInterrupt, typer.Abort):
        print("rmesh: interrupted", file=sys.stderr)
        return Exit.INTERRUPTED


def _got(cause: Any) -> str:
    """The value that pydantic refused: newer versions of typer, which use it, do not name it."""
    return f", got {cause.errors()[0]['input']!r}" if hasattr(cause, "errors") else ""


def _complain(message: str) -> int:
    for line in message.splitlines() or [""]:
        print(f"rmesh: error: {line}", file=sys.stderr)
    return Exit.BAD_INPUT
