"""Kill solves and clients at random moments, and fill the disk: nothing is lost, nothing doubled.

    python scripts/soak_losses.py                             an hour
    python scripts/soak_losses.py --kills 3 --short-writes 2 --solves 12

Rounds of two kinds. A comparison (``comparison.run`` with ``resume``) is ended by ``kill -9`` after a random
time, or gets a limit on the size of files (``RLIMIT_FSIZE``), at which the system takes a part of a write and
then refuses, as a full disk does. A study (``rmesh study``) loses its client or a process in which a solve
runs, and is started again. After each round the folder is read by this script's own code.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Set
from contextlib import suppress
from pathlib import Path

import psutil  # of dask, as studies by several processes are

from rows import command_line

COMPARISON = """
import resource, sys
from pathlib import Path
from rmesh_nlp.study.comparison import plan_comparison, run
from rmesh_nlp.io.results import Results

sizes = [(6, 3), (8, 4), (10, 5)]
plan = [solve for n in sizes for solve in plan_comparison(["6.2", "6.3"], ["fixed", "joint"], n=n)]
print("ready", flush=True)
limit = int(sys.argv[2])
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
for record in run(plan, Results(Path(sys.argv[1])), resume=True):
    pass
"""
CASES = 12

STUDY = 'random = {{ seed = 0, count = {count} }}\nformulations = ["fixed", "joint"]\nfields = false\n'
RMESH = "from rmesh_nlp.cli.entry import main; main()"


def rows(folder: Path) -> dict[str, str]:
    """Lines by key of the whole rows of a folder. A key that is there twice, or lost fields, end the soak."""
    result: dict[str, str] = {}
    for path in folder.rglob("records*.jsonl"):
        for line in path.read_text().split("\n")[:-1]:  # what follows the last line break was cut
            row = json.loads(line)
            assert row["key"] not in result, f"doubled: {row['key']}"
            result[row["key"]] = line
            if row["success"] and (path.parent / "solutions").exists():
                ElementTree.parse(path.parent / "solutions" / f"{row['key']}.vtu")
                assert (path.parent / "solutions" / f"{row['key']}.csv").stat().st_size > 0, row["key"]
    return result


def survive(before: dict[str, str], folder: Path) -> dict[str, str]:
    """The rows now; all that were there before are, if they were successes unchanged."""
    after = rows(folder)
    kept = {key: line for key, line in before.items() if json.loads(line)["success"]}
    lost = [key for key in before if key not in after or (key in kept and after[key] != kept[key])]
    assert not lost, f"lost: {lost}"
    return after


def begin(folder: Path, limit: int = 0) -> subprocess.Popen[str]:
    """A comparison in ``folder`` that is about to solve."""
    command = [sys.executable, "-W", "ignore", "-c", COMPARISON, str(folder), str(limit)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def finish(folder: Path) -> None:
    """Run what is left of a comparison without disturbance."""
    process = begin(folder)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors


def comparisons(kills: int, short_writes: int, rng: random.Random) -> Counter[str]:
    """Disturb comparisons; returns what was seen."""
    rounds = ["kill"] * kills + ["short write"] * short_writes
    rng.shuffle(rounds)
    seen: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder, began = Path(name) / "results", time.monotonic()
        finish(folder)
        whole, kept_rows = time.monotonic() - began, rows(folder)
        for kind in rounds:
            if len(kept_rows) == CASES:  # begin anew: else there is nothing left to lose
                shutil.rmtree(folder)
                kept_rows = {}
            if kind == "kill":
                process = begin(folder)
                time.sleep(rng.uniform(0, 0.5 * whole))
                process.kill()
                process.communicate()
            else:
                sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
                process = begin(folder, limit=int(rng.uniform(0.5, 1.2) * max([2000, *sizes])))
                _, errors = process.communicate(timeout=600)
                seen["refused write"] += "File too large" in errors
            kept_rows = survive(kept_rows, folder)
            seen[kind] += 1
        finish(folder)
        assert len(survive(kept_rows, folder)) == CASES
    return seen


def study(solves: int, kills: int, jobs: int, longest: float, rng: random.Random) -> Counter[str]:
    """Disturb a study; returns what was seen."""
    seen: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder, kept_rows = Path(name), dict[str, str]()
        (folder / "study.toml").write_text(STUDY.format(count=solves // 2))
        words = ["study", str(folder / "study.toml"), "--out", str(folder / "out"), "--jobs", str(jobs)]
        command = [sys.executable, "-W", "ignore", "-c", RMESH, *words, "--json"]
        plan = subprocess.run([*command, "--dry-run"], capture_output=True, text=True, check=True)
        planned: Set[str] = set(json.loads(plan.stdout)["solves"])
        for _ in range(kills):
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            time.sleep(rng.uniform(1.0, longest))
            below = psutil.Process(process.pid).children(recursive=True)
            every = [process.pid, *(child.pid for child in below)]
            target = rng.choice(every) if rng.random() < 0.5 else process.pid
            seen["client" if target == process.pid else "solve"] += process.poll() is None
            with suppress(ProcessLookupError):
                os.kill(target, signal.SIGKILL)
            if target != process.pid:
                time.sleep(rng.uniform(0.0, longest))
                process.kill()
            process.wait()
            kept_rows = survive(kept_rows, folder / "out")
        done = subprocess.run(command, capture_output=True, text=True, timeout=36000)
        assert done.returncode in (0, 1), done.stderr
        missing = planned ^ survive(kept_rows, folder / "out").keys()
        assert not missing, f"missing or not planned: {missing}"
    return seen


def main(arguments: list[str] | None = None) -> None:
    """Read the command line, soak, say what was seen."""
    parser = command_line(__doc__)
    parser.add_argument(
        "--kills", type=int, default=50, help="of comparisons, and a third as many of a study"
    )
    parser.add_argument("--short-writes", type=int, default=10)
    parser.add_argument("--solves", type=int, default=2000, help="of the study")
    parser.add_argument("--jobs", type=int, default=2, help="of the study")
    parser.add_argument("--longest", type=float, default=40.0, help="seconds until the study loses something")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    rng = random.Random(given.seed)
    seen = comparisons(given.kills, given.short_writes, rng)
    seen += study(given.solves, -(-given.kills // 3), given.jobs, given.longest, rng)
    print("nothing lost, nothing doubled:", ", ".join(f"{count} {what}" for what, count in seen.items()))


if __name__ == "__main__":
    main()
