"""The command ``rmesh``: options and their help; the work is done in :mod:`rmesh_nlp.cli.commands`."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer
from typer.main import get_command

from rmesh_nlp import __version__
from rmesh_nlp.cli.inputs import (
    parse_delta,
    parse_names,
    parse_quadrature,
    parse_seed,
    parse_settings,
    parse_size,
    parse_weights,
)
from rmesh_nlp.errors import BadInputError, InterruptedSolveError

BAD_INPUT, INTERRUPTED = 2, 130

# typer brings its own click, or uses the installed one: its exceptions are found either way
UsageError = typer.BadParameter.__mro__[1]
ClickException: Any = UsageError.__mro__[1]

app = typer.Typer(add_completion=True, rich_markup_mode=None, pretty_exceptions_enable=False)

Size = Annotated[
    str | None,
    typer.Option(
        "--n", metavar="SIZE", help="Squares per side, 8, or columns by rows, 12x6. Default: the paper's."
    ),
]
Delta = Annotated[
    str | None,
    typer.Option(
        "--delta",
        metavar="D[,D]",
        help="Half-width of the boxes in which nodes move, or two, along x and y. "
        "Default: the paper's, scaled with the mesh width.",
    ),
]
Seed = Annotated[
    str | None,
    typer.Option(
        "--seed", metavar="NUMBER", help="Start from random node positions instead of the given mesh."
    ),
]
Quadrature = Annotated[
    str,
    typer.Option("--quadrature", metavar="RULE", help="Rule for the load: midpoint, or a degree such as 6."),
]
Objective = Annotated[
    str | None,
    typer.Option(
        "--objective",
        metavar="TERMS",
        help="Outer objective: energy (default), certificate (the guaranteed bound of the error, scalar "
        "problems, nested), error-energy, error-l2, error-h1, contact, quality, or a sum such as "
        "error-l2+0.01*quality.",
    ),
]
Objectives = Annotated[
    list[str] | None,
    typer.Option(
        "--objective",
        metavar="TERMS",
        help="Outer objective, as for solve; given several times, all of them stand in one table.",
    ),
]
Seeds = Annotated[
    str | None,
    typer.Option(
        "--seed", metavar="N[,N...]", help="Start from random node positions; several seeds in one table."
    ),
]
Regularisation = Annotated[
    str | None,
    typer.Option(
        "--regularisation",
        metavar="W[,W...]",
        help="Weight of the distortion in the energy, relative to the error of the energy, or a schedule of "
        "weights such as 1,0.1,0.01: for large moves, without boxes.",
    ),
]
Flips = Annotated[
    bool, typer.Option("--flips", help="Flip edges by energy between relocations, until neither gains.")
]
Starts = Annotated[
    int | None,
    typer.Option(
        "--starts", min=1, metavar="N", help="As many random starts besides the given mesh; the best counts."
    ),
]
Levels = Annotated[
    int | None,
    typer.Option(
        "--levels", min=1, max=4, metavar="N", help="Optimise, refine the mesh uniformly, go on, so often."
    ),
]
Relaxation = Annotated[
    str | None,
    typer.Option(
        "--relaxation", metavar="NAME", help="Relaxation of complementarity in mpcc; scholtes by default."
    ),
]
Outer = Annotated[
    str | None,
    typer.Option(
        "--outer",
        metavar="NAME",
        help="Outer solver of nested: newton (default), newton-pair, ipopt, slsqp, trust-constr or l-bfgs-b.",
    ),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        "--time-limit", min=0.001, metavar="SECONDS", help="Of each solve; its best valid mesh then counts."
    ),
]
MaxIterations = Annotated[
    int | None, typer.Option("--max-iterations", min=1, metavar="N", help="Of each solve, likewise.")
]
Tolerance = Annotated[
    float | None,
    typer.Option(
        "--tolerance",
        metavar="NUMBER",
        help="Largest first-order residual, relative to the given mesh, of what is called converged (1e-6).",
    ),
]
Begin = Annotated[
    str | None,
    typer.Option("--start", metavar="NAME", help="given (default), or a strategy whose end is the start."),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="A setting of the strategy, such as tol=1e-8; repeat."),
]
Jobs = Annotated[
    int, typer.Option("--jobs", min=1, metavar="N", help="Processes that solve; more than 1 needs dask.")
]
Repeats = Annotated[
    int,
    typer.Option(
        "--repeats", min=1, metavar="N", help="Solve each N times: tables show medians of times and ranges."
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON to stdout instead of text.")]
Certify = Annotated[
    bool,
    typer.Option("--certify", help="Bound the error in the energy norm, before and after the relocation."),
]
Columns = Annotated[
    int, typer.Option("--columns", min=1, max=2, help="Width of the figures: columns of a printed page.")
]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="A folder that solve, compare or study wrote.")]


def _mpcc_commands() -> ModuleType:
    return importlib.import_module("rmesh_nlp.mpcc.command")


def _commands() -> ModuleType:
    """The module that does the work, loaded only when a command runs: it brings CasADi and all."""
    return importlib.import_module("rmesh_nlp.cli.commands")


def _problem_commands() -> ModuleType:
    """The same for problem files."""
    return importlib.import_module("rmesh_nlp.cli.problem_commands")


def _path_commands() -> ModuleType:
    """The same for load paths."""
    return importlib.import_module("rmesh_nlp.cli.path_commands")


def _study_commands() -> ModuleType:
    """The same for studies."""
    return importlib.import_module("rmesh_nlp.cli.study_commands")


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
    rmesh compare                                     all examples, all strategies
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


@app.command()
def solve(
    example: Annotated[
        str, typer.Argument(metavar="EXAMPLE", help="6.1, 6.2 or 6.3, or a problem file such as my.toml.")
    ],
    formulation: Annotated[
        str | None,
        typer.Option(
            "--formulation",
            "-f",
            help="fixed, nested, joint, mpcc, or one you installed. Default: that of the file, or joint.",
        ),
    ] = None,
    n: Size = None,
    delta: Delta = None,
    seed: Seed = None,
    quadrature: Quadrature = "midpoint",
    objective: Objective = None,
    relaxation: Relaxation = None,
    outer: Outer = None,
    regularisation: Regularisation = None,
    flips: Flips = False,
    starts: Starts = None,
    levels: Levels = None,
    certify: Certify = False,
    time_limit: TimeLimit = None,
    max_iterations: MaxIterations = None,
    tolerance: Tolerance = None,
    start: Begin = None,
    chosen_settings: Set = None,
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
    """Solve one example, or the problem of a file, by one strategy.

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
    settings = _settings(
        n,
        delta,
        quadrature,
        seed,
        objective=objective,
        relaxation=relaxation,
        outer=outer,
        regularisation=parse_weights(regularisation),
        flips=flips or None,
        starts=starts,
        levels=levels,
        time_limit_s=time_limit,
        max_iterations=max_iterations,
        tolerance=tolerance,
        start=start,
        settings=parse_settings(chosen_settings or []) or None,
    )
    voice = "json" if json else "quiet" if quiet else "text"
    if example.endswith(".toml"):
        for name, value in (("--n", n), ("--delta", delta), ("--quadrature", quadrature)):
            if value not in (None, "midpoint"):
                raise BadInputError(f"{name} {value} is for the examples: write it into {example}")
        commands = _problem_commands()
        columns = columns if figures else 0
        chosen = settings["options"]
        raise typer.Exit(commands.solve(Path(example), formulation, chosen, out, certify, voice, columns))
    chosen = {**settings, "certify": certify}
    raise typer.Exit(_commands().solve(example, formulation or "joint", chosen, out, voice))


@app.command()
def path(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A problem file with a table [path].")],
    formulation: Annotated[
        str | None, typer.Option("--formulation", "-f", help="Strategy; default: that of the file.")
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
    raise typer.Exit(_path_commands().path(file, formulation, out))


@app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A problem file.")],
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="Where to draw; default: beside the problem file."),
    ] = None,
) -> None:
    """Validate a problem file, print what it says, draw its mesh with boundary roles and motion.

    A study file is validated with all problems and strategies that it names.

    \b
    rmesh check my.toml
    rmesh check study.toml
    rmesh check my.toml --picture roles.pdf
    """
    raise typer.Exit(_problem_commands().check(file, picture))


@app.command()
def advise(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A problem file.")],
) -> None:
    """Say whether to relocate, to refine, or both, before anything dear is solved.

    Relocates on a coarse mesh, prolongs the map, and refines uniformly twice.

    \b
    rmesh advise my.toml
    """
    raise typer.Exit(_problem_commands().advise(file))


@app.command()
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The file to write.")],
    study: Annotated[bool, typer.Option("--study", help="A study file instead of a problem file.")] = False,
) -> None:
    """Write a commented template of a problem file, or of a study; it solves as it is.

    \b
    rmesh new my.toml
    rmesh new --study study.toml
    """
    raise typer.Exit(_study_commands().new(file) if study else _problem_commands().new(file))


@app.command()
def study(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A study file.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")],
    jobs: Jobs = 1,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="A running dask scheduler: tcp://host:8786."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the plan and a guess of its time.")
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Solve every problem of a study by every strategy: many solves, one row each.

    Writes rows to DIR/rows, one file per worker, and fields to DIR/solutions. Run the same command
    again after any end: it goes on where it was. Then rmesh table DIR, figures DIR and report DIR.

    \b
    rmesh new --study study.toml
    rmesh study study.toml --out first --dry-run
    rmesh study study.toml --out first --jobs 2
    rmesh study study.toml --out first --scheduler tcp://login1:8786
    """
    raise typer.Exit(_study_commands().study(file, out, jobs, scheduler, dry_run, json, quiet))


@app.command()
def compare(
    examples: Annotated[
        list[str] | None, typer.Argument(help="Examples, or problem files; the three examples by default.")
    ] = None,
    formulations: Annotated[
        str,
        typer.Option(
            "--formulations",
            metavar="NAMES",
            help="Strategies, separated by commas; options of their own as in mpcc:start=joint.",
        ),
    ] = "fixed,nested,joint,mpcc",
    n: Size = None,
    delta: Delta = None,
    seed: Seeds = None,
    quadrature: Quadrature = "midpoint",
    objective: Objectives = None,
    relaxation: Relaxation = None,
    outer: Outer = None,
    regularisation: Regularisation = None,
    flips: Flips = False,
    starts: Starts = None,
    levels: Levels = None,
    certify: Certify = False,
    time_limit: TimeLimit = None,
    max_iterations: MaxIterations = None,
    tolerance: Tolerance = None,
    start: Begin = None,
    chosen_settings: Set = None,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")] = Path("results"),
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep the rows in DIR that succeeded and solve only the others.")
    ] = False,
    jobs: Jobs = 1,
    repeats: Repeats = 1,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare strategies: solve, table and draw.

    Writes DIR/records.jsonl, DIR/table.md, .tex, .csv, DIR/figures and DIR/solutions.
    An option goes to those strategies that take it. Problem files are compared with uniform refinements
    of their meshes as well, so that you see what moving nodes is worth. What an earlier run left in DIR
    is moved to DIR/previous when the first solve has ended.

    \b
    rmesh compare
    rmesh compare my.toml --formulations fixed,nested --out mine
    rmesh compare 6.1 --formulations fixed,nested,joint --n 16 --out fine
    rmesh compare --out results --resume
    """
    settings = _settings(
        n,
        delta,
        quadrature,
        seed,
        objective=objective,
        relaxation=relaxation,
        outer=outer,
        regularisation=parse_weights(regularisation),
        flips=flips or None,
        starts=starts,
        levels=levels,
        time_limit_s=time_limit,
        max_iterations=max_iterations,
        tolerance=tolerance,
        start=start,
        settings=parse_settings(chosen_settings or []) or None,
    )
    names = tuple(dict.fromkeys(examples or ()))
    raise typer.Exit(
        _commands().compare(
            names,
            parse_names("--formulations", formulations),
            {**settings, "certify": certify, "repeats": repeats},
            out,
            resume,
            jobs,
            "json" if json else "quiet" if quiet else "text",
        )
    )


@app.command()
def table(folder: Folder) -> None:
    """Make the tables of DIR again.

    Writes DIR/table.md, DIR/table.tex and DIR/table.csv from the records, without solving.

    \b
    rmesh table results
    """
    _commands().table(folder)


@app.command(
    add_help_option=False, context_settings={"ignore_unknown_options": True, "allow_extra_args": True}
)
def mpcc(context: typer.Context) -> None:
    """Solve mathematical programs with complementarity constraints from files.

    \b
    rmesh mpcc --help
    rmesh mpcc problem.nl
    """
    raise typer.Exit(_mpcc_commands().main(context.args))


@app.command()
def report(folder: Folder) -> None:
    """Make one self-contained HTML page of DIR: tables, profiles, convergence, meshes with a slider.

    Writes DIR/report.html, without solving; it needs no network and no server.

    \b
    rmesh report results
    """
    _study_commands().report(folder)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")] = Path(
        "reproduction"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="One random start instead of 40.")] = False,
    quiet: Quiet = False,
) -> None:
    """Derive again every statement about the paper's figures: printed value, ours, met or not, and why.

    Writes DIR/reproduction.md and DIR/reproduction.html. Exit code 0 if all statements could be
    examined, also where a printed value cannot be met.

    \b
    rmesh reproduce --out reproduction
    rmesh reproduce --quick --out reproduction
    """
    raise typer.Exit(_study_commands().reproduce(out, quick, quiet))


@app.command()
def export(
    folder: Folder,
    parquet: Annotated[Path, typer.Option("--parquet", metavar="FILE", help="The Parquet file to write.")],
) -> None:
    """Write the rows of DIR, joined by key, as a Parquet file for pandas, DuckDB or R.

    \b
    rmesh export results --parquet rows.parquet
    """
    _study_commands().export(folder, parquet)


@app.command()
def figures(folder: Folder, columns: Columns = 2) -> None:
    """Make the figures of DIR again.

    Writes PNG and PDF files to DIR/figures from the saved solutions, without relocating again. Of a
    problem file they are those of rmesh solve, before and after.

    \b
    rmesh figures results
    rmesh figures results/my --columns 1
    """
    raise typer.Exit(_problem_commands().figures(folder, columns))


def _settings(
    n: str | None, delta: str | None, quadrature: str, seed: str | None, **given: Any
) -> dict[str, Any]:
    """Keyword arguments of :func:`~rmesh_nlp.campaign.cases.make_cases`; options not given are left out."""
    seeds = [] if seed is None else [parse_seed(text.strip()) for text in seed.split(",")]
    options: dict[str, Any] = {"seed": seeds[0] if len(seeds) == 1 else seeds or None, **given}
    return {
        "n": None if n is None else parse_size(n),
        "delta": None if delta is None else parse_delta(delta),
        "quadrature": parse_quadrature(quadrature),
        "options": {name: value for name, value in options.items() if value not in (None, [])},
    }


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code; what is wrong is said in one line on stderr."""
    command: Any = get_command(app)
    try:
        return int(command.main(args=arguments, prog_name="rmesh", standalone_mode=False) or 0)
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
