"""What ``rmesh check``, ``rmesh new`` and ``rmesh solve my.toml`` do."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from rmesh_nlp.cli.commands import exit_code, read_quietly, say_certificate
from rmesh_nlp.cli.commands import figures as draw_all
from rmesh_nlp.cli.folders import writable
from rmesh_nlp.cli.study_commands import check as check_study
from rmesh_nlp.contact.setup_warnings import setup_warnings
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.display import rich_table
from rmesh_nlp.errors import BadInputError, InterruptedSolveError
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.io import kept_problem
from rmesh_nlp.io.export import Series, write_mesh
from rmesh_nlp.io.files import safe_name, write_new, write_whole
from rmesh_nlp.io.problem_file import build, read_table, template
from rmesh_nlp.io.problem_messages import one_line
from rmesh_nlp.io.problem_schema import ProblemTable
from rmesh_nlp.io.records import to_json
from rmesh_nlp.io.results import Results, write_single
from rmesh_nlp.mapping import Mobility
from rmesh_nlp.meshes import MeshRepairWarning
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.checks import check_unknowns
from rmesh_nlp.report.pictures import PICTURES, Drawable, draw_problem, write_pictures
from rmesh_nlp.report.style import Page
from rmesh_nlp.solving.advice import advise as advice
from rmesh_nlp.solving.clock import deferred
from rmesh_nlp.solving.formulation import find
from rmesh_nlp.solving.options import accepted
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.study import comparison as campaign
from rmesh_nlp.study.cases import FLAGS, Case
from rmesh_nlp.study.progress import CampaignProgress
from rmesh_nlp.study.study_file import is_study

SUCCESS = 0
FILES = ("record.json", "solution.vtu", "history.csv", "mesh.msh")
"""What a solve writes, the series of its iterates aside."""

SERIES_NODES = 200_000
"""Nodes of all frames of a series together: with more, writing them takes longer than the solve."""


def new(path: Path) -> int:
    """Write the commented template; an existing file is never replaced."""
    name = "".join(c if c.isalnum() or c in "-_ ." else "-" for c in path.stem) or "problem"
    try:
        if not path.parent.is_dir():
            raise BadInputError(f"cannot write {path}: there is no folder {str(path.parent)!r}")
        write_new(path, template(name, name + path.suffix))
    except FileExistsError:
        raise BadInputError(f"{path} exists: choose another name") from None
    except OSError as error:
        raise BadInputError(f"cannot write {path}: {error.strerror}") from error
    print(f"wrote {path}; next: rmesh check {path}")
    return SUCCESS


def check(path: Path, picture: Path | None = None) -> int:
    """Validate a problem file, print what it says, draw the mesh with roles and motion; or a study."""
    if is_study(path):
        return check_study(path)
    problem = _load(path)
    _, keywords = _plan(path, None, {})
    parts = discretise(problem)
    free = parts.mesh_map
    rows = problem.summary()
    if "regularisation" in keywords and problem.motion.delta is not None and problem.motion.min_angle == 0:
        rows.append(("regularisation", "a barrier in the place of the least area: areas are only positive"))
    for kind in Mobility:
        rows.append((f"nodes {kind.name.lower()}", str(int((free.mobility == kind).sum()))))
    rows.append(("moves", str(free.n)))
    rows.append(("validity constraints", str(parts.validity.size)))
    try:
        check_unknowns(problem)
        found = [warning.message for warning in setup_warnings(problem)]
    except ValueError as error:
        raise BadInputError(f"{path}: {one_line(error)}") from error
    verdict = f"states a problem, with {len(found)} doubts" if found else "is in order"
    verdict = verdict.removesuffix("s") if len(found) == 1 else verdict
    Console().print(rich_table(f"{path}: problem {problem.name!r} {verdict}", rows))
    _warn(found)
    target = path.with_suffix(".png") if picture is None else picture
    try:
        draw_problem(problem, target)
    except (OSError, ValueError) as error:
        raise BadInputError(f"cannot draw to {target}: {' '.join(str(error).split())}") from error
    print(f"drew {target}")
    return SUCCESS


def advise(path: Path) -> int:
    """Print what relocation and refinement would give for the problem of a file."""
    problem = _load(path)
    try:
        found = advice(problem)
    except ValueError as error:
        raise BadInputError(f"{path}: {one_line(error)}") from error
    Console().print(rich_table(f"{path}: relocate or refine?", found.rows()))
    return SUCCESS


def solve(
    path: Path,
    formulation: str | None,
    options: Mapping[str, Any],
    out: Path | None,
    certify: bool = False,
    voice: str = "text",
    columns: int = 2,
) -> int:
    """Solve the problem of a file; returns the exit code.

    Writes ``record.json``, ``solution.vtu``, ``history.csv``, the relocated mesh ``mesh.msh`` with
    its names, and ``iterations/iterations.pvd`` with its frames where the formulation reports iterates.

    Parameters
    ----------
    options : mapping
        Options given on the command line; they override ``[solve]``. ``None`` means not given.
    certify : bool
        Bound the error of the solution, also if ``[solve]`` does not ask for it.
    voice : str
        What is printed: "text", "json" (the record) or "quiet".
    columns : int
        Columns of a page that figures are wide; 0 for no figures.
    """
    table = read_table(path)
    problem = _load(path, notes=voice == "text")
    name, keywords = _plan(path, formulation, options)
    series = Series(problem, most=max(2, SERIES_NODES // problem.mesh.p.shape[1]))
    case = Case(problem, name, keywords, certify or table.solve.certify)
    watched = not keywords.keys() & {"starts", "levels"}
    folder = Path("results") / safe_name(problem.name) if out is None else out
    with writable(folder, FILES) as results:
        with CampaignProgress(1, quiet=voice != "text") as progress:
            progress.start(case)

            def watch(step: Step) -> None:
                progress.step(step)
                series(step)

            try:
                outcome = campaign.solve(case, watch if watched else progress.step)
            except KeyboardInterrupt:
                raise InterruptedSolveError("nothing was written") from None
        if outcome.record["status"] == "refused":
            raise BadInputError(f"{path}: {outcome.record['message']}")
        with deferred() as interrupted:
            _write(results, outcome, series, path, table)
        try:
            if interrupted():
                raise KeyboardInterrupt
            if columns and outcome.solution is not None and outcome.record["status"] != campaign.INTERRUPTED:
                draw(results, outcome.solution, Page(columns))
        except KeyboardInterrupt:
            raise InterruptedSolveError(
                f"all but the figures is kept in {folder}; rmesh figures {folder} draws them"
            ) from None
        names = [name for name in (*FILES, "iterations", "figures") if (folder / name).exists()]
    if voice == "json":
        print(to_json(outcome.record))
    elif voice == "text":
        _print(outcome, case, folder, names)
    return exit_code([outcome.record], folder)


def _print(outcome: campaign.Outcome, case: Case, folder: Path, names: Sequence[str]) -> None:
    if outcome.solution is None:
        print(
            f"{case.problem.name} {case.formulation}: {outcome.record['status']}: {outcome.record['message']}"
        )
    else:
        Console().print(outcome.solution)
        _warn(outcome.record.get("warnings") or [])
        say_certificate(outcome)
    print(f"wrote {folder}: {', '.join(names)}")


def _write(
    results: Results, outcome: campaign.Outcome, series: Series, path: Path, table: ProblemTable
) -> None:
    """Put the files of a solve in place, the record last; what an earlier solve left goes first."""
    folder, solution, manifest = results.folder, outcome.solution, results.manifest
    manifest.remove(name for name in manifest.names() if name.startswith(("iterations/", "figures/")))
    manifest.claim(*FILES, *kept_problem.names(table))
    kept_problem.keep(path, table, folder)
    if solution is not None:
        write_whole(folder / "mesh.msh", lambda aside: write_mesh(solution.mesh, aside))
        if series.frames:
            manifest.claim(*(f"iterations/{name}" for name in series.names()))
            series.write(folder / "iterations", pressure=np.asarray(solution.pressure))
    write_single(folder, outcome.record, lambda places: campaign.save(outcome, places))


def draw(results: Results, solution: Drawable, page: Page) -> list[Path]:
    """Draw a solution before and after, if it is one."""
    if not np.all(np.isfinite(solution.displacement)):
        return []
    drawn = [f"{name}.{kind}" for name in PICTURES for kind in ("png", "pdf")]
    results.manifest.claim(*(f"figures/{name}" for name in drawn))
    place = results.folder / "figures"
    place.mkdir(exist_ok=True)
    return write_pictures(solution, place, page)


def figures(folder: Path, columns: int) -> int:
    """Draw what is in a folder again; for a problem file before and after as well."""
    single = folder / "record.json"
    if (folder / kept_problem.PROBLEM).exists() and single.exists():
        (result,) = read_quietly(folder)
        kept = kept_problem.read_kept(folder, result.record)
        if kept is not None:
            with writable(folder) as results:
                paths = draw(results, kept, Page(columns))
            print(f"{len(paths)} files in {folder / 'figures'}")
            return SUCCESS
    draw_all(folder)
    return SUCCESS


def _warn(messages: Sequence[str]) -> None:
    for message in messages:
        print(f"warning: {message}")


def _plan(path: Path, formulation: str | None, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Formulation and keywords of ``[solve]``, overridden by what is given on the command line.

    Raises
    ------
    BadInputError
        If there is no such formulation or objective, or the formulation does not take a keyword.
    """
    plan = read_table(path).solve
    name = formulation or plan.formulation
    try:
        find(name)
    except BadInputError as error:
        raise BadInputError(str(error) if formulation else f"{path}: solve.formulation: {error}") from error
    wanted = plan.model_dump(exclude={"formulation", "certify"})
    wanted.update({key: value for key, value in options.items() if value is not None})
    if options.get("objective") is None:
        try:
            parse_objective(plan.objective)
        except ValueError as error:
            raise BadInputError(f"{path}: solve.objective: {one_line(error)}") from error
    # the defaults need not be known to every formulation, what was asked for must be
    default = {"objective": "energy", "starts": 0, "levels": 0, "flips": False}
    asked = {key for key, value in wanted.items() if value != default.get(key)}
    taken = accepted(name, asked)
    asked -= set(FLAGS) - taken  # a limit of what is finite anyway is none
    refused = asked - taken
    if refused:
        raise BadInputError(f"{path}: the formulation {name!r} takes no {sorted(refused)[0]}")
    return name, {key: wanted[key] for key in asked}


def _load(path: Path, notes: bool = True) -> ContactProblem:
    """The problem of a file; repairs of its mesh are printed as notes."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshRepairWarning)
        problem = build(read_table(path), path)
    for warning in caught:
        if notes and issubclass(warning.category, MeshRepairWarning):
            print(f"note: {path}: {warning.message}")
    return problem
