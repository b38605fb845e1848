"""Groups of mesh files that meshio reads incompletely or gives to other elements: refused, or warned of."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.meshes.arrays import MeshRepairWarning


def check_groups(kind: str, path: Path) -> None:
    """Look at the groups of a file of a format of meshio; a ValueError says which are not read rightly."""
    data = path.read_bytes()
    text = data.decode("latin-1").replace("\r", "")
    for said in _gmsh(text, data) if kind == "gmsh" else _abaqus(text.upper()) if kind == "abaqus" else ():
        warnings.warn(said, MeshRepairWarning, stacklevel=4)


def _gmsh(text: str, data: bytes) -> list[str]:
    """Of equal names meshio keeps one, and the first group of a curve or surface.

    Sets that have names are complete in the format 4.1.
    """
    names = re.findall(r'^\s*\d+\s+(\d+)\s+"(.*)"', _section(text, "PhysicalNames"), re.M)
    version, is_binary, *_ = _section(text, "MeshFormat").split()
    named_tags = {int(tag) for tag, _ in names} if version == "4.1" else set()
    for tags in _groups(text, data if is_binary == "1" else None, 3 if version == "4.1" else 6):
        if len(tags) > 1 and not set(map(abs, tags)) <= named_tags:
            raise BadInputError(f"one entity is in the physical groups {tags}: name all, save as 4.1")
    said = "physical groups have one name, {}, and all but one lose it: give each its own"
    return [said.format(name) for name in _repeated([name for _, name in names])]


def _groups(text: str, binary: bytes | None, of_point: int) -> Iterator[list[int]]:
    """Physical groups of each curve and surface.

    An entity is a tag, a place or box, numbered groups, and from curves on numbered boundaries.
    """
    stream = BytesIO((binary or b"").partition(b"$Entities\n")[2])
    words = iter(_section(text, "Entities").split())

    def taken(kind: str, count: int) -> list[Any]:
        if binary is None:
            return np.array([*islice(words, count)], float).astype(kind).tolist()
        return np.frombuffer(stream.read(count * np.dtype(kind).itemsize), kind).tolist()

    for dimension, entities in enumerate(taken("<u8", 4)):
        for _ in range(entities):
            taken("<i4", 1)
            taken("<f8", 6 if dimension else of_point)
            tags = taken("<i4", *taken("<u8", 1))
            if dimension:
                yield tags
                taken("<i4", *taken("<u8", 1))


def _abaqus(text: str) -> list[str]:
    """The k-th set that is named by a block is taken for that of the k-th block, and some are left out."""
    key = {"NODE": "NSET", "ELEMENT": "ELSET", "SURFACE": "NAME", "NSET": "NSET", "ELSET": "ELSET"}
    sets: dict[str, list[str]] = {kind: [] for kind in key}
    left_out = list[str]()
    for kind, words, following in re.findall(r"^\*(\w+)(.*)(?=\s*(.?))", text, re.M):
        if kind in key:
            name = "".join(re.findall(rf"\b{key[kind]}\s*=\s*([^,]*[^,\s])", words))
            sets[kind].append(name)
            if name and (kind in ("NODE", "SURFACE") or (kind == "NSET" and not following.isdigit())):
                left_out.append(name)
    blocks = sets["ELEMENT"]
    if "" in blocks and any(blocks[blocks.index("") :]):
        raise BadInputError("has *ELEMENT blocks without ELSET before others with one: give each its own")
    if len(sets["NODE"]) > 1:
        raise BadInputError(
            f"has {len(sets['NODE'])} blocks of *NODE, of which one is read: make one of them"
        )
    for name in _repeated([*filter(None, blocks), *sets["ELSET"]]) + _repeated(sets["NSET"]):
        raise BadInputError(f"has the set {name} twice: give each part a name of its own")
    said = "sets are left out: {}; write the numbers of their nodes as *NSET"
    return [said.format(", ".join(left_out))] if left_out else []


def _section(text: str, name: str) -> str:
    return text.partition(f"${name}")[2].partition(f"$End{name}")[0].strip()


def _repeated(names: Sequence[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]
