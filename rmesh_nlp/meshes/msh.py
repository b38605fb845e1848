"""Files .msh of gmsh of version 4.1, in text and binary, read whole, by this format in its manual."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.meshes.file_mesh import TITLES, USABLE, Block, FileMesh, positions

KINDS = {15: (1, 1), 1: (2, 2), 8: (2, 3), 2: (3, 3), 9: (3, 6), 3: (4, 4), 16: (4, 8), 10: (4, 9)}
"""Corners and nodes of the types of elements that can be used."""

Names = dict[tuple[int, int], str]
"""Names of physical groups by dimension and number."""


def read_msh(data: bytes) -> FileMesh:
    """The mesh of the content of a file of version 4.1; physical groups are its names.

    Raises
    ------
    ValueError
        If it is damaged, or has elements that are not lines, triangles or quadrilaterals of order 1 or 2.
    """
    names = physical_names(data)
    groups = dict(one for name in ("Entities", "PartitionedEntities") for one in _entities(data, name))
    take, tags, points, blocks = _numbers(data, "Nodes"), list[NDArray](), list[NDArray](), list[Block]()
    count, *_ = take("i8", 4)
    for _ in range(count):
        dimension, _, is_parametric = take("i4", 3)
        (size,) = take("i8")
        tags.append(take("i8", size))
        width = 3 + is_parametric * dimension
        points.append(take("f8", size * width).reshape(size, width)[:, :3])
    index, take = positions(np.concatenate(tags)), _numbers(data, "Elements")
    count, *_ = take("i8", 4)
    for _ in range(count):
        dimension, tag, kind = take("i4", 3)
        (size,) = take("i8")
        if kind not in KINDS:
            raise BadInputError(
                f"has {size} elements of gmsh's type {kind}: {USABLE}, as gmsh -2 -order 1 does"
            )
        corners, width = KINDS[kind]
        nodes = take("i8", size * (1 + width)).reshape(size, 1 + width)[:, 1:]
        named = {
            names.get((dimension, one), f"{TITLES[dimension]}-{one}"): ...
            for one in map(abs, groups.get((dimension, tag), ()))
        }
        blocks.append(Block(corners, index(nodes), named))
    return FileMesh(np.vstack(points), blocks, names=names.values())


def physical_names(data: bytes) -> Names:
    """Names of physical groups by dimension and number, in any version."""
    found = re.findall(
        r'^\s*(\d+)\s+(\d+)\s+"(.*)"', _content(data, "PhysicalNames").decode(errors="replace"), re.M
    )
    return {(int(dimension), int(tag)): name for dimension, tag, name in found}


def _content(data: bytes, name: str) -> bytes:
    """What stands between the lines that begin and end a section; nothing if there is none."""
    return (
        data.partition(b"$%b" % name.encode())[2].partition(b"$End%b" % name.encode())[0].partition(b"\n")[2]
    )


def _numbers(data: bytes, name: str) -> Callable[..., NDArray]:
    """The function that takes the next numbers of a type from a section of a text or binary file."""
    _, is_binary, _, *one = _content(data, "MeshFormat").split(maxsplit=3)
    content, at = _content(data, name), 0
    order = (">", "<")[one[0].startswith(b"\x01")] if is_binary == b"1" else ""
    words = content if order else np.array(content.split(), dtype=float)

    def take(kind: str, count: int = 1) -> NDArray:
        nonlocal at
        start, at = at, at + count * (np.dtype(kind).itemsize if order else 1)
        if not start <= at <= len(words):
            raise BadInputError(f"its ${name} is missing or ends early: write the file again with gmsh")
        if isinstance(words, bytes):
            return np.frombuffer(words, order + kind, count, start)
        return words[start:at].astype(kind)

    return take


def _entities(data: bytes, section: str) -> Iterator[tuple[tuple[int, int], list[int]]]:
    """Dimension, number and physical groups of each entity, or part of one, of a section if there is one."""
    if not _content(data, section):
        return
    take, is_whole = _numbers(data, section), section == "Entities"
    if not is_whole:
        _, ghosts = take("i8", 2)
        take("i4", 2 * ghosts)
    for dimension, count in enumerate(take("i8", 4)):
        for _ in range(count):
            tag, *_ = take("i4", 1 if is_whole else 3)
            if not is_whole:
                take("i4", *take("i8"))  # the parts that have it
            take("f8", 6 if dimension else 3)
            yield (dimension, int(tag)), take("i4", *take("i8")).tolist()
            if dimension:
                take("i4", *take("i8"))  # its boundary
