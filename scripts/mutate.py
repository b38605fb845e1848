"""Do the tests notice when the code is wrong? Change one thing at a time, and run them.

python scripts/mutate.py --sample 30                     of all modules below, drawn with a seed
python scripts/mutate.py rmesh_nlp/solving/audit.py     all mutants of one file
python scripts/mutate.py rmesh_nlp/solving/audit.py:74  of one line
python scripts/mutate.py --list rmesh_nlp/fem/stress.py  what they are

Each mutant has one change of one expression: a comparison or an arithmetic operator turned, a number
changed, a condition negated, an argument of ``min`` and ``max`` swapped. The quick tests run once under
coverage (``pip install coverage``; ``--map FILE`` keeps what it found, and ``--again`` adds what is new).
Then for each mutant the tests that reach its line run, the shortest first, until one fails or
``--seconds`` of them have run. A change inside a function is made in memory, in a process forked from one
that has collected all tests; a change of a number at the top of a module, or of a default, in a copy of the
checkout.

A mutant that no test notices survives and is printed as file, line, before, after; the exit code is 1 if
more than a tenth do. Some survivors are equivalent to the original, which no test can tell: those listed in
``scripts/mutations_equivalent.json``, each with its reason, are counted apart, and never as killed. See
``docs/notes/mutations.md``.

mutmut 3 works in the same way but leaves numbers at the top of a module alone, and tolerances stand there.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from multiprocessing import connection, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest
from mutation import Mutant, in_a_function, mutants, put_in_place
from mutation_reach import PYTEST, Reach, enter, read_reach, record_reach

ROOT = Path(__file__).resolve().parent.parent

EQUIVALENT = ROOT / "scripts" / "mutations_equivalent.json"
"""Mutants that no test can notice: file, line before and after, reason."""

MODULES = (
    "rmesh_nlp/solving/audit.py",
    "rmesh_nlp/solving/referee.py",
    "rmesh_nlp/solving/solution.py",
    "rmesh_nlp/solving/verdict.py",
    "rmesh_nlp/solving/starts.py",
    "rmesh_nlp/solving/verification.py",
    "rmesh_nlp/programs/reduced.py",
    "rmesh_nlp/contact/sensitivity.py",
    "rmesh_nlp/fem/stress.py",
    "rmesh_nlp/fem/quantities.py",
    "rmesh_nlp/fem/contact_pressure.py",
    "rmesh_nlp/fem/objective_text.py",
    "rmesh_nlp/io/results.py",
    "rmesh_nlp/io/export.py",
    "rmesh_nlp/campaign/run.py",
    "rmesh_nlp/campaign/cases.py",
    "rmesh_nlp/report/columns.py",
    "rmesh_nlp/report/blocks.py",
    "rmesh_nlp/report/stresses.py",
    "rmesh_nlp/mpcc/solver.py",
    "rmesh_nlp/mpcc/homotopy.py",
    "rmesh_nlp/mpcc/finish.py",
    "rmesh_nlp/mpcc/stationarity.py",
    "rmesh_nlp/mpcc/result.py",
)
"""What makes results trustworthy."""

SLOW_IMPORTS = ("casadi", "hypothesis", "matplotlib.pyplot", "meshio", "pandas", "pydantic", "skfem", "typer")
"""Loaded before a process is forked for a mutant of a copy; never this package itself."""

NOT_TRIED = 99
"""Exit code where the tests did not begin: no mutant is killed by that."""

Ended = tuple[Mutant, int]
"""A mutant and the exit code of its tests: 0 if all passed, less the number of a signal that stopped them."""


def survivors_in_copies(
    chosen: Sequence[Mutant], reach: Reach, folder: Path, jobs: int, budget: float
) -> Iterator[Ended]:
    """Tests in copies of the checkout, each with one file changed, ``jobs`` at a time."""
    if not chosen:
        return
    for name in SLOW_IMPORTS:
        import_module(name)
    free = [_copy(folder / f"checkout-{job}") for job in range(jobs)]
    places: dict[Mutant, Path] = {}

    def attempt(mutant: Mutant, tests: Sequence[str]) -> int:
        enter(places[mutant])
        (places[mutant] / mutant.path).write_text(mutant.source)
        code = pytest.main([*PYTEST, "-x", *tests])
        usable = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.INTERRUPTED)
        return int(code) if code in usable else NOT_TRIED

    for mutant, code in _forked(
        chosen, reach, jobs, budget, attempt, lambda m: places.update({m: free.pop()})
    ):
        copy = places.pop(mutant)
        (copy / mutant.path).write_text((ROOT / mutant.path).read_text())
        free.append(copy)
        yield mutant, code


class Collected:
    """A pytest plugin: when all tests are collected, fork for each mutant instead of running them."""

    def __init__(
        self, chosen: Sequence[Mutant], reach: Reach, jobs: int, budget: float, tell: Callable[[Ended], None]
    ) -> None:
        self.chosen, self.reach, self.jobs, self.budget, self.tell = chosen, reach, jobs, budget, tell

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Fork for each mutant; nothing is left to be run."""
        items = {item.nodeid: item for item in session.items}
        reporter = session.config.pluginmanager.getplugin("terminalreporter")

        def attempt(mutant: Mutant, tests: Sequence[str]) -> int:
            import_module(mutant.path.removesuffix(".py").replace("/", "."))
            text = (ROOT / mutant.path).read_text()
            if mutant.source != text:
                put_in_place(mutant, text)
            session.config.pluginmanager.unregister(reporter)
            wanted = [items[test] for test in tests if test in items]
            if not wanted:  # all that reached it are gone, or slow now: nothing notices
                return 0
            for item, following in zip(wanted, [*wanted[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if session.testsfailed:
                    return 1
            return 0

        for ended in _forked(self.chosen, self.reach, self.jobs, self.budget, attempt):
            self.tell(ended)
        return True


def _forked(
    chosen: Sequence[Mutant],
    reach: Reach,
    jobs: int,
    budget: float,
    attempt: Callable[[Mutant, Sequence[str]], int],
    prepare: Callable[[Mutant], object] = lambda _: None,
) -> Iterator[Ended]:
    """Each mutant and the exit code of its tests, ``jobs`` at a time, each in a process of its own."""
    context = get_context("fork")
    running: dict[int, tuple[BaseProcess, Mutant]] = {}
    waiting = list(reversed(chosen))
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            tests = reach.tests(mutant, budget)
            if not tests:
                yield mutant, 0
                continue
            prepare(mutant)
            seconds = sum(reach.seconds[test] for test in tests)
            process = context.Process(target=_try, args=(mutant, tests, seconds, attempt))
            process.start()
            running[process.sentinel] = process, mutant
        for sentinel in connection.wait(list(running)) if running else ():
            assert isinstance(sentinel, int)
            ended, mutant = running.pop(sentinel)
            ended.join()
            yield mutant, int(ended.exitcode or 0)


def _try(
    mutant: Mutant, tests: Sequence[str], seconds: float, attempt: Callable[[Mutant, Sequence[str]], int]
) -> None:
    """Run the tests in this process; it ends with their code, or by a signal where they do not end.

    SIGPROF counts seconds of this process on the processor: a mutant that takes more than three times as
    many as the original loops for ever, whatever else the machine does. SIGALRM counts those of the clock:
    a test that waits, or a busy machine, which proves nothing.
    """
    for name in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(name, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, 10 + 3 * seconds)  # of this processor
    signal.alarm(int(60 + 20 * seconds))  # a test that waits for ever
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    code = NOT_TRIED
    try:
        code = attempt(mutant, tests)
    finally:
        os._exit(code)


def _copy(target: Path) -> Path:
    ignored = shutil.ignore_patterns(".git", "__pycache__", "*.egg-info", ".*_cache", "results", "_build")
    shutil.copytree(ROOT, target, ignore=ignored)
    return target


def _in_memory(
    chosen: Sequence[Mutant],
    reach: Reach,
    folder: Path,
    jobs: int,
    budget: float,
    tell: Callable[[Ended], None],
) -> None:
    enter(_copy(folder / "collected"))
    tests = sorted({test.partition("::")[0] for mutant in chosen for test in reach.tests(mutant, budget)})
    pytest.main([*PYTEST, *tests], plugins=[Collected(chosen, reach, jobs, budget, tell)])


def choose(names: Sequence[str], sample: int | None, seed: int) -> list[Mutant]:
    """All mutants of files and lines, or so many of them."""
    chosen = []
    for name in names:
        path, _, line = name.partition(":")
        if not (ROOT / path).is_file():
            raise ValueError(f"{path} is not a file of this checkout")
        chosen += [m for m in mutants(path, (ROOT / path).read_text()) if line in ("", str(m.line))]
    return chosen if sample is None or sample >= len(chosen) else random.Random(seed).sample(chosen, sample)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw mutants, run the tests on each, and print the survivors."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "files", nargs="*", help="files of the package, or FILE:LINE; default: those listed here"
    )
    parser.add_argument("--sample", type=int, help="so many mutants, drawn at random; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="mutants at a time")
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests per mutant, at most")
    parser.add_argument(
        "--map", type=Path, help="file with the lines that tests reach; what it lacks is added"
    )
    parser.add_argument(
        "--again", nargs="*", help="first add what the map lacks, or record these test files anew"
    )
    parser.add_argument("--list", action="store_true", help="print the mutants, run nothing")
    options = parser.parse_args(arguments)
    try:
        chosen = choose(options.files or MODULES, options.sample, options.seed)
    except ValueError as error:
        parser.error(str(error))
    if options.list:
        print(*chosen, sep="\n")
        return 0
    listed = json.loads(EQUIVALENT.read_text()) if EQUIVALENT.exists() else []
    equivalent = {(entry["file"], entry["before"], entry["after"]) for entry in listed}
    counts: Counter[str] = Counter()

    def tell(ended: Ended) -> None:
        mutant, code = ended
        same = (mutant.path, mutant.before, mutant.after) in equivalent
        word = "killed" if code > 0 else "stopped" if code < 0 else "equivalent" if same else "SURVIVED"
        word = "NOT TRIED" if code in (NOT_TRIED, -signal.SIGALRM) else word
        counts[word] += 1
        print(f"{word:10} {mutant if word == 'SURVIVED' else f'{mutant.path}:{mutant.line}'}", flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["PYTEST_DEBUG_TEMPROOT"] = name  # forked processes do not tidy up after themselves
        reached = (options.map or folder / "reach.json").absolute()
        if options.again is not None or not reached.exists():
            arguments_of = _copy(folder / "covered"), reached, options.again or []
            mapping = get_context("fork").Process(target=record_reach, args=arguments_of)
            mapping.start()
            mapping.join()
        reach = read_reach(reached, ROOT)
        inside = [m for m in chosen if in_a_function(m, (ROOT / m.path).read_text())]
        outside = [m for m in chosen if m not in inside]
        for ended in survivors_in_copies(outside, reach, folder, options.jobs, options.seconds):
            tell(ended)
        output = sys.stdout
        if inside:
            _in_memory(inside, reach, folder, options.jobs, options.seconds, tell)
        sys.stdout = output
    killed = counts["killed"] + counts["stopped"]
    print(f"{killed} of {len(chosen)} mutants killed ({100 * killed / max(len(chosen), 1):.1f} %)")
    print(
        f"{counts['equivalent']} equivalent, {counts['SURVIVED']} survived, {counts['stopped']} ran too long"
    )
    if counts["NOT TRIED"]:
        print(
            f"{counts['NOT TRIED']} were not tried, or not to an end by the clock: they count as not killed"
        )
    return 1 if len(chosen) - killed - counts["equivalent"] > 0.1 * len(chosen) else 0


if __name__ == "__main__":
    raise SystemExit(main())
