"""Groups of mesh files that meshio reads incompletely or gives to other elements: refused, or warned of."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.meshes.arrays import MeshRepairWarning


def check_groups(kind: str, path: Path) -> None:
    """Look at the groups of a file of a format of meshio; a ValueError says which are not read rightly."""
    text = path.read_bytes().decode("latin-1").replace("\r", "")
    for said in _gmsh(text) if kind == "gmsh" else _abaqus(text.upper()) if kind == "abaqus" else ():
        warnings.warn(said, MeshRepairWarning, stacklevel=4)


def _gmsh(text: str) -> list[str]:
    """Of equal names meshio keeps one, and the first group of a curve or surface.

    Sets that have names are complete in the format 4.1. Binary entities are not looked at.
    """
    names = re.findall(r'^\s*\d+\s+(\d+)\s+"(.*)"', _section(text, "PhysicalNames"), re.M)
    known = [tag for tag, _ in names] if "$MeshFormat\n4.1" in text else []
    entities = _section(text, "Entities")
    sizes, *rows = [line.split() for line in entities.splitlines() if entities.isascii()] or [["0"] * 3]
    first, curves, surfaces = map(int, sizes[:3])
    for row in rows[first : first + curves + surfaces]:
        tags = row[8 : 8 + int(row[7])]
        if len(tags) > 1 and not {tag.lstrip("-") for tag in tags} <= set(known):
            raise ValueError(f"one entity is in the physical groups {', '.join(tags)}: name all, save as 4.1")
    said = "physical groups have one name, {}, and all but one lose it: give each its own"
    return [said.format(name) for name in _repeated([name for _, name in names])]


def _abaqus(text: str) -> list[str]:
    """The k-th set that is named by a block is taken for that of the k-th block, and some are left out."""
    key = {"NODE": "NSET", "ELEMENT": "ELSET", "SURFACE": "NAME", "NSET": "NSET", "ELSET": "ELSET"}
    sets: dict[str, list[str]] = {kind: [] for kind in key}
    left_out = list[str]()
    for kind, words, following in re.findall(r"^\*(\w+)(.*)(?=\s*(.?))", text, re.M):
        if kind in key:
            name = "".join(re.findall(rf"\b{key[kind]}\s*=\s*([^,\s]+)", words))
            sets[kind].append(name)
            if name and (kind in ("NODE", "SURFACE") or (kind == "NSET" and not following.isdigit())):
                left_out.append(name)
    blocks = sets["ELEMENT"]
    if "" in blocks and any(blocks[blocks.index("") :]):
        raise ValueError("has *ELEMENT blocks without ELSET before others with one: give each its own")
    if len(sets["NODE"]) > 1:
        raise ValueError(f"has {len(sets['NODE'])} blocks of *NODE, of which one is read: make one of them")
    for name in _repeated([*filter(None, blocks), *sets["ELSET"]]) + _repeated(sets["NSET"]):
        raise ValueError(f"has the set {name} twice: give each part a name of its own")
    said = "sets are left out: {}; write the numbers of their nodes as *NSET"
    return [said.format(", ".join(left_out))] if left_out else []


def _section(text: str, name: str) -> str:
    return text.partition(f"${name}")[2].partition(f"$End{name}")[0].strip()


def _repeated(names: Sequence[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]
