"""Kill workers, scheduler and client of a study at random moments: every solve has one row at the end.

Each round starts ``rmesh study`` and ends something by ``kill -9`` after a random time: the client (with a
local cluster that is the scheduler as well), one of its workers, or a process in which a solve runs. Then
the same command runs again. With ``--speed`` the same solves are first done one after the other in one
process, and the study's time is set against half of theirs; so is the time of as many plain processes side
by side, each with its share of the solves, which is what the machine allows.

    python scripts/soak_study.py                          2000 solves, 20 kills, 2 jobs
    python scripts/soak_study.py --solves 12 --kills 2
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

STUDY = """
random = {{ seed = {seed}, count = {count} }}
strategies = ["fixed", "joint"]
fields = false
"""
RMESH = "from rmesh_nlp.cli.app import main; main()"


def command(folder: Path, jobs: int) -> list[str]:
    """``rmesh study`` as a process of this Python."""
    words = ["study", str(folder / "study.toml"), "--out", str(folder / "out"), "--jobs", str(jobs), "--json"]
    return [sys.executable, "-W", "ignore", "-c", RMESH, *words]


def descendants(pid: int) -> list[int]:
    """Processes below one, by /proc (Linux)."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue  # it has ended
    found, front = [], [pid]
    while front:
        front = [child for child, parent in parents.items() if parent in front]
        found += front
    return found


def rows(folder: Path) -> Counter[str]:
    """How often each key has a whole row, by this script's own reading."""
    found: Counter[str] = Counter()
    for path in (folder / "out").rglob("records*.jsonl"):
        for line in path.read_bytes().split(b"\n")[:-1]:
            found[json.loads(line)["key"]] += 1
    return found


def check(folder: Path, planned: set[str], before: Counter[str]) -> Counter[str]:
    """The rows now: none doubled, none lost, none that was not planned."""
    now = rows(folder)
    doubled = [key for key, count in now.items() if count > 1]
    assert not doubled, f"doubled: {doubled}"
    assert not before.keys() - now.keys(), f"lost: {before.keys() - now.keys()}"
    assert not now.keys() - planned, f"not planned: {now.keys() - planned}"
    return now


def soak(solves: int, kills: int, jobs: int, seed: int, longest: float) -> str:
    """Run all rounds; returns what was seen."""
    rng, seen = random.Random(seed), Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "study.toml").write_text(STUDY.format(seed=0, count=solves // 2))
        plan = subprocess.run(
            [*command(folder, jobs), "--dry-run"], capture_output=True, text=True, check=True
        )
        planned = set(json.loads(plan.stdout)["solves"])
        assert len(planned) == 2 * (solves // 2)
        found: Counter[str] = Counter()
        for _ in range(kills):
            nowhere = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            process = subprocess.Popen(command(folder, jobs), **nowhere)
            time.sleep(rng.uniform(1.0, longest))
            below = descendants(process.pid)
            target = rng.choice([process.pid, *below]) if rng.random() < 0.5 else process.pid
            seen["client" if target == process.pid else "worker or solve"] += process.poll() is None
            with suppress(ProcessLookupError):
                os.kill(target, signal.SIGKILL)
            if target != process.pid:
                time.sleep(rng.uniform(0.0, longest))
                process.kill()
            process.wait()
            found = check(folder, planned, found)
        done = subprocess.run(command(folder, jobs), capture_output=True, text=True, timeout=36000)
        assert done.returncode in (0, 1), done.stderr
        found = check(folder, planned, found)
        assert found.keys() == planned, f"{len(planned - found.keys())} are missing"
        said = json.loads(done.stdout)
    killed = ", ".join(f"{what} killed {count} times" for what, count in sorted(seen.items()))
    kept = f"{len(found)} rows of {len(planned)} solves, none lost, none doubled"
    return f"{kept}; {said['succeeded']} succeeded; {killed}"


def timed(shares: list[tuple[int, int]], jobs: int) -> float:
    """Seconds of studies side by side, each with its seeds from a first one on."""
    with tempfile.TemporaryDirectory() as name:
        commands = []
        for seed, count in shares:
            folder = Path(name) / str(seed)
            folder.mkdir()
            (folder / "study.toml").write_text(STUDY.format(seed=seed, count=count))
            commands.append(command(folder, jobs))
        began = time.perf_counter()
        for process in [subprocess.Popen(each, stdout=subprocess.DEVNULL) for each in commands]:
            process.wait()
        return time.perf_counter() - began


def speed(solves: int, jobs: int) -> str:
    """Time of a study over that of the same solves in one process, divided by the number of jobs."""
    count = solves // 2
    share = -(-count // jobs)
    shares = [(first, min(share, count - first)) for first in range(0, count, share)]
    one, plain, study = timed([(0, count)], 1), timed(shares, 1), timed([(0, count)], jobs)
    half = one / jobs
    times = (
        f"one process {one:.1f} s, {jobs} plain ones {plain:.1f} s, a study with {jobs} jobs {study:.1f} s"
    )
    return f"{times}; over one / {jobs}: plain {plain / half:.2f}, study {study / half:.2f}"


def main(arguments: list[str] | None = None) -> None:
    """Read the command line, soak, say what was seen."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--solves", type=int, default=2000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--longest", type=float, default=40.0, help="seconds until a kill, at most")
    parser.add_argument("--speed", action="store_true", help="time the study against one process")
    given = parser.parse_args(arguments)
    if given.speed:
        print(speed(given.solves, given.jobs))
    print(soak(given.solves, given.kills, given.jobs, given.seed, given.longest))


if __name__ == "__main__":
    main()
