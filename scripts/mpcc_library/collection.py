"""Collections of MPCCs in Python: a file with ``names()`` and ``get(name)``.

``get`` returns a dict with ``x f g G H lbx ubx lbg ubg x0`` (CasADi expressions, bounds, a start) and, where
the best value is known, ``target``. The file is run, as Python runs an import.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.reading import Problem


def read_collection(path: Path) -> Iterator[Problem]:
    """The problems of a collection, in its order; raises ValueError if the file is none."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{path} is not a Python file")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)  # dataclasses look there
    spec.loader.exec_module(module)
    for name in module.names():
        found = module.get(name)
        program = {key: found[key] for key in ("x", "f", "g", "G", "H", "lbx", "ubx", "lbg", "ubg")}
        x0, target = np.asarray(found["x0"], dtype=float), float(found.get("target", math.nan))
        yield Problem(name, MPCC(**program), x0, target=target)
