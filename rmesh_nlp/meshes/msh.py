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

NODES = {
    1: {15: 1},
    2: {1: 2, 8: 3, 26: 4},
    3: {2: 3, 9: 6, 20: 9, 21: 10},
    4: {3: 4, 10: 9, 16: 8, 36: 16, 39: 12},
}
"""Nodes of the types of elements that can be used, by their corners, which come first: orders 1 to 3."""

KINDS = {kind: (corners, size) for corners, sizes in NODES.items() for kind, size in sizes.items()}
"""Corners and nodes of each type."""

Parts = tuple[NDArray, NDArray, list[tuple[int, NDArray, list[int]]]]
"""Numbers (n,) and places (n, 3) of nodes; elements of one type: this, their nodes, their physical groups."""


def read_msh(data: bytes) -> FileMesh:
    """The mesh of the content of a file; physical groups are its names.

    Raises
    ------
    ValueError
        If it is damaged, or has elements that are not points, lines, triangles or quadrilaterals.
    """
    version, is_binary, _, *one = _content(data, "MeshFormat").split(maxsplit=3) or (b"1", b"0", b"8")
    order = (">", "<")[one[0].startswith(b"\x01")] if is_binary == b"1" else ""
    tags, points, elements = (_by_entities if float(version) >= 4 else _by_elements)(
        data, float(version), order
    )
    found = re.findall(
        r'^\s*(\d+)\s+(\d+)\s+"(.*)"', _content(data, "PhysicalNames").decode(errors="replace"), re.M
    )
    names = {(int(dimension), int(tag)): name for dimension, tag, name in found}
    index, blocks = positions(tags.astype(np.int64)), list[Block]()
    for kind, nodes, groups in elements:
        corners, _ = KINDS[kind]
        dimension = min(corners, 3) - 1
        named = {
            names.get((dimension, tag), f"{TITLES[dimension]}-{tag}"): ... for tag in map(abs, groups) if tag
        }
        blocks.append(Block(corners, index(nodes.astype(np.int64)), named))
    return FileMesh(points, blocks, names=names.values())


def _content(data: bytes, name: str) -> bytes:
    """What stands between the lines that begin and end a section; nothing if there is none."""
    _, begin, rest = data.partition(b"$%b" % name.encode())
    content, end, _ = rest.partition(b"$%b%b" % (b"END" if name.isupper() else b"End", name.encode()))
    if begin and not end:
        raise _damaged(name)
    return content.partition(b"\n")[2]


def _damaged(name: str) -> BadInputError:
    return BadInputError(f"its ${name} is missing or ends early: write the file again with gmsh")


def _size(kind: int) -> int:
    """Nodes of an element of a type that can be used."""
    if kind not in KINDS:
        raise BadInputError(f"has elements of gmsh's type {kind}: {USABLE}, as gmsh -2 -order 1 does")
    return KINDS[kind][1]


def _by_elements(data: bytes, version: float, order: str) -> Parts:
    """Versions 1 and 2: an element is there once for each of its groups."""
    has_parameters, first = b"$ParametricNodes" in data, version < 2
    section = "NOD" if first else "ParametricNodes" if has_parameters else "Nodes"
    rest, starts, at = _content(data, section).partition(b"\n")[2], list[int](), 0
    if (
        order
    ):  # in words of four bytes: number, place, perhaps the dimension of its entity, this one, parameters
        words = np.frombuffer(rest, f"{order}i4", len(rest) // 4)
        while at < len(words):
            starts.append(at)
            at += 9 + 2 * (words[at + 7] % 3) if has_parameters else 7
        table = words[np.array(starts)[:, None] + np.arange(7)]
        points = np.ascontiguousarray(table[:, 1:]).view(f"{order}f8")
    else:
        table = np.array([line.split()[:4] for line in rest.splitlines()], dtype=float)
        points = table[:, 1:]
    cells = defaultdict[tuple[int, int], list[list[int]]](list)
    rest = _content(data, "ELM" if first else "Elements").partition(b"\n")[2]
    for kind, group, nodes in _in_binary(rest, order) if order else _in_text(rest, 2 if first else 3):
        cells[kind, group].append(nodes)
    elements = [
        (kind, np.array(nodes).reshape(len(nodes), _size(kind)), [group])
        for (kind, group), nodes in cells.items()
    ]
    return table[:, 0], points, elements


def _in_text(rest: bytes, head: int) -> Iterator[tuple[int, int, list[int]]]:
    """Type, group and nodes of each element; after so many words come labels, the group first."""
    for line in rest.splitlines():
        row = [*map(int, line.split())]
        end = 5 if head == 2 else 3 + row[2]
        yield row[1], row[head] * (end > head), row[end:]


def _in_binary(rest: bytes, order: str) -> Iterator[tuple[int, int, list[int]]]:
    """Type, group and nodes of each element; before some of a type it, their number, that of labels."""
    words, at = np.frombuffer(rest, f"{order}i4", len(rest) // 4).tolist(), 0
    while at < len(words):
        kind, count, labels = words[at : at + 3]
        at, width = at + 3, 1 + labels + _size(kind)
        for _ in range(count):
            yield kind, words[at + 1] if labels else 0, words[at + 1 + labels : at + width]
            at += width


def _by_entities(data: bytes, version: float, order: str) -> Parts:
    """Version 4: nodes and elements by entities of the geometry, which have the groups."""
    is_first = version < 4.1
    if is_first and order:
        raise BadInputError("is binary of version 4.0: gmsh OLD.msh -save -format msh41 -o NEW.msh")
    sizes, groups = 2 if is_first else 4, dict[tuple[int, ...], list[int]]()
    for name in ("Entities", "PartitionedEntities"):
        if _content(data, name):
            groups |= _groups(_numbers(data, name, order), name == "Entities", 6 if is_first else 3)
    take, tags, points = _numbers(data, "Nodes", order), list[NDArray](), list[NDArray]()
    for _ in range(take("i8", sizes)[0]):
        *entity, has_parameters = take("i4", 3)
        (count,), width = take("i8"), 3 + has_parameters * entity[is_first]
        if not is_first:
            tags.append(take("i8", count))
        rows = take("f8", count * (width + is_first)).reshape(count, width + is_first)
        if is_first:  # numbers are before places
            tags.append(rows[:, 0])
        points.append(rows[:, is_first : 3 + is_first])
    take, elements = _numbers(data, "Elements", order), list[tuple[int, NDArray, list[int]]]()
    for _ in range(take("i8", sizes)[0]):
        *entity, kind = take("i4", 3).tolist()
        (count,), width = take("i8"), 1 + _size(kind)
        nodes = take("i8", count * width).reshape(count, width)[:, 1:]
        elements.append((kind, nodes, groups.get(tuple(entity[:: -1 if is_first else 1]), [])))
    return np.concatenate(tags), np.vstack(points), elements


def _numbers(data: bytes, name: str, order: str) -> Callable[..., NDArray]:
    """The function that takes the next numbers of a type from a section."""
    content, at = _content(data, name), 0
    words: Any = content if order else np.array(content.split(), dtype=float)

    def take(kind: str, count: int = 1) -> NDArray:
        nonlocal at
        start, at = at, at + count * (np.dtype(kind).itemsize if order else 1)
        if not start <= at <= len(words):
            raise _damaged(name)
        return np.frombuffer(words, order + kind, count, start) if order else words[start:at].astype(kind)

    return take


def _groups(take: Callable[..., NDArray], is_whole: bool, box: int) -> dict[tuple[int, ...], list[int]]:
    """Physical groups of entities, or of their parts, by dimension and number; points have so large a box."""
    groups = dict[tuple[int, ...], list[int]]()
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
