"""Groups of mesh files that meshio reads incompletely or gives to other elements: refused, or warned of."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

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
    groups = _in_binary(data.partition(b"$Entities\n")[2]) if is_binary == "1" else _in_text(text)
    for tags in groups:
        if len(tags) > 1 and not set(map(abs, tags)) <= named_tags:
            raise BadInputError(f"one entity is in the physical groups {tags}: name all, save as 4.1")
    said = "physical groups have one name, {}, and all but one lose it: give each its own"
    return [said.format(name) for name in _repeated([name for _, name in names])]


def _in_text(text: str) -> Iterator[list[int]]:
    """Physical groups of each curve and surface."""
    sizes, *rows = [row.split() for row in _section(text, "Entities").splitlines()] or [["0"] * 4]
    first, curves, surfaces, _ = map(int, sizes)
    for row in rows[first : first + curves + surfaces]:
        yield [int(tag) for tag in row[8 : 8 + int(row[7])]]


def _in_binary(data: bytes) -> Iterator[list[int]]:
    """The same: a tag, a place or box, numbered groups, and from curves on numbered boundaries."""
    at = 32
    for dimension, count in enumerate(np.frombuffer(data[:32], "<u8").tolist()):
        for _ in range(count):
            at += 52 if dimension else 28
            for part in range(1 + (dimension > 0)):
                size = int.from_bytes(data[at : at + 8], "little")
                if part == 0 and dimension:
                    yield np.frombuffer(data, "<i4", size, at + 8).tolist()
                at += 8 + 4 * size


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
