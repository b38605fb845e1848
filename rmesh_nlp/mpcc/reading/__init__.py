"""Readers of public formats: AMPL ``.nl``, NOSBENCH's JSON, Pyomo models."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

from rmesh_nlp.mpcc.reading.nl import read_nl
from rmesh_nlp.mpcc.reading.nosbench import read_nosbench, write_nosbench
from rmesh_nlp.mpcc.reading.problem import Problem
from rmesh_nlp.mpcc.reading.pyomo_model import read_pyomo

READERS = {".nl": read_nl, ".json": read_nosbench}


def read(source: str | PathLike[str] | Any) -> Problem:
    """Read an MPCC from a file, or from a Pyomo model.

    Parameters
    ----------
    source : path or pyomo.environ.ConcreteModel
        ``.nl``: text form of AMPL's format, with complementarity rows. ``.json``: CasADi Functions as
        NOSBENCH serialises them.

    Raises
    ------
    ValueError
        If the format is unknown or the file malformed; the message names the file, and the line or field.
    OSError
        If the file cannot be read.
    """
    if not isinstance(source, (str, PathLike)):
        if hasattr(source, "component_data_objects"):
            return read_pyomo(source)
        raise ValueError(f"expected a path or a Pyomo model, got {type(source).__name__}")
    path = Path(source)
    try:
        reader = READERS[path.suffix.lower()]
    except KeyError:
        raise ValueError(f"{path}: unknown format {path.suffix!r}; there are {', '.join(READERS)}") from None
    return reader(path)


__all__ = [
    "READERS",
    "Problem",
    "read",
    "read_nl",
    "read_nosbench",
    "read_pyomo",
    "write_nosbench",
]
