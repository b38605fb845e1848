"""Kill a study at random moments, and fill the disk: nothing is lost, nothing doubled.

    python scripts/soak_losses.py                             an hour
    python scripts/soak_losses.py --kills 3 --short-writes 2 --solves 12

In each round the study (``rmesh study``) loses its client or a process in which a solve runs, after a random
time, and is started again. In some it gets a limit on the size of files (``RLIMIT_FSIZE``) as well, at which
the system takes a part of a write and then refuses, as a full disk does. After each round the folder is read
by this script's own code.
"""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Sequence, Set
from contextlib import suppress
from pathlib import Path

import psutil  # of dask, as studies by several processes are

from rows import command_line

STUDY = 'random = {{ seed = 0, count = {count} }}\nformulations = ["fixed", "joint"]\n'
RMESH = "from rmesh_nlp.cli.entry import main; main()"


def rows(folder: Path) -> dict[str, str]:
    """Lines by key of the whole rows of a folder. A key that is there twice, or lost fields, end the soak."""
    result: dict[str, str] = {}
    for path in folder.rglob("records*.jsonl"):
        for line in path.read_text().split("\n")[:-1]:  # what follows the last line break was cut
            row = json.loads(line)
            assert row["key"] not in result, f"doubled: {row['key']}"
            result[row["key"]] = line
            if row["success"]:
                ElementTree.parse(folder / "solutions" / f"{row['key']}.vtu")
                assert (folder / "solutions" / f"{row['key']}.csv").stat().st_size > 0, row["key"]
    return result


def survive(before: dict[str, str], folder: Path) -> dict[str, str]:
    """The rows now; all that were there before are, if they were successes unchanged."""
    after = rows(folder)
    kept = {key: line for key, line in before.items() if json.loads(line)["success"]}
    lost = [key for key in before if key not in after or (key in kept and after[key] != kept[key])]
    assert not lost, f"lost: {lost}"
    return after


def limited(size: int) -> Callable[[], None]:
    """What a process begins with whose files have a largest size: a write is done in part, then refused."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def study(solves: int, rounds: Sequence[str], jobs: int, longest: float, rng: random.Random) -> Counter[str]:
    """Disturb a study in rounds, each a "kill" or a "short write"; returns what was seen."""
    seen: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder, kept_rows = Path(name), dict[str, str]()
        (folder / "study.toml").write_text(STUDY.format(count=solves // 2))
        words = ["study", str(folder / "study.toml"), "--out", str(folder / "out"), "--jobs", str(jobs)]
        command = [sys.executable, "-W", "ignore", "-c", RMESH, *words, "--json"]
        plan = subprocess.run([*command, "--dry-run"], capture_output=True, text=True, check=True)
        planned: Set[str] = set(json.loads(plan.stdout)["solves"])
        for kind in rounds:
            sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
            limit = int(rng.uniform(0.5, 1.2) * rng.choice([2000, *sizes]))
            start = limited(limit) if kind == "short write" else None
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            process = subprocess.Popen(command, preexec_fn=start, **quiet)
            with suppress(subprocess.TimeoutExpired):
                process.wait(longest if kind == "short write" else rng.uniform(1.0, longest))
            below = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
            every = [process.pid, *(child.pid for child in below)]
            target = rng.choice(every) if rng.random() < 0.5 else process.pid
            seen["client" if target == process.pid else "solve"] += process.poll() is None
            with suppress(ProcessLookupError):
                os.kill(target, signal.SIGKILL)
            if target != process.pid:
                time.sleep(rng.uniform(0.0, longest))
                process.kill()
            seen["refused write"] += process.wait() == 2  # the exit code of errors in one line
            kept_rows = survive(kept_rows, folder / "out")
            seen[kind] += 1
        done = subprocess.run(command, capture_output=True, text=True, timeout=36000)
        assert done.returncode in (0, 1), done.stderr
        missing = planned ^ survive(kept_rows, folder / "out").keys()
        assert not missing, f"missing or not planned: {missing}"
    return seen


def main(arguments: list[str] | None = None) -> None:
    """Read the command line, soak, say what was seen."""
    parser = command_line(__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--short-writes", type=int, default=10)
    parser.add_argument("--solves", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--longest", type=float, default=40.0, help="seconds until the study loses something")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    rng = random.Random(given.seed)
    rounds = ["kill"] * given.kills + ["short write"] * given.short_writes
    rng.shuffle(rounds)
    seen = study(given.solves, rounds, given.jobs, given.longest, rng)
    print("nothing lost, nothing doubled:", ", ".join(f"{count} {what}" for what, count in seen.items()))


if __name__ == "__main__":
    main()
