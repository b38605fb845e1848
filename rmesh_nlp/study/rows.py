"""Rows of a study: one append-only file per worker process, joined by key.

A worker holds the lock of its file while it solves. Who resumes a study waits for these locks: workers that
outlive their client finish their row first, so that no solve is done twice.
"""

from __future__ import annotations

import os
import socket
import uuid
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout
from pydantic_core import from_json

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.folder import append_whole, write_text
from rmesh_nlp.io.records import Record, to_json
from rmesh_nlp.io.results import ROWS, row_files

HEAD, LOCK = "records-", ".lock"
FAILED = "failed.jsonl"  # rows of failures that were tried again


class RowsFile:
    """The rows of one worker process in the folder of a study; nobody else writes there."""

    def __init__(self, folder: Path) -> None:
        self.name = f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
        self.path = folder / ROWS / f"{HEAD}{self.name}.jsonl"

    @contextmanager
    def working(self) -> Iterator[None]:
        """While a solve is done and its row is written."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        lock = self.path.with_suffix(LOCK)
        with FileLock(lock):
            try:
                yield
            finally:
                with suppress(OSError):  # Windows keeps what is open
                    lock.unlink()

    def append(self, row: Record) -> None:
        """Add a row whole, forced to the disk."""
        append_whole(self.path, to_json(row) + "\n")

    def write_environment(self, text: str) -> None:
        """Note once where this worker runs."""
        write_text(self.path.with_name(f"environment-{self.name}.json"), text)


def keys_of(folder: Path) -> set[str]:
    """Keys of all rows in a folder; a line that is being written, or was cut by a kill, is none."""
    lines = (line for path in row_files(folder) for line in path.read_bytes().split(b"\n")[:-1])
    return {str(_row(line).get("key")) for line in lines}


def _row(line: bytes) -> Record:
    """The row of a line; empty if it is none."""
    with suppress(ValueError):
        row = from_json(line)
        return row if isinstance(row, dict) else {}
    return {}


def set_failures_aside(folder: Path, keys: Collection[str]) -> None:
    """Move the rows of failures among these solves to ``rows/failed.jsonl``, to be solved again.

    No worker may be at work, see :func:`wait_for_workers`. What a formulation refused is no failure.
    """
    for path in row_files(folder):
        kept: list[str] = []
        failed: list[str] = []
        for line in path.read_bytes().split(b"\n")[:-1]:  # a line that a kill has cut is no row
            row = _row(line)
            good = row.get("key") not in keys or row.get("success") or row.get("status") == "refused"
            (kept if good else failed).append(line.decode() + "\n")
        if failed:
            append_whole(folder / ROWS / FAILED, "".join(failed))
            write_text(path, "".join(kept))


def wait_for_workers(folder: Path, seconds: float) -> None:
    """Wait until no worker of an earlier client is solving; a BadInputError if one takes too long."""
    for path in (folder / ROWS).glob(f"{HEAD}*{LOCK}"):
        try:
            with FileLock(path, timeout=seconds), suppress(OSError):
                path.unlink()  # what a worker that was killed has left
        except Timeout:
            raise BadInputError(
                f"{path} is held by a worker of an earlier run, which still solves: wait for it, or end it"
            ) from None
