"""Collections of MPCCs in Python: a file with ``names()`` and ``get(name)``.

``get`` returns a dict with ``x f g G H lbx ubx lbg ubg x0`` (CasADi expressions, bounds, a start) and, where
the best value is known, ``target``. The file is run, as Python runs an import.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.reading.problem import Problem


def load_collection(path: Path) -> ModuleType:
    """Import a collection from a file; raises ValueError if it is none."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{path} is not a Python file")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)  # dataclasses look there
    spec.loader.exec_module(module)
    missing = [name for name in ("names", "get") if not callable(getattr(module, name, None))]
    if missing:
        raise ValueError(f"{path}: a collection has a function {missing[0]}()")
    return module


def as_mpcc(problem: Mapping[str, Any]) -> MPCC:
    """The MPCC of a problem of a collection."""
    return MPCC(**{key: problem[key] for key in ("x", "f", "g", "G", "H", "lbx", "ubx", "lbg", "ubg")})


def read_collection(path: Path) -> Iterator[Problem]:
    """The problems of a collection, in its order."""
    module = load_collection(path)
    for name in module.names():
        problem = module.get(name)
        x0 = np.asarray(problem["x0"], dtype=float)
        yield Problem(name, as_mpcc(problem), x0, target=float(problem.get("target", math.nan)))
