"""Kill campaigns at random moments and fill their disk: nothing finished is lost, nothing doubled.

Each round starts ``campaign.run`` with ``resume`` in a process of its own and ends it by ``kill -9`` after a
random time, or gives it a limit on the size of files (``RLIMIT_FSIZE``), at which the system takes a part of
a write and then refuses, as a full disk does. After each round the folder is read by this script's own code.

    python scripts/soak_files.py                      50 kills and 10 short writes, some ten minutes
    python scripts/soak_files.py --kills 3 --short-writes 2 --seed 1
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

WORK = """
import resource, sys
from pathlib import Path
from rmesh_nlp.campaign.cases import make_cases
from rmesh_nlp.campaign.run import run
from rmesh_nlp.io.results import Results

cases = [case for n in (3, 4, 5) for case in make_cases(["6.2", "6.3"], ["fixed", "joint"], n=(2 * n, n))]
print("ready", flush=True)
limit = int(sys.argv[2])
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
for record in run(cases, Results(Path(sys.argv[1])), resume=True):
    pass
"""
CASES = 12


def begin(folder: Path, limit: int = 0) -> subprocess.Popen[str]:
    """A campaign in ``folder`` that is about to solve."""
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", WORK, str(folder), str(limit)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


def rows_of(folder: Path) -> dict[str, str]:
    """Lines by key of the rows that are whole.

    Raises
    ------
    AssertionError
        If a key is there twice, a line but the last is broken, or a success has no fields.
    """
    path = folder / "records.jsonl"
    text = path.read_text() if path.exists() else ""
    lines = text.split("\n")[:-1]  # what follows the last line break is a row that was cut
    rows = [json.loads(line) for line in lines]
    twice = [key for key, count in Counter(row["key"] for row in rows).items() if count > 1]
    assert not twice, f"doubled: {twice}"
    for row in rows:
        if row["success"]:
            ElementTree.parse(folder / "solutions" / f"{row['key']}.vtu")
            assert (folder / "solutions" / f"{row['key']}.csv").stat().st_size > 0, row["key"]
    return {row["key"]: line for row, line in zip(rows, lines, strict=True) if row["success"]}


def survives(before: dict[str, str], folder: Path, what: str) -> dict[str, str]:
    """The rows now; all that were there before are."""
    after = rows_of(folder)
    lost = [key for key, line in before.items() if after.get(key) != line]
    assert not lost, f"{what}: lost {lost}"
    return after


def soak(kills: int, short_writes: int, seed: int) -> str:
    """Run all rounds; returns what was seen."""
    rng = random.Random(seed)
    rounds = ["kill"] * kills + ["short"] * short_writes
    rng.shuffle(rounds)
    seen: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "results"
        began = time.monotonic()
        finish(folder)
        whole = time.monotonic() - began
        shutil.rmtree(folder)
        rows: dict[str, str] = {}
        for kind in rounds:
            if len(rows) == CASES:  # begin anew: else there is nothing left to lose
                shutil.rmtree(folder)
                rows = {}
            if kind == "kill":
                process = begin(folder)
                time.sleep(rng.uniform(0, 0.5 * whole))
                process.kill()
                process.communicate()
            else:
                sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
                process = begin(folder, limit=int(rng.uniform(0.5, 1.2) * max([2000, *sizes])))
                _, errors = process.communicate(timeout=600)
                seen["refused writes"] += "File too large" in errors
            rows = survives(rows, folder, kind)
            seen[kind] += 1
            seen["rows that survived"] += len(rows)
        finish(folder)
        assert len(survives(rows, folder, "the end")) == CASES
    return ", ".join(f"{count} {what}" for what, count in sorted(seen.items()))


def finish(folder: Path) -> None:
    """Run what is left without disturbance."""
    process = begin(folder)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors


def main(arguments: list[str] | None = None) -> None:
    """Read the command line, soak, say what was seen."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--short-writes", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    print(f"nothing lost, nothing doubled: {soak(given.kills, given.short_writes, given.seed)}")


if __name__ == "__main__":
    main()
