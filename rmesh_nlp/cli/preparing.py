"""The commands around a problem or study file: write, check, ask whether to relocate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rmesh_nlp.cli import work


def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The file to write.")],
    study: Annotated[bool, typer.Option("--study", help="A study file instead of a problem file.")] = False,
) -> None:
    """Write a commented template of a problem file, or of a study; it solves as it is.

    \b
    rmesh new my.toml
    rmesh new --study study.toml
    """
    raise typer.Exit(work.study_commands().new(file) if study else work.problem_commands().new(file))


def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A problem file.")],
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="Where to draw; default: beside the problem file."),
    ] = None,
) -> None:
    """Validate a problem file, print what it says, draw its mesh with boundary roles and motion.

    A study file is validated with all problems and formulations that it names.

    \b
    rmesh check my.toml
    rmesh check study.toml
    rmesh check my.toml --picture roles.pdf
    """
    raise typer.Exit(work.problem_commands().check(file, picture))


def advise(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A problem file.")],
) -> None:
    """Say whether to relocate, to refine, or both, before anything dear is solved.

    Relocates on a coarse mesh, prolongs the map, and refines uniformly twice.

    \b
    rmesh advise my.toml
    """
    raise typer.Exit(work.problem_commands().advise(file))
