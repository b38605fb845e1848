"""The commands of ``rmesh``, their options and help; what does the work is loaded when one runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from rmesh_nlp import __version__
from rmesh_nlp.cli import load
from rmesh_nlp.cli import options as o

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
        Option("--version", callback=_show_version, is_eager=True, help="Show the version and leave."),
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
    130 after Ctrl-C. Linear algebra takes one thread unless OMP_NUM_THREADS or
    OPENBLAS_NUM_THREADS is set.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def solve(
    context: typer.Context,
    example: Annotated[
        str, Argument(metavar="EXAMPLE|FILE", help="6.1, 6.2 or 6.3, or a problem file such as my.toml.")
    ],
    formulation: Annotated[
        str | None,
        Option(
            "--formulation",
            "-f",
            help="fixed, nested, joint, mpcc, auto, or one you installed. Default: what a file "
            "names, or auto.",
        ),
    ] = None,
    n: o.Size = None,
    delta: o.Delta = None,
    order: o.Order = None,
    seed: o.Seed = None,
    quadrature: o.Quadrature = None,
    objective: o.Objective = None,
    relaxation: o.Relaxation = None,
    regularisation: o.Regularisation = None,
    remesh: o.Remesh = False,
    nodes: o.Nodes = None,
    starts: o.Starts = None,
    accuracy: o.Accuracy = None,
    quantities: o.Quantities = None,
    guaranteed: o.Guaranteed = False,
    certify: o.Certify = False,
    audit: o.Audit = True,
    time_limit: o.TimeLimit = None,
    max_iterations: o.MaxIterations = None,
    tolerance: o.Tolerance = None,
    start: o.Begin = None,
    settings: o.Set = None,
    out: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Folder to write; default: results/<name of the solve>.",
            parser=o.folder_of,
        ),
    ] = None,
    json: o.Json = False,
    quiet: o.Quiet = False,
    figures: Annotated[
        bool,
        Option("--figures/--no-figures", help="Draw before and after to DIR/figures (for a problem file)."),
    ] = True,
    columns: o.Columns = 2,
) -> int:
    """Solve one example, or the problem of a file, by one formulation.

    Writes DIR/record.json, DIR/solution.vtu and DIR/history.csv; for a problem file also the
    relocated mesh DIR/mesh.msh, the series DIR/iterations for ParaView, and DIR/figures: meshes,
    displacement, stress, contact pressure before and after, motion, what limits each node.

    \b
    rmesh solve my.toml --accuracy 1%
    rmesh solve 6.1 --formulation joint --n 8 --delta 0.0275 --out one
    rmesh solve 6.2 --n 12x6 --delta 0.15667,0.07333
    rmesh solve 6.1 --formulation nested --n 32
    rmesh solve 6.1 --order 2
    rmesh solve 6.1 --formulation mpcc --objective error-l2 --relaxation lin-fukushima
    rmesh solve my.toml --formulation nested --certify
    rmesh solve my.toml --remesh
    rmesh solve my.toml --columns 1
    """
    given, voice = o.keywords(context.params), _voice(json, quiet)
    columns = columns if figures else 0
    return load("cli.solving").solve(example, formulation, given, out, voice, columns)


@app.command()
def check(
    file: o.File,
    picture: Annotated[
        Path | None,
        Option(metavar="FILE", help="Where to draw; default: beside the problem file."),
    ] = None,
    order: o.Order = None,
) -> None:
    """Validate a problem file, print what it says, draw its mesh with boundary roles and motion.

    A study file is validated with all problems and formulations that it names. Of a mesh file this prints
    and draws boundaries and subdomains.

    \b
    rmesh check my.toml
    rmesh check body.msh
    rmesh check study.toml
    rmesh check my.toml --picture roles.pdf
    """
    load("cli.preparing").check(file, picture, order)


@app.command()
def advise(file: o.File, order: o.Order = None, json: o.Json = False) -> None:
    """Say what moving nodes, a new mesh and refinement can attain, before anything moves.

    Solves on the given mesh and on its uniform refinement, and moves the nodes of a coarse mesh; factors are
    how many times less the error of the energy is than on the given mesh.

    \b
    rmesh advise my.toml
    rmesh advise my.toml --json
    """
    load("cli.preparing").advise(file, order, json)


@app.command()
def remesh(
    file: o.File,
    nodes: Annotated[
        int | None, Option(min=3, metavar="N", help="Nodes of the new mesh; default: as many.")
    ] = None,
    out: Annotated[
        Path,
        Option(metavar="MESH", help="The mesh to write, a file .msh: it keeps names."),
    ] = Path("mesh.msh"),
    order: o.Order = None,
) -> None:
    """Write a mesh that suits the solution of a problem file, made by Mmg in a few rounds.

    Names of boundaries and subdomains are kept; nodes that cannot move stay. Needs mmgpy.

    \b
    rmesh remesh my.toml --nodes 2000 --out better.msh
    """
    load("cli.preparing").remesh(file, nodes, out, order)


@app.command()
def new(
    file: Annotated[Path, Argument(metavar="FILE", help="The file to write.")],
    study: Annotated[bool, Option("--study", help="A study file instead of a problem file.")] = False,
    mesh: Annotated[
        Path | None, Option(metavar="MESH", help="A mesh file whose names the problem has.")
    ] = None,
    two_bodies: Annotated[bool, Option("--two-bodies", help="A problem of two bodies in contact.")] = False,
) -> None:
    """Write a commented template of a problem file, or of a study; it solves as it is.

    \b
    rmesh new my.toml
    rmesh new my.toml --mesh body.msh
    rmesh new my.toml --two-bodies
    rmesh new --study study.toml
    """
    load("cli.preparing").new(file, study, mesh, two_bodies)


@app.command()
def study(
    file: Annotated[Path, Argument(metavar="FILE", help="A study file.")],
    out: o.Out,
    jobs: o.Jobs = 1,
    scheduler: Annotated[
        str | None,
        Option(metavar="ADDRESS", help="A running dask scheduler: tls://host:8786."),
    ] = None,
    dry_run: Annotated[
        bool, Option("--dry-run", help="Print the plan and its time, at most or by its rows.")
    ] = False,
    retry_failed: Annotated[
        bool, Option("--retry-failed", help="Solve again what has a row that is a failure.")
    ] = False,
    json: o.Json = False,
    quiet: o.Quiet = False,
) -> int:
    """Solve every problem of a study by every formulation: many solves, one row each.

    Writes rows to DIR/rows, one file per worker, and fields to DIR/solutions. Run the same command
    again after any end: it goes on where it was. Then rmesh table DIR, figures DIR and report DIR.

    \b
    rmesh new --study study.toml
    rmesh study study.toml --out first --dry-run
    rmesh study study.toml --out first --jobs 2
    rmesh study study.toml --out first --scheduler tls://login1:8786
    rmesh study study.toml --out first --retry-failed
    """
    work, voice = load("cli.study"), _voice(json, quiet)
    if dry_run:
        work.dry_run(file, out, jobs, voice)
        return 0
    return work.study(file, out, jobs, scheduler, retry_failed, voice)


@app.command()
def compare(
    context: typer.Context,
    examples: Annotated[
        list[str] | None, Argument(help="Examples, or problem files; the three examples by default.")
    ] = None,
    formulations: Annotated[
        str | None,
        Option(
            metavar="NAMES",
            help="Formulations, separated by commas; options of their own as in mpcc:start=joint. Default: "
            "those of fixed, nested, joint, mpcc that take the problem.",
        ),
    ] = None,
    n: o.Size = None,
    delta: o.Delta = None,
    order: o.Order = None,
    seed: o.Seeds = None,
    quadrature: o.Quadrature = None,
    objective: o.Objectives = None,
    relaxation: o.Relaxation = None,
    regularisation: o.Regularisation = None,
    starts: o.Starts = None,
    certify: o.Certify = False,
    audit: o.Audit = True,
    time_limit: o.TimeLimit = None,
    max_iterations: o.MaxIterations = None,
    tolerance: o.Tolerance = None,
    start: o.Begin = None,
    settings: o.Set = None,
    out: o.Out = Path("results"),
    resume: Annotated[
        bool, Option("--resume", help="Keep the rows in DIR that succeeded and solve only the others.")
    ] = False,
    jobs: o.Jobs = 1,
    repeats: o.Repeats = 1,
    figures: o.Figures = True,
    json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
) -> int:
    """Compare formulations: solve, table and draw.

    Prints a row per solve. Writes DIR/records.jsonl, DIR/table.md, .tex, .csv, DIR/figures and DIR/solutions.
    An option goes to those formulations that take it. Problem files are compared with uniform refinements
    of their meshes as well, so that you see what moving nodes is worth; --jobs is for the examples, many
    solves of a file by several processes are a study (rmesh new --study). What an earlier run left in DIR
    is moved to DIR/previous when the first solve has ended.

    \b
    rmesh compare
    rmesh compare my.toml --formulations fixed,nested --out mine
    rmesh compare 6.1 --formulations fixed,nested,joint --n 16 --out fine
    rmesh compare --out results --resume
    """
    names = tuple(dict.fromkeys(examples or ()))
    chosen = () if formulations is None else o.parse_names(formulations)
    given, voice = o.keywords(context.params), _voice(json, quiet)
    work = load("cli.solving").compare
    return work(names, chosen, given, out, resume, jobs, voice, figures, verbose)


@app.command()
def table(folder: o.Folder, verbose: o.Verbose = False) -> None:
    """Make the tables of DIR again.

    Writes DIR/table.md, DIR/table.tex and DIR/table.csv from the records, without solving, and prints
    the main columns. On a screen, columns that do not fit follow below.

    \b
    rmesh table results
    rmesh table results --verbose
    """
    load("cli.reporting").table(folder, verbose=verbose)


@app.command(context_settings={"ignore_unknown_options": True})
def mpcc(
    files: Annotated[
        list[str] | None,
        Argument(metavar="FILE...", help="AMPL .nl, or .json with CasADi Functions as NOSBENCH writes them."),
    ] = None,
    relaxation: Annotated[str, Option(metavar="NAME")] = "scholtes",
    time_limit: o.TimeLimit = None,
    max_iterations: o.MaxIterations = None,
    starts: Annotated[
        int, Option(min=1, metavar="N", help="The lowest of N starts: the file's, random ones.")
    ] = 1,
    start: Annotated[
        Path | None,
        Option(
            metavar="FILE", help="What --json printed for a neighbouring problem: start from its solution."
        ),
    ] = None,
    log: Annotated[bool, Option("--log", help="A line per nonlinear program.")] = False,
    json: o.Json = False,
) -> int:
    """Solve mathematical programs with complementarity constraints from files.

    \b
    rmesh mpcc problem.nl
    rmesh mpcc problem.nl --relaxation kanzow-schwartz --time-limit 30 --log
    rmesh mpcc problem.nl --json > result.json
    rmesh mpcc changed.nl --start result.json
    rmesh-mpcc problem -AMPL relaxation=kanzow-schwartz time_limit_s=30    (writes problem.sol)
    """
    chosen = {"relaxation": relaxation, "starts": starts, "max_iterations": max_iterations}
    if time_limit is not None:
        chosen["time_limit_s"] = time_limit
    return load("cli.mpcc").run(files or [], chosen, log, json, start)


@app.command()
def report(folder: o.Folder) -> None:
    """Make one self-contained HTML page of DIR: tables, profiles, convergence, meshes with a slider.

    Writes DIR/report.html, without solving; it needs no network and no server.

    \b
    rmesh report results
    """
    load("cli.reporting").report(folder)


@app.command()
def reproduce(
    out: o.Out = Path("reproduction"),
    quick: Annotated[bool, Option("--quick", help="One random start instead of 40.")] = False,
    quiet: o.Quiet = False,
) -> None:
    """Derive again every statement about the paper's figures: printed value, ours, met or not, and why.

    Writes DIR/reproduction.md and DIR/reproduction.html. Exit code 0 if all statements could be
    examined, also where a printed value cannot be met.

    \b
    rmesh reproduce --out reproduction
    rmesh reproduce --quick --out reproduction
    """
    load("cli.reporting").reproduce(out, quick, quiet)


@app.command()
def export(
    folder: o.Folder,
    parquet: Annotated[Path, Option(metavar="FILE", help="The Parquet file to write.")],
) -> None:
    """Write the rows of DIR, joined by key, as a Parquet file for pandas, DuckDB or R.

    \b
    rmesh export results --parquet rows.parquet
    """
    load("cli.reporting").export(folder, parquet)


@app.command()
def figures(
    folder: o.Folder,
    columns: o.Columns = 2,
    format: Annotated[str, Option(help="png, pdf or svg; the last two for papers.")] = "png",
) -> None:
    """Make the figures of DIR again.

    Writes files to DIR/figures from the saved solutions, without relocating again. Of a problem file they
    are those of rmesh solve, before and after.

    \b
    rmesh figures results --format pdf
    rmesh figures results/my --columns 1
    """
    reporting = load("cli.reporting")
    reporting.figures(folder, reporting.Page(columns, format))


def _voice(json: bool, quiet: bool) -> str:
    return "json" if json else "quiet" if quiet else "text"
