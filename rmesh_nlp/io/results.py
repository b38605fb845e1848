"""A folder of results: records, fields and histories, written so that none is ever half there."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.folder import Manifest, read_text, safe_name, write_text
from rmesh_nlp.io.records import (
    Record,
    Records,
    one_per_key,
    read_lines,
    read_record,
    to_json,
)
from rmesh_nlp.solving.parts import HISTORY

if TYPE_CHECKING:
    import pandas as pd

RECORDS, SOLUTIONS = "records.jsonl", "solutions"
RECORD = "record.json"
SINGLE = (RECORD, "solution.vtu", "history.csv")  # the files of a single solve
ROWS = "rows"  # sub-folder of a study with one file of records per worker process
TABLES = ("table.md", "table.tex", "table.csv")


@dataclass(frozen=True)
class Result:
    """A record and where its fields and its history are, if the solve got that far."""

    record: Record
    vtu: Path
    history: Path

    @property
    def is_whole(self) -> bool:
        """Whether both files are there: each was put in place whole."""
        return self.vtu.is_file() and self.history.is_file()

    def steps(self) -> pd.DataFrame:
        """The history, a row for each step, none if there is no file; values that are not known are NaN."""
        import pandas as pd  # loading it takes longer than a small solve

        if not self.history.exists():
            return pd.DataFrame(columns=HISTORY, dtype=float)
        try:
            steps = pd.read_csv(self.history, dtype=float)
            if missing := sorted(set(HISTORY) - set(steps)):
                raise ValueError(f"it has no column {missing[0]!r}")
        except (OSError, ValueError) as error:  # of the decoding as well
            raise BadInputError(f"{self.history} is no history: {error}") from error
        return steps


@dataclass(frozen=True)
class Results:
    """The folder of a comparison: ``records.jsonl`` and, per record, a VTU file and a history."""

    folder: Path

    def result(self, record: Record) -> Result:
        """A record with the places of its files, which are inside the folder whatever it says."""
        vtu, history = self.names(str(record.get("key", "")))
        return Result(record, self.folder / vtu, self.folder / history)

    def names(self, key: str) -> tuple[str, str]:
        """Names of the fields and the history of a key, relative to the folder."""
        stem = f"{SOLUTIONS}/{safe_name(key)}"
        return f"{stem}.vtu", f"{stem}.csv"

    def write(self, records: Records) -> None:
        """Write the records anew: they are all on the disk, or an error says that the old ones are."""
        Manifest(self.folder).claim(RECORDS)
        write_text(self.folder / RECORDS, "".join(to_json(record) + "\n" for record in records))

    def read(self) -> list[Record]:
        """The records, one for each key as in :func:`read_rows`; none if the file is empty or missing."""
        return one_per_key(read_lines(self.folder / RECORDS))


def row_files(folder: Path) -> list[Path]:
    """The files of records of a study, one per worker process."""
    return sorted((folder / ROWS).glob("records*.jsonl"))


def read_rows(folder: Path) -> list[Record]:
    """The rows of a study joined by key: of several with one key the latest success, else the latest."""
    return one_per_key(row for path in row_files(folder) for row in read_lines(path))


def read_results(folder: Path) -> list[Result]:
    """The results of a comparison, of a study, or the one result of a single solve (``record.json``).

    A comparison whose first solve has not ended has none; of anything else a BadInputError is raised.
    """
    if not folder.is_dir():
        raise BadInputError(f"{str(folder)!r} is not a folder")
    results, single = Results(folder), folder / RECORD
    if (folder / RECORDS).exists() or (RECORDS in Manifest(folder).names() and not single.exists()):
        return [results.result(record) for record in results.read()]
    if row_files(folder):
        return [results.result(record) for record in read_rows(folder)]
    if not single.exists():
        raise BadInputError(f"{str(folder)!r} holds neither {RECORDS} nor {RECORD}")
    return [single_result(folder, read_record(read_text(single), str(single)))]


def single_result(folder: Path, record: Record) -> Result:
    """Where a single solve keeps its files."""
    return Result(record, *(folder / name for name in SINGLE[1:]))


def write_history(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a history as CSV, further columns after those of all; what is not known is left empty."""
    further = dict.fromkeys(name for row in rows for name in row if name not in HISTORY)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, [*HISTORY, *further])
        writer.writeheader()
        writer.writerows(rows)
