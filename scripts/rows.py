"""What benchmarks share: their command line, rows that are kept as they are measured, tables in Markdown."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from rmesh_nlp.report.table import Table

T = TypeVar("T")
Row = dict[str, Any]


def command_line(doc: str | None, out: str | None = None) -> argparse.ArgumentParser:
    """A parser that shows the docstring of a script; ``out`` is the default of ``--out``, a folder."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if out is not None:
        parser.add_argument("--out", type=Path, default=Path(out), metavar="DIR", help=f"default: {out}")
    return parser


def timed(work: Callable[..., T], *arguments: Any, **settings: Any) -> tuple[T, float]:
    """What ``work`` returns of its arguments, and the processor seconds that it took."""
    began = time.process_time()
    result = work(*arguments, **settings)
    return result, time.process_time() - began


class Store:
    """Rows in a file of JSON lines, or in memory: a run that is broken off goes on where it ended."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
        text = path.read_text(encoding="utf-8") if path is not None and path.exists() else ""
        self.rows: list[Row] = [json.loads(line) for line in text.splitlines()]

    def has(self, **key: Any) -> bool:
        """Whether a row has all these entries."""
        return any(all(row.get(name) == value for name, value in key.items()) for row in self.rows)

    def measure(self, key: Row, work: Callable[[], Iterable[Row]]) -> None:
        """Keep the rows of ``work`` unless one has this key, and print them; an exception is a row."""
        if self.has(**key):
            return
        try:
            measured = list(work())
        except Exception as error:
            measured = [{"status": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}]
        for row in measured:
            self.add({**key, **row})
            print(*self.rows[-1].values(), sep="; ", flush=True)

    def add(self, row: Mapping[str, Any]) -> None:
        """Keep a row."""
        self.rows.append(dict(row))
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(self.rows[-1], default=float) + "\n")


def figure(value: Any) -> str:
    """A cell: three digits of a float, a dash for what is not known."""
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return "-"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.3g}" if abs(value) < 1000 else f"{float(f'{value:.3g}'):.0f}"


def markdown(frame: pd.DataFrame) -> str:
    """The columns of a data frame, cells by :func:`figure`."""
    cells = [[figure(cell) for cell in row] for row in frame.astype(object).itertuples(index=False)]
    return Table([str(name) for name in frame.columns], cells).markdown()
