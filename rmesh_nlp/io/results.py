"""A folder of results: records, fields and histories, written so that none is ever half there."""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.record_check import fault

Record = dict[str, Any]
"""One solve as plain JSON values, see :meth:`rmesh_nlp.solution.solution.Solution.record`."""

REQUIRED = (
    "example",
    "formulation",
    "objective",
    "n",
    "delta",
    "status",
    "success",
    "energy_initial",
    "energy",
    "energy_audited",
    "gain",
    "u_min",
    "u_max",
    "min_area_ratio",
    "iterations",
    "contact_solves",
    "wall_time_s",
    "equilibrium_residual",
    "complementarity_residual",
    "stationarity",
    "versions",
    "seed",
)
"""Fields that every record has."""

RECORDS, SOLUTIONS, PREVIOUS = "records.jsonl", "solutions", "previous"
TABLES = ("table.md", "table.tex", "table.csv")
FIGURES = "figures"
HISTORY_FIELDS = (
    "iteration",
    "energy",
    "objective",
    "t",
    "product",
    "biactive",
    "primal_residual",
    "dual_residual",
    "contact_solves",
    "seconds",
)


@dataclass(frozen=True)
class Result:
    """A record and where its fields and its history are, if the solve got that far."""

    record: Record
    vtu: Path
    history: Path

    def steps(self) -> list[dict[str, float]]:
        """The history; values that are not known are NaN."""
        if not self.history.exists():
            return []
        with self.history.open(newline="") as file:
            return [
                {key: float(value) if value else math.nan for key, value in row.items()}
                for row in csv.DictReader(file)
            ]


@dataclass(frozen=True)
class Results:
    """The folder of a campaign: ``records.jsonl`` and, per record, a VTU file and a history.

    Attributes
    ----------
    folder : Path
    """

    folder: Path

    def result(self, record: Record) -> Result:
        """A record with the places of its files."""
        stem = self.folder / SOLUTIONS / str(record.get("key", ""))
        return Result(record, Path(f"{stem}.vtu"), Path(f"{stem}.csv"))

    def append(self, record: Record) -> None:
        """Add a record by one write, forced to the disk: an interruption leaves it whole or out."""
        line = to_json(record) + "\n"
        descriptor = os.open(self.folder / RECORDS, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            os.write(descriptor, line.encode())
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def replace_all(self, records: Sequence[Record]) -> None:
        """Write the records anew."""
        write_text(self.folder / RECORDS, "".join(to_json(record) + "\n" for record in records))

    def set_aside(self) -> None:
        """Move what an earlier run left here to the sub-folder ``previous``, replacing what is there."""
        names = [name for name in (RECORDS, SOLUTIONS, FIGURES, *TABLES) if (self.folder / name).exists()]
        if not names:
            return
        previous = self.folder / PREVIOUS
        shutil.rmtree(previous, ignore_errors=True)
        previous.mkdir()
        for name in names:
            os.replace(self.folder / name, previous / name)

    def read(self) -> list[Record]:
        """The records, oldest first.

        A last line without its end, left by a power cut, is passed over.

        Raises
        ------
        BadInputError
            If there are none, or a line is not a record.
        """
        path = self.folder / RECORDS
        lines = _read_text(path).split("\n")[:-1]
        records = [read_record(line, f"{path}, line {i}") for i, line in enumerate(lines, 1) if line.strip()]
        if not records:
            raise BadInputError(f"{path} holds no records")
        return records


def read_results(folder: Path) -> list[Result]:
    """The results of a campaign, or the one result of a single solve (``record.json``).

    Raises
    ------
    BadInputError
        If the folder holds neither.
    """
    if not folder.is_dir():
        raise BadInputError(f"{str(folder)!r} is not a folder")
    if (folder / RECORDS).exists():
        results = Results(folder)
        return [results.result(record) for record in results.read()]
    single = folder / "record.json"
    if not single.exists():
        raise BadInputError(f"{str(folder)!r} holds neither {RECORDS} nor record.json")
    return [single_result(folder, read_record(_read_text(single), str(single)))]


def single_result(folder: Path, record: Record) -> Result:
    """Where a single solve keeps its files."""
    return Result(record, folder / "solution.vtu", folder / "history.csv")


def read_record(text: str, where: str) -> Record:
    """A record from JSON; an error names ``where`` it was read and what is wrong."""
    try:
        record = json.loads(text)
    except json.JSONDecodeError as error:
        raise BadInputError(f"{where} is not JSON: {error.msg} at character {error.pos}") from error
    if not isinstance(record, dict):
        raise BadInputError(f"{where} is not a record: it holds {type(record).__name__}")
    missing = [name for name in REQUIRED if name not in record]
    if missing:
        raise BadInputError(f"{where} is not a record: it has no {missing[0]!r}")
    wrong = fault(record)
    if wrong is not None:
        raise BadInputError(f"{where} is not a record: {wrong}")
    return record


def write_history(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a history as CSV; what is not known is left empty."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, HISTORY_FIELDS)
        writer.writeheader()
        writer.writerows(rows)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then put it in place at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    write_whole(path, lambda temporary: temporary.write_text(text))


def to_json(record: Record, indent: int | None = None) -> str:
    """Strict JSON: what is not a finite number becomes null."""
    return json.dumps(_plain(record), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _read_text(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error
