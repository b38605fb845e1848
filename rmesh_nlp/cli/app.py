"""The command ``rmesh``: its commands by name, and what becomes of an error."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer
from typer.main import get_command

from rmesh_nlp import __version__
from rmesh_nlp.cli import preparing, reporting, solving
from rmesh_nlp.errors import BadInputError, InterruptedSolveError

BAD_INPUT, INTERRUPTED = 2, 130

# typer brings its own click, or uses the installed one: its exceptions are found either way
UsageError = typer.BadParameter.__mro__[1]
ClickException: Any = UsageError.__mro__[1]

app = typer.Typer(add_completion=True, rich_markup_mode=None, pretty_exceptions_enable=False)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"rmesh {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _rmesh(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and leave."),
    ] = False,
) -> None:
    """Relocate the nodes of finite-element meshes for contact problems.

    \b
    rmesh compare                                     all examples, all formulations
    rmesh solve 6.1 --formulation joint --n 16        one solve
    rmesh new my.toml                                 a problem of your own: a commented template
    rmesh check my.toml                               is it in order? with a picture
    rmesh solve my.toml                               solve it
    rmesh study study.toml --out first --jobs 2       many solves on all cores, resumed at any moment
    rmesh table results                               tables again, without solving
    rmesh figures results                             figures again, without solving
    rmesh report results                              one HTML page of all that is there
    rmesh reproduce                                   the paper's figures, printed and computed

    Exit code: 0 if every requested solve succeeded, 1 if one did not, 2 for bad input,
    130 after Ctrl-C.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


for _command in (
    solving.solve,
    solving.path,
    preparing.check,
    preparing.advise,
    preparing.new,
    reporting.study,
    solving.compare,
    reporting.table,
):
    app.command()(_command)
app.command(
    add_help_option=False, context_settings={"ignore_unknown_options": True, "allow_extra_args": True}
)(reporting.mpcc)
for _command in (reporting.report, reporting.reproduce, reporting.export, reporting.figures):
    app.command()(_command)


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code; what is wrong is said in one line on stderr."""
    command: Any = get_command(app)
    try:
        code = int(command.main(args=arguments, prog_name="rmesh", standalone_mode=False) or 0)
        if code == INTERRUPTED:  # Ctrl-C, of which some versions of typer say nothing
            raise KeyboardInterrupt
        return code
    except ClickException as error:
        return _complain(" ".join(error.format_message().split()))
    except (BadInputError, OSError) as error:
        return _complain(str(error))
    except InterruptedSolveError as error:
        print(f"rmesh: interrupted: {error}", file=sys.stderr)
        return INTERRUPTED
    except (KeyboardInterrupt, typer.Abort):
        print("rmesh: interrupted", file=sys.stderr)
        return INTERRUPTED


def _complain(message: str) -> int:
    for line in message.splitlines() or [""]:
        print(f"rmesh: error: {line}", file=sys.stderr)
    return BAD_INPUT


def main() -> None:
    """Entry point of ``rmesh``."""
    sys.exit(run(sys.argv[1:]))
