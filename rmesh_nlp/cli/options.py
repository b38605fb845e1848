"""Options that several commands have, each stated once, and what may be written there.

Nothing heavy is imported here. What depends on the problem (an odd number of columns, say) it checks itself.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.settings import ByName, Values, from_texts

Size = Annotated[
    str | None,
    Option(metavar="SIZE", help="Squares per side, 8, or columns by rows, 12x6. Default: the paper's."),
]
Delta = Annotated[
    str | None,
    Option(
        metavar="D[,D]",
        help="Move limits of the nodes, or two, along x and y; none for no limits. "
        "Default: the paper's, scaled with the mesh width.",
    ),
]
Order = Annotated[
    int | None,
    Option(
        min=1,
        max=2,
        metavar="1|2",
        help="Displacements: 1 linear on each triangle, 2 quadratic. Default: 1; of a file its own.",
    ),
]
Seed = Annotated[
    int | None,
    Option(min=0, metavar="NUMBER", help="Start from random node positions instead of the given mesh."),
]


def parse_quadrature(text: str) -> str | int:
    """``midpoint`` or a degree."""
    return int(text) if text.isdecimal() else text


Quadrature = Annotated[
    str | None,
    Option(
        metavar="RULE",
        parser=parse_quadrature,
        help="Rule for the load: midpoint, or a degree such as 6. Default: midpoint, the paper's; with "
        "--order 2 one that is exact or of degree 8.",
    ),
]
Objective = Annotated[
    str | None,
    Option(
        metavar="TERMS",
        help="Outer objective: energy (default), error-energy, error-l2, error-h1, contact, quality, "
        "compliance, area, a quantity such as 'mean(top, -uy)' or 'level-pressure(bottom)', or a sum such "
        "as error-l2+0.01*quality.",
    ),
]
Objectives = Annotated[
    list[str] | None,
    Option(
        metavar="TERMS",
        help="Outer objective, as for solve; given several times, all of them stand in one table.",
    ),
]
Seeds = Annotated[
    list[int] | None,
    Option(
        min=0,
        metavar="NUMBER",
        help="Start from random node positions; given several times, all of them stand in one table.",
    ),
]
Regularisation = Annotated[
    str | None,
    Option(
        metavar="W[,W...]",
        help="Weight of the distortion in the energy, relative to the error of the energy, or a schedule of "
        "weights such as 1,0.1,0.01: for relocation without move limits.",
    ),
]
Remesh = Annotated[
    bool,
    Option(
        "--remesh",
        help="Begin on a mesh that Mmg makes for the solution, with as many nodes: for relocation without "
        "absolute move limits. Needs mmgpy.",
    ),
]
Nodes = Annotated[int | None, Option(min=3, metavar="N", help="--remesh with so many nodes.")]
Starts = Annotated[
    int | None,
    Option(min=1, metavar="N", help="As many random starts besides the given mesh; the best counts."),
]
Relaxation = Annotated[
    str | None,
    Option(metavar="NAME", help="Relaxation of complementarity in mpcc; scholtes by default."),
]
TimeLimit = Annotated[
    float | None,
    Option(
        min=0.001,
        metavar="SECONDS",
        help="Of each solve; its best result so far then counts.",
    ),
]
MaxIterations = Annotated[int | None, Option(min=1, metavar="N", help="Of each solve, likewise.")]
Tolerance = Annotated[
    float | None,
    Option(
        metavar="NUMBER",
        help="Largest first-order residual, relative to the given mesh, of what is called converged (1e-6).",
    ),
]
Begin = Annotated[
    str | None,
    Option(metavar="NAME", help="given (default), or a formulation whose end is the start."),
]
Set = Annotated[
    list[str] | None,
    Option(
        "--set",
        metavar="NAME=VALUE",
        help="Any option or setting by its name, such as tol=1e-8 or newton.forcing=0.2; repeat.",
    ),
]
Jobs = Annotated[int, Option(min=1, metavar="N", help="Processes that solve.")]
Repeats = Annotated[
    int,
    Option(min=1, metavar="N", help="Solve each N times: tables show medians of times and ranges."),
]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Say nothing but errors.")]
Verbose = Annotated[bool, Option("--verbose", "-v", help="Print all columns, as DIR/table.md has them.")]
Json = Annotated[bool, Option("--json", help="Print JSON to stdout instead of text.")]
Accuracy = Annotated[
    str | None,
    Option(
        metavar="SHARE",
        help="Refine where the errors of quantities are made until all are estimated to be below this share, "
        "1% or 0.01: formulation adaptive, of order 2 unless the file or --order says 1.",
    ),
]
Quantities = Annotated[
    list[str] | None,
    Option(
        "--quantity",
        metavar="TEXT",
        help="What --accuracy is for, such as 'resultant(bottom)', 'pressure(bottom, x)', 'peak(bottom)', "
        "'mean(top, -uy)' or energy; repeat. Default: the normal force of each contact boundary, of a tool "
        "under a force its displacement.",
    ),
]
Guaranteed = Annotated[
    bool, Option("--guaranteed", help="Half the width of guaranteed bounds decides on --accuracy.")
]
Certify = Annotated[
    bool,
    Option("--certify", help="Bound the error in the energy norm, before and after the relocation."),
]
Audit = Annotated[
    bool,
    Option(
        "--audit/--no-audit",
        help="Measure the energy of the continuous problem; without, no success is claimed.",
    ),
]
Columns = Annotated[int, Option(min=1, max=2, help="Width of the figures: columns of a printed page.")]
Folder = Annotated[Path, Argument(metavar="DIR", help="A folder that solve, compare or study wrote.")]
File = Annotated[Path, Argument(metavar="FILE", help="A problem file.")]


def folder_of(text: str) -> Path:
    """A folder by its name; an empty one would be the current folder."""
    if not str(text).strip():  # a default is a path already
        raise BadInputError("--out needs the name of a folder, got an empty text")
    return Path(text)


Out = Annotated[Path, Option(metavar="DIR", help="Folder to write.", parser=folder_of)]
Figures = Annotated[
    bool,
    Option("--figures/--no-figures", help="Draw to DIR/figures; rmesh figures DIR does it later."),
]


def parse_names(text: str) -> tuple[str, ...]:
    """The value of ``--formulations``, separated by commas: without repetitions, in the order given."""
    names = [part.strip() for part in text.split(",")]
    if not all(names):
        raise BadInputError(f"--formulations must be names separated by commas, got {text!r}")
    return tuple(dict.fromkeys(names))


ABOUT = ("n", "delta", "order", "quadrature", "certify", "repeats")
"""Keywords of :func:`~rmesh_nlp.study.comparison.plan_comparison` beside the options of a formulation."""

LIMITS = {"time_limit": "seconds", "max_iterations": "iterations"}
"""By the fields of :class:`rmesh_nlp.optimize.budget.Limits`."""

OPTIONS = (
    "seed",
    "objective",
    "relaxation",
    "regularisation",
    "remesh",
    "starts",
    "tolerance",
    "start",
    "accuracy",
    "quantities",
    "guaranteed",
)


def keywords(typed: ByName) -> Values:
    """Keywords of :func:`~rmesh_nlp.study.comparison.plan_comparison`: what was given to a command."""
    given = {k: v for k, v in typed.items() if not (v is None or v is False or v in ([], ()))}
    chosen = from_texts(given.get("settings", ())) | {name: given[name] for name in OPTIONS if name in given}
    if not typed.get("audit", True):
        chosen["audit"] = False
    if "nodes" in given:
        if not typed.get("remesh"):
            raise BadInputError(f"--nodes {given['nodes']} is for --remesh")
        chosen["remesh"] = given["nodes"]
    if limits := {field: given[name] for name, field in LIMITS.items() if name in given}:
        chosen["limits"] = {**chosen.get("limits", {}), **limits}
    return {"options": chosen, **{name: given[name] for name in ABOUT if name in given}}
