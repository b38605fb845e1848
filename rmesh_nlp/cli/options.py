"""Options of the commands of ``rmesh``; those that several commands have are stated once."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from rmesh_nlp.cli.inputs import (
    parse_delta,
    parse_quadrature,
    parse_seed,
    parse_settings,
    parse_size,
    parse_weights,
)

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
        help="Half-width of the boxes in which nodes move, or two, along x and y; none for no boxes. "
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
    list[str] | None,
    typer.Option(
        "--seed",
        metavar="N[,N...]",
        help="Start from random node positions; several seeds, or the option repeated, in one table.",
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
        help="Outer solver of nested: newton (default), newton-cg or ipopt.",
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
    typer.Option("--start", metavar="NAME", help="given (default), or a formulation whose end is the start."),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A setting of the formulation, such as tol=1e-8 or newton.forcing=0.2; repeat.",
    ),
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
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print all tables of DIR/table.md instead of the main one.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON to stdout instead of text.")]
Certify = Annotated[
    bool,
    typer.Option("--certify", help="Bound the error in the energy norm, before and after the relocation."),
]
Columns = Annotated[
    int, typer.Option("--columns", min=1, max=2, help="Width of the figures: columns of a printed page.")
]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="A folder that solve, compare or study wrote.")]


@dataclass(frozen=True)
class FormulationOptions:
    """What ``solve`` and ``compare`` say alike of the formulations, as it was typed."""

    relaxation: Relaxation = None
    outer: Outer = None
    regularisation: Regularisation = None
    flips: Flips = False
    starts: Starts = None
    levels: Levels = None
    certify: Certify = False
    time_limit: TimeLimit = None
    max_iterations: MaxIterations = None
    tolerance: Tolerance = None
    start: Begin = None
    chosen_settings: Set = None

    def settings(
        self,
        n: str | None,
        delta: str | None,
        quadrature: str,
        seed: str | None,
        objective: str | list[str] | None,
    ) -> dict[str, Any]:
        """Keywords of :func:`~rmesh_nlp.study.cases.plan_comparison`; options not given are left out."""
        seeds = [] if seed is None else [parse_seed(text.strip()) for text in seed.split(",")]
        options: dict[str, Any] = {
            "seed": seeds[0] if len(seeds) == 1 else seeds or None,
            "objective": objective,
            "relaxation": self.relaxation,
            "outer": self.outer,
            "regularisation": parse_weights(self.regularisation),
            "flips": self.flips or None,
            "starts": self.starts,
            "levels": self.levels,
            "time_limit_s": self.time_limit,
            "max_iterations": self.max_iterations,
            "tolerance": self.tolerance,
            "start": self.start,
            "settings": parse_settings(self.chosen_settings or []) or None,
        }
        return {
            "n": None if n is None else parse_size(n),
            "delta": None if delta is None else parse_delta(delta),
            "quadrature": parse_quadrature(quadrature),
            "options": {name: value for name, value in options.items() if value not in (None, [])},
        }


DEFAULT = FormulationOptions()


def with_formulation_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command that takes the fields of :class:`FormulationOptions` as options, for ``chosen``."""
    hints = get_type_hints(FormulationOptions, include_extras=True)
    shared = [
        inspect.Parameter(
            name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=getattr(DEFAULT, name), annotation=hint
        )
        for name, hint in hints.items()
    ]
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        parameters += shared if parameter.name == "chosen" else [parameter]

    @functools.wraps(command)
    def expanded(**typed: Any) -> None:
        chosen = FormulationOptions(**{parameter.name: typed.pop(parameter.name) for parameter in shared})
        command(**typed, chosen=chosen)

    expanded.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    expanded.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return expanded
