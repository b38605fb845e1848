"""Files .msh of gmsh of versions 1, 2, 4.0 and 4.1, in text and binary (4.0 in text), read whole.

By the file formats in gmsh's reference manual, earlier ones included.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.meshes.file_mesh import TITLES, USABLE, Block, FileMesh, positions

KINDS = {
    15: (1, 1),
    1: (2, 2), 8: (2, 3), 26: (2, 4),
    2: (3, 3), 9: (3, 6), 21: (3, 10),
    3: (4, 4), 10: (4, 9), 16: (4, 8), 36: (4, 16),
}  # fmt: skip
"""Corners, which come first, and nodes of the types of elements that can be used: orders 1 to 3."""

DAMAGED = "is damaged or ends early: write it again with gmsh"

Groups = dict[tuple[int, int], list[int]]
"""Physical groups by dimension and number of the entity that has them."""

Parts = tuple[NDArray, list[Any]]
"""Number and place (n, 4) of nodes; elements of one type each: this, their nodes, their physical groups."""


def read_msh(data: bytes) -> FileMesh:
    """The mesh of the content of a file; physical groups are its names.

    Raises
    ------
    ValueError
        If it is damaged, or has elements that are not points, lines, triangles or quadrilaterals.
    """
    version, is_binary, *_ = _content(data, b"MeshFormat").split() or (b"1", b"0")
    order = "<" if is_binary == b"1" else ""
    if order and (b"4" <= version < b"4.1" or b"$ParametricNodes" in data):
        raise BadInputError(
            "is binary of version 4.0 or has parameters: gmsh OLD.msh -save -format msh41 -o NEW.msh"
        )
    table, elements = (_by_entities if version >= b"4" else _by_elements)(data, version, order)
    titles = _content(data, b"PhysicalNames").decode(errors="replace")
    names = {
        (int(dimension), int(tag)): name
        for dimension, tag, name in re.findall(r'^\s*(\d+)\s+(\d+)\s+"(.*?) *"\s*$', titles, re.M)
    }
    index, blocks = positions(table[:, 0]), list[Block]()
    for kind, nodes, groups in elements:
        corners, _ = KINDS[kind]
        dimension = min(corners, 3) - 1
        named = {
            names.get((dimension, tag), f"{TITLES[dimension]}-{tag}"): ... for tag in map(abs, groups) if tag
        }
        blocks.append(Block(corners, index(nodes), named))
    return FileMesh(table[:, 1:], blocks, names=[*names.values()])


def _content(data: bytes, name: bytes) -> bytes:
    """What stands between the lines that begin and end a section; nothing if there is none."""
    _, begin, rest = data.partition(b"$" + name)
    content, end, _ = rest.partition((b"$END" if name.isupper() else b"$End") + name)
    if begin and not end:
        raise BadInputError(DAMAGED)
    return content.partition(b"\n")[2]


def _size(kind: int) -> int:
    """Nodes of an element of a type that can be used."""
    if kind not in KINDS:
        raise BadInputError(f"has elements of gmsh's type {kind}: {USABLE}, as gmsh -2 -order 1 does")
    return KINDS[kind][1]


def _by_elements(data: bytes, version: bytes, order: str) -> Parts:
    """Versions 1 and 2: an element is there once for each of its groups."""
    in_nodes, in_elements = (b"NOD", b"ELM") if version < b"2" else (b"Nodes", b"Elements")
    rest = (_content(data, in_nodes) or _content(data, b"ParametricNodes")).partition(b"\n")[2]
    if not rest:
        raise BadInputError(DAMAGED)
    if order:
        records = np.frombuffer(rest, [("tag", "<i4"), ("at", "<f8", 3)], len(rest) // 28)
        table = np.column_stack([records["tag"], records["at"]])
    else:
        table = np.loadtxt(rest.splitlines(), usecols=range(4), ndmin=2)
    count, _, rest = _content(data, in_elements).partition(b"\n")
    cells = defaultdict[Any, list[list[int]]](list)
    for kind, group, nodes in _in_binary(rest) if order else _in_text(rest, version < b"2"):
        cells[kind, group].append(nodes)
    if sum(map(len, cells.values())) != int(count or 0):
        raise BadInputError(DAMAGED)
    return table, [
        (kind, np.array(rows).reshape(len(rows), _size(kind)), [group])
        for (kind, group), rows in cells.items()
    ]


def _in_text(rest: bytes, is_first: bool) -> Iterator[tuple[int, int, list[int]]]:
    """Type, group and nodes of each element; labels are before these, the group first."""
    for line in rest.splitlines():
        _, kind, *row = map(int, line.split())
        end = 3 if is_first else 1 + row[0]
        yield kind, row[not is_first] * (end > 1), row[end:]


def _in_binary(rest: bytes) -> Iterator[tuple[int, int, list[int]]]:
    """Type, group and nodes of each element; before some of a type it, their number, that of labels."""
    words, at = np.frombuffer(rest, "<i4", len(rest) // 4).tolist(), 0
    while at < len(words):
        kind, count, labels = words[at : at + 3]
        at, width = at + 3, 1 + labels + _size(kind)
        for _ in range(count):
            yield kind, words[at + 1] * (labels > 0), words[at + 1 + labels : at + width]
            at += width


def _by_entities(data: bytes, version: bytes, order: str) -> Parts:
    """Version 4: nodes and elements by entities of the geometry, which have the groups."""
    groups, parts, is_first = Groups(), Groups(), version < b"4.1"
    for name in (b"Entities", b"PartitionedEntities"):
        if _content(data, name):
            parts = _groups(_numbers(data, name, order), name == b"Entities", 6 if is_first else 3)
            groups |= parts
    size, turned = (2, -1) if is_first else (4, 1)
    take, tables, elements = _numbers(data, b"Nodes", order), list[NDArray](), list[Any]()
    for _ in range(take("i8", size)[0]):
        *entity, has_parameters = take("i4", 3)
        (count,), width = take("i8"), 3 + has_parameters * entity[is_first]
        if is_first:
            rows = take("f8", count * (1 + width)).reshape(-1, 1 + width)
        else:
            rows = np.column_stack([take("i8", count), take("f8", count * width).reshape(-1, width)])
        tables.append(rows[:, :4])
    take = _numbers(data, b"Elements", order)
    for _ in range(take("i8", size)[0]):
        *entity, kind = take("i4", 3).tolist()
        (count,), width = take("i8"), 1 + _size(kind)
        nodes = take("i8", count * width).reshape(-1, width)[:, 1:]
        place = tuple(entity[::turned])
        elements.append((kind, nodes, groups.get(place, [])))
        parts.pop(place, None)
    for (dimension, tag), names in parts.items():
        if dimension == 2 and names:  # the file has one part of a mesh, or one was not meshed
            raise BadInputError(f"surface {tag} of a physical group has no elements: save all in one file")
    return np.vstack(tables), elements


def _numbers(data: bytes, name: bytes, order: str) -> Callable[..., NDArray]:
    """The function that takes the next numbers of a type from a section."""
    content, at = _content(data, name), 0
    words: Any = content if order else np.array(content.split(), dtype=float)

    def take(kind: str, count: int = 1) -> NDArray:
        nonlocal at
        start, at = at, at + count * (np.dtype(kind).itemsize if order else 1)
        if not start <= at <= len(words):
            raise BadInputError(DAMAGED)
        return np.frombuffer(words, order + kind, count, start) if order else words[start:at].astype(kind)

    return take


def _groups(take: Callable[..., NDArray], is_whole: bool, box: int) -> Groups:
    """Groups of entities, or of their parts; of the box of a point there are so many numbers."""
    groups = Groups()
    if not is_whole:
        _, ghosts = take("i8", 2)
        take("i4", 2 * ghosts)
    for dimension, count in enumerate(take("i8", 4)):
        for _ in range(count):
            tag, *_ = take("i4", 1 if is_whole else 3)
            if not is_whole:
                take("i4", *take("i8"))  # the parts that have it
            take("f8", 6 if dimension else box)
            groups[dimension, int(tag)] = take("i4", *take("i8")).tolist()
            if dimension:
                take("i4", *take("i8"))  # its boundary
    return groups
