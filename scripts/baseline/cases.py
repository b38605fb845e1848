"""The cases: examples, random and aimed contact problems, designs, MPCCs, templates and the gallery.

Each case makes its problem when it is run, by the generators of the other scripts, and calls what is public,
so that the same cases run on an older and on a newer version of the package.
"""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

import rmesh_nlp as rm
from gallery import free_boundary, kinks, mpcc_traps, of_file, signorini, stick_slip
from mpcc_library import labels
from mpcc_library.bilevel_problems import PROBLEMS as BILEVEL
from mpcc_library.bilevel_problems import get as bilevel
from mpcc_library.families import FAMILIES
from mpcc_library.large import LARGE
from random_designs import random_design
from rmesh_nlp.examples.random_problems import random_problem
from truth import draws

FORMULATIONS = ("fixed", "nested", "joint", "mpcc", "auto")
WITHOUT_ENERGY = ("fixed", "nested", "mpcc", "auto")

End = dict[str, object]
"""How a case ended: ``status``, ``success``, ``label``, ``value`` and counts, see :func:`of_record`."""


@dataclass(frozen=True)
class Case:
    """A solve to be repeated, with the same name in every version; its seconds count to a formulation."""

    name: str
    group: str
    formulation: str
    run: Callable[[], End]
    quick: bool


def keys_of(record: Mapping[str, object], prefix: str = "") -> list[str]:
    """Names of a record's entries, those of tables within it dotted; versions of libraries do not count."""
    names: list[str] = []
    for key, value in record.items():
        names.append(prefix + key)
        if isinstance(value, Mapping) and key != "versions":
            names += keys_of(value, f"{prefix}{key}.")
    return sorted(names)


def of_record(record: Mapping[str, object]) -> End:
    """What is kept of a record: what was minimised, and six digits of every measured number."""
    of_energy = record["objective"] == "energy"
    numbers = {
        key: float(f"{value:.6g}")
        for key, value in record.items()
        if isinstance(value, float) and not key.endswith(("_time_s", "_residual", "tolerance"))
    }
    return {
        "keys": keys_of(record),
        "status": record["status"],
        "success": record["success"],
        "label": record["stationarity"],
        "value": record["energy_audited" if of_energy else "objective_value"],
        "iterations": record["iterations"],
        "contact_solves": record["contact_solves"],
        "numbers": numbers,
    }


def contact(problem: Callable[[], rm.ContactProblem], formulation: str, **how: object) -> End:
    """Solve a contact problem."""
    return of_record(rm.solve(problem(), formulation, **how).record())


def design(seed: int, formulation: str) -> End:
    """Solve a random design problem from the design as given."""
    drawn = random_design(seed)
    return of_record(rm.solve(drawn.problem, formulation, objective=drawn.objective).record())


def drawn(number: int, aimed: bool, order: int = 1) -> End:
    """Solve a problem of ``truth.draws`` by the formulation that was drawn with it."""
    data = replace(draws.aimed()[number] if aimed else draws.random(number), order=order)
    return of_record(rm.solve(data.problem(), data.formulation, certify=data.certify).record())


def command(*words: str) -> End:
    """``rmesh solve``; ``FILE`` stands for the template of ``rmesh new``."""
    with tempfile.TemporaryDirectory() as folder:
        file, out = str(Path(folder) / "template.toml"), Path(folder) / "out"
        if "FILE" in words:
            _rmesh("new", file)
        _rmesh("solve", *(file if word == "FILE" else word for word in words), "--out", str(out), "-q")
        return of_record(json.loads((out / "record.json").read_text(encoding="utf-8")))


def _rmesh(*words: str) -> None:
    (rmesh,) = entry_points(group="console_scripts", name="rmesh")
    sys.argv = ["rmesh", *words]
    with contextlib.suppress(SystemExit):
        rmesh.load()()


def mpcc(program: Callable[[], tuple[rm.MPCC, object]]) -> End:
    """Solve an MPCC from a start."""
    problem, x0 = program()
    result = rm.solve_mpcc(problem, x0)
    return {
        "keys": [],
        "status": result.status.value,
        "success": result.success,
        "label": result.stationarity,
        "value": result.f,
        "iterations": result.counts.get("ipopt_iterations", 0),
        "contact_solves": 0,
        "numbers": {},
    }


def _of_family(name: str, size: int, seed: int) -> tuple[rm.MPCC, object]:
    problem = {**FAMILIES, **LARGE}[name][0](size, seed)
    return problem.mpcc, problem.x0


def _of_bilevel(name: str) -> tuple[rm.MPCC, object]:
    fields = bilevel(name)
    fields.pop("target")
    start = fields.pop("x0")
    return rm.MPCC(**fields), start


def _near_point(seed: int) -> tuple[rm.MPCC, object]:
    point = (labels.regular, labels.dependent, labels.tangled)[seed % 3](seed, 1, 7)
    return point.mpcc, point.x + 0.3 * np.random.default_rng(seed).uniform(-1, 1, point.x.shape)


def _trap(name: str) -> tuple[rm.MPCC, object]:
    program = mpcc_traps.programs()[name]
    return program, np.zeros(program.x.shape[0])


def _examples() -> Iterator[tuple[str, str, Callable[[], End]]]:
    objectives = {
        "6.1": ("error-l2 + 0.01*quality", "error-h1", "contact", "body(u**2)", "resultant(contact)"),
        "6.2": ("mean(top, -uy)", "compliance", "square(resultant(contact) - 30)"),
        "6.3": ("mean(top, uy**2)", "level-pressure(contact)", "shear(contact)"),
    }
    sizes: dict[str, tuple[object, ...]] = {
        "6.1": (4, 8, 16, 32),
        "6.2": ((6, 3), (12, 6), (20, 10), (32, 16)),
        "6.3": ((6, 3), (12, 6), (20, 10), (32, 16)),
    }
    for example, make in rm.EXAMPLES.items():
        small, paper, *_ = sizes[example]
        for formulation in FORMULATIONS:
            for size in sizes[example]:
                run = partial(contact, partial(make, size), formulation)
                yield f"{example} {size} energy", formulation, run
                run = partial(run, objective="energy + 0.01*quality")
                yield f"{example} {size} weighted", formulation, run
            for objective in objectives[example][: 1 if formulation == "joint" else None]:  # refused by joint
                for size in (small, paper):
                    run = partial(contact, partial(make, size), formulation, objective=objective)
                    yield f"{example} {size} {objective}", formulation, run
            variants: dict[str, tuple[Callable[[], rm.ContactProblem], dict[str, object]]] = {
                "order 2": (partial(make, small, order=2), {}),
                "no limits": (partial(make, paper, delta="none"), {}),
                "seed 1": (partial(make, paper), {"seed": 1}),
                "certified": (partial(make, small), {"certify": True}),
                "10 iterations": (partial(make, paper), {"limits": rm.Limits(iterations=10)}),
            }
            for name, (problem, how) in variants.items():
                yield f"{example} {name}", formulation, partial(contact, problem, formulation, **how)
        for formulation in ("nested", "joint", "auto"):
            words = [example, "--formulation", formulation]
            run = partial(command, *words, "--delta", "none", "--remesh")
            yield f"{example} --remesh", formulation, run
        problem = partial(make, paper, delta="none")
        yield f"{example} no limits", "cascade", partial(contact, problem, "cascade")


def _random() -> Iterator[tuple[str, str, Callable[[], End]]]:
    for seed in range(100):
        order = 2 if seed % 5 == 4 else 1
        data = draws.random(seed)
        yield f"truth {seed} order {order}", data.formulation, partial(drawn, seed, False, order)
        formulation = FORMULATIONS[1:][seed % 4]
        run = partial(contact, partial(random_problem, seed, order=order), formulation)
        yield f"{seed} order {order}", formulation, run


def _aimed() -> Iterator[tuple[str, str, Callable[[], End]]]:
    for number, data in enumerate(draws.aimed()):
        yield data.name, data.formulation, partial(drawn, number, True)


def _designs() -> Iterator[tuple[str, str, Callable[[], End]]]:
    for seed in range(100, 200):
        for formulation in ("nested", "mpcc"):
            yield f"{seed}", formulation, partial(design, seed, formulation)


def _mpccs() -> Iterator[tuple[str, str, Callable[[], End]]]:
    programs: dict[str, Callable[[], tuple[rm.MPCC, object]]] = {}
    for family, (_, sizes) in FAMILIES.items():
        for size in sizes[:3]:
            programs |= {f"{family} {size} {k}": partial(_of_family, family, size, k) for k in range(6)}
    for family in LARGE:
        programs |= {f"{family} {size} 0": partial(_of_family, family, size, 0) for size in (100, 400)}
    programs |= {name: partial(_of_bilevel, name) for name in BILEVEL}
    programs |= {f"near point {seed}": partial(_near_point, seed) for seed in range(84)}
    for name in ("S", "M, minimum", "M, trap", "C, trap", "W, trap"):
        programs |= {f"trap {name}": partial(_trap, name)}
    yield from ((name, "solve_mpcc", partial(mpcc, program)) for name, program in programs.items())


def _templates() -> Iterator[tuple[str, str, Callable[[], End]]]:
    for formulation in ("fixed", "nested", "joint", "mpcc", "auto"):
        run = partial(command, "FILE", "--formulation", formulation, "--certify")
        yield "rmesh new", formulation, run


def _gallery() -> Iterator[tuple[str, str, Callable[[], End]]]:
    for_energy: dict[str, Callable[[], rm.ContactProblem]] = {
        "free_boundary": partial(free_boundary.problem, 10),
        "hertz": partial(of_file, "hertz", h=0.4, h_contact=0.03),
        "l_shape": partial(of_file, "l_shape", h=0.25),
        "signorini": partial(signorini.problem, 8),
        "wedge": partial(of_file, "wedge", nx=12, ny=3),
    }
    of_quantities: dict[str, tuple[Callable[[], rm.ContactProblem], str]] = {
        "closing_force": (partial(of_file, "closing_force", nx=8, ny=4), "max-pressure(bottom)"),
        "coulomb_kink": (partial(kinks.slab, 6), "mean(top, -uy)"),
        "level_punch": (partial(of_file, "level_punch", nx=8, ny=4), "level-pressure(bottom)"),
        "punch": (partial(of_file, "punch", nx=6, ny=6), "peak-pressure(bottom, 10, 8) + 0.02*quality"),
        "seal": (partial(kinks.seal, 8), "boundary(seal, 1.2*(y + uy) - y)"),
        "stick_slip": (partial(stick_slip.problem, 4), "error-h1"),
    }
    for name, problem in for_energy.items():
        for formulation in FORMULATIONS:
            yield name, formulation, partial(contact, problem, formulation)
    for name, (problem, objective) in of_quantities.items():
        for formulation in WITHOUT_ENERGY:
            yield name, formulation, partial(contact, problem, formulation, objective=objective)


GROUPS: dict[str, tuple[Callable[[], Iterator[tuple[str, str, Callable[[], End]]]], int]] = {
    "examples": (_examples, 3),
    "random": (_random, 5),
    "aimed": (_aimed, 4),
    "designs": (_designs, 5),
    "mpccs": (_mpccs, 3),
    "templates": (_templates, 2),
    "gallery": (_gallery, 4),
}
"""By name: what yields its cases, and of how many the quick subset has one."""


def cases() -> list[Case]:
    """All of them, in a fixed order."""
    return [
        Case(f"{group}: {name} by {formulation}", group, formulation, run, number % every == 0)
        for group, (made, every) in GROUPS.items()
        for number, (name, formulation, run) in enumerate(made())
    ]
