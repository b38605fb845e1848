"""The commands that solve problems: options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rmesh_nlp.cli import work
from rmesh_nlp.cli.inputs import parse_names
from rmesh_nlp.cli.options import (
    DEFAULT,
    Columns,
    Delta,
    FormulationOptions,
    Jobs,
    Json,
    Objective,
    Objectives,
    Quadrature,
    Quiet,
    Repeats,
    Seed,
    Seeds,
    Size,
    Verbose,
    with_formulation_options,
)
from rmesh_nlp.errors import BadInputError


@with_formulation_options
def solve(
    example: Annotated[
        str, typer.Argument(metavar="EXAMPLE", help="6.1, 6.2 or 6.3, or a problem file such as my.toml.")
    ],
    formulation: Annotated[
        str | None,
        typer.Option(
            "--formulation",
            "-f",
            help="fixed, nested, joint, mpcc, auto, or one you installed. Default: joint; of a file "
            "what it names, or auto.",
        ),
    ] = None,
    n: Size = None,
    delta: Delta = None,
    seed: Seed = None,
    quadrature: Quadrature = "midpoint",
    objective: Objective = None,
    chosen: FormulationOptions = DEFAULT,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder to write; default: results/<name of the solve>."),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
    figures: Annotated[
        bool,
        typer.Option(
            "--figures/--no-figures", help="Draw before and after to DIR/figures (for a problem file)."
        ),
    ] = True,
    columns: Columns = 2,
) -> None:
    """Solve one example, or the problem of a file, by one formulation.

    Writes DIR/record.json, DIR/solution.vtu and DIR/history.csv; for a problem file also the
    relocated mesh DIR/mesh.msh, the series DIR/iterations for ParaView, and DIR/figures: meshes,
    displacement, stress, contact pressure before and after, motion, what limits each node.

    \b
    rmesh solve 6.1 --formulation joint --n 8 --delta 0.0275 --out one
    rmesh solve 6.2 --n 12x6 --delta 0.15667,0.07333
    rmesh solve 6.1 --formulation nested --outer newton --n 32
    rmesh solve 6.1 --formulation mpcc --objective error-l2 --relaxation lin-fukushima
    rmesh solve my.toml --formulation nested --certify
    rmesh solve my.toml --columns 1
    """
    settings = chosen.settings(n, delta, quadrature, seed, objective)
    voice = "json" if json else "quiet" if quiet else "text"
    if example.endswith(".toml"):
        for name, value in (("--n", n), ("--delta", delta), ("--quadrature", quadrature)):
            if value not in (None, "midpoint"):
                raise BadInputError(f"{name} {value} is for the examples: write it into {example}")
        commands = work.problem_commands()
        columns = columns if figures else 0
        options, certify = settings["options"], chosen.certify
        raise typer.Exit(commands.solve(Path(example), formulation, options, out, certify, voice, columns))
    settings["certify"] = chosen.certify
    raise typer.Exit(work.commands().solve(example, formulation or "joint", settings, out, voice))


@with_formulation_options
def compare(
    examples: Annotated[
        list[str] | None, typer.Argument(help="Examples, or problem files; the three examples by default.")
    ] = None,
    formulations: Annotated[
        str,
        typer.Option(
            "--formulations",
            metavar="NAMES",
            help="Formulations, separated by commas; options of their own as in mpcc:start=joint.",
        ),
    ] = "fixed,nested,joint,mpcc",
    n: Size = None,
    delta: Delta = None,
    seed: Seeds = None,
    quadrature: Quadrature = "midpoint",
    objective: Objectives = None,
    chosen: FormulationOptions = DEFAULT,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")] = Path("results"),
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep the rows in DIR that succeeded and solve only the others.")
    ] = False,
    jobs: Jobs = 1,
    repeats: Repeats = 1,
    figures: Annotated[
        bool,
        typer.Option("--figures/--no-figures", help="Draw to DIR/figures; rmesh figures DIR does it later."),
    ] = True,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Compare formulations: solve, table and draw.

    Prints a row per solve. Writes DIR/records.jsonl, DIR/table.md, .tex, .csv, DIR/figures and DIR/solutions.
    An option goes to those formulations that take it. Problem files are compared with uniform refinements
    of their meshes as well, so that you see what moving nodes is worth. What an earlier run left in DIR
    is moved to DIR/previous when the first solve has ended.

    \b
    rmesh compare
    rmesh compare my.toml --formulations fixed,nested --out mine
    rmesh compare 6.1 --formulations fixed,nested,joint --n 16 --out fine
    rmesh compare --out results --resume
    """
    settings = chosen.settings(n, delta, quadrature, ",".join(seed) if seed else None, objective)
    names = tuple(dict.fromkeys(examples or ()))
    raise typer.Exit(
        work.commands().compare(
            names,
            parse_names("--formulations", formulations),
            {**settings, "certify": chosen.certify, "repeats": repeats},
            out,
            resume,
            jobs,
            "json" if json else "quiet" if quiet else "text",
            figures,
            verbose,
        )
    )


def path(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A problem file with a table [path].")],
    formulation: Annotated[
        str | None, typer.Option("--formulation", "-f", help="Formulation; default: that of the file.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder to write; default: results/<name>-path."),
    ] = None,
) -> None:
    """Move a foundation in steps and solve each: a load path.

    Writes DIR/path.csv, DIR/path.png and .pdf (force and pressure over the way), and DIR/path.pvd with
    a VTU file per step for ParaView.

    \b
    rmesh path my.toml
    rmesh path my.toml -f nested --out pressing
    """
    raise typer.Exit(work.path_commands().path(file, formulation, out))
