"""Records as strict lines of JSON, read back with every entry checked by its declaration."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, ValidationError, create_model
from pydantic_core import from_json

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import difference
from rmesh_nlp.io.folder import safe_name
from rmesh_nlp.io.problem_messages import as_text
from rmesh_nlp.settings import Values
from rmesh_nlp.solving.entries import ENTRIES
from rmesh_nlp.solving.entry import EVERY, Count, Number, Seconds
from rmesh_nlp.solving.parts import plain

Record = Values
"""One solve as plain JSON values, see :meth:`rmesh_nlp.solving.solution.Solution.record`."""

Records = Sequence[Record]


def objective_of(record: Record) -> str:
    """What was asked for: the energy also where a distortion was minimised with it."""
    objective = str(record.get("objective", "energy"))
    return "energy" if record.get("regularisation") and objective.startswith("energy") else objective


def has_energy(record: Record) -> bool:
    """Whether energies before and after say something.

    Those of different designs do not compare, and with Coulomb friction another objective stands in the place
    of the energy.
    """
    of_another = record.get("coulomb_residual") is not None and objective_of(record) != "energy"
    return not (record.get("design") or of_another)


def ends_of(record: Record) -> tuple[float | None, float | None]:
    """What was minimised at the start and at the end: the audited energy, or another objective."""
    if objective_of(record) != "energy":
        return record.get("objective_initial"), record.get("objective_value")
    start = record.get("energy_initial_audited")
    return record.get("energy_initial") if start is None else start, record.get("energy_audited")


def gain_of(before: float | None, after: float | None) -> float | None:
    """A fall in per cent of the size at the start."""
    return None if after is None or not before else 100 * difference(before, after) / abs(before)


class DamagedRecordsWarning(UserWarning):
    """A record that was not written to its end is passed over."""


FIELDS: Values = {
    name: (entry.type, ... if entry.presence is EVERY else None) for name, entry in ENTRIES.items()
}
RecordModel = create_model(
    "RecordModel", __config__=ConfigDict(extra="allow", strict=True, allow_inf_nan=False), **FIELDS
)
"""The entries of a record with their types; further ones may come."""

REQUIRED = tuple(entry.name for entry in ENTRIES.values() if entry.presence is EVERY)
"""Entries that every record has."""

MEASURED = tuple(
    name for name in REQUIRED if ENTRIES[name].type in (Number, Count, Seconds) and name != "seed"
)
"""Entries that are numbers in every row of a success; elsewhere they may be null."""


def read_record(text: str, where: str) -> Record:
    """A record from JSON; errors name ``where`` it was read."""
    record = parse_json(text, where)
    if not isinstance(record, dict):
        raise BadInputError(f"{where} is not a record: it holds {type(record).__name__}")
    try:
        RecordModel.model_validate(record)
    except ValidationError as error:
        raise BadInputError(f"{where} is not a record: {_first(error)}") from None
    key = record.get("key")
    if key is not None and key != safe_name(key):
        raise BadInputError(f"{where} is not a record: 'key' = {key!r}: expected the name of a file")
    unknown = [name for name in MEASURED if record["success"] and record.get(name) is None]
    if unknown:
        raise BadInputError(f"{where} is not a record: {unknown[0]!r} must be a number in a row of a success")
    return record


def _first(error: ValidationError) -> str:
    """The first thing that is wrong: the entry's name, what was expected, its value."""
    item = error.errors(include_url=False)[0]
    message = str(item["msg"]).removeprefix("Value error, ")
    name = repr(item["loc"][0])
    if item["type"] == "missing":
        return f"it has no {name}"
    return f"{name} = {as_text(item['input'])}: {message}"


def parse_json(text: str, where: str) -> Any:
    """Strict JSON of moderate depth, without NaN and with text that can be written."""
    try:
        return from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise BadInputError(f"{where} is not JSON that can be read: {error}") from None


def to_json(record: Record, indent: int | None = None) -> str:
    """Strict JSON: what is not a finite number becomes null, an unpaired surrogate a question mark."""
    return json.dumps(plain(record), indent=indent, allow_nan=False)


def read_lines(path: Path) -> list[Record]:
    """The records of one file, without a damaged last line, of which a warning tells.

    A last line is damaged if it has no end, or if it begins like a record, or with a zero as after
    a power cut, and is not JSON. The only line of a file is not passed over for that.
    """
    try:
        content = path.read_bytes() if path.exists() else b""
        start = content.rfind(b"\n", 0, max(len(content) - 1, 0)) + 1
        last = content[start:]
        if last and (not last.endswith(b"\n") or (start and last[:1] in b"{\0" and not _is_json(last))):
            shown = last[:40].decode(errors="replace").strip()
            message = f"{path}: the last line was not written to its end and is passed over: {shown!r}"
            warnings.warn(message, DamagedRecordsWarning, stacklevel=2)
            content = content[:start]
        lines = enumerate(content.decode().split("\n"), 1)
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error
    return [read_record(line, f"{path}, line {i}") for i, line in lines if line.strip()]


def one_per_key(rows: Iterable[Record]) -> list[Record]:
    """One row for each key: the latest of its successes, else of its failures."""
    chosen: dict[Any, Record] = {}
    for position, row in enumerate(rows):
        key = row.get("key", position)
        if row["success"] >= chosen.setdefault(key, row)["success"]:
            chosen[key] = row
    return list(chosen.values())


def _is_json(line: bytes) -> bool:
    with suppress(ValueError):
        from_json(line)
        return True
    return False
