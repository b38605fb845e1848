"""Input files .inp of Abaqus and CalculiX: nodes, elements, sets and surfaces of one part, read whole.

By Abaqus' keywords reference; keywords that are not about the mesh are passed over.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError, located
from rmesh_nlp.evaluation import Index
from rmesh_nlp.meshes.file_mesh import USABLE, Block, FileMesh, positions, repeated

FACES = re.compile("(?:CPE|CPS|CPEG|CAX|CGAX|DC2D|DCAX|AC2D|ACAX|STRI|S|M3D|SFM3D|R3D)([3468])[A-Z]*")
LINES = re.compile("([TR][23]D|RAX|B[23]|SAX)([123])[A-Z]*")
"""Types of elements that are triangles and quadrilaterals, and lines."""

LAWS = {"CAX": "axisymmetric", "CPE": "plane-strain", "CPS": "plane-stress"}
"""What types of elements are made for."""

UNREAD = ("NGEN", "NFILL", "NCOPY", "ELGEN", "ELCOPY", "SYSTEM")
"""Keywords that make or move nodes and elements."""

Options = dict[str, str]
Rows = list[list[str]]


def read_inp(path: Path) -> FileMesh:
    """The mesh of a file; sets of elements and of nodes and surfaces are its names.

    Raises
    ------
    ValueError
        If there are several parts, keywords make or move nodes or elements, or their type cannot be used.
    """
    model = Model()
    for word, options, rows in _keywords(path):
        with located(f"*{word} {options.get(word, '')}".strip()):
            model.add(word, options, rows)
    return model.mesh()


def law_of(path: Path) -> str | None:
    """The one of :data:`LAWS` that elements of a file are made for; None if they name none, or several."""
    kinds = {options.get("TYPE", "")[:3].upper() for word, options, _ in _keywords(path) if word == "ELEMENT"}
    laws = [law for kind, law in LAWS.items() if kind in kinds]
    return laws[0] if len(laws) == 1 else None


def _keywords(path: Path, *above: Path) -> Iterator[tuple[str, Options, Rows]]:
    """Keywords of a file and of those that it includes, in capitals, with their options and rows of data."""
    if not path.is_file() or path in above:
        raise BadInputError(f"*INCLUDE of {path}: put this file there, and let none include itself")
    header, rows = "", Rows()
    for line in [*path.read_text("utf-8", "replace").splitlines(), "*"]:
        text = line.strip()
        if text.startswith("*") and not text.startswith("**"):
            word, *given = header.split(",")
            options = {
                key.strip().upper(): value.strip(' "')
                for key, _, value in (one.partition("=") for one in given)
            }
            word = "".join(word.split()).upper()[1:]
            if word == "INCLUDE":
                yield from _keywords(path.parent / options["INPUT"], path, *above)
            else:
                yield word, options, rows
            header, rows = text, []
        elif header.endswith(","):
            header += text
        elif text and not text.startswith("**"):
            rows.append([entry.strip(' "') for entry in text.rstrip(", ").split(",")])


class Model:
    """What the keywords have defined; of a block of elements type, corners, numbers and nodes."""

    def __init__(self) -> None:
        self.nodes, self.blocks = [np.zeros((0, 4))], list[tuple[str, int, Index, Index]]()
        self.sets = defaultdict[tuple[str, str], list[NDArray]](list)  # by kind and name in capitals
        self.names, self.part, self.of_part = dict[str, str](), "", set[tuple[str, str]]()
        self.surfaces = list[tuple[Options, Rows]]()

    def add(self, word: str, options: Options, rows: Rows) -> None:
        """Define what a keyword does."""
        if word in UNREAD or options.get("SYSTEM", "R").upper() != "R" or (word == "INSTANCE" and rows):
            raise BadInputError("makes or moves nodes or elements: write out all of them, in x and y")
        if word in ("PART", "INSTANCE"):
            if self.part == word:
                raise BadInputError(
                    "is there twice: one part with one instance is read, write a flat input file"
                )
            self.part = word
        elif word == "ENDPART":
            self.of_part = {*self.sets}
        elif word == "NODE":
            nodes = np.array([[entry or "0" for entry in [*row, "", ""][:4]] for row in rows], dtype=float)
            self.nodes.append(nodes)
            self.define("NSET", options, nodes[:, 0].astype(np.int64))
        elif word == "ELEMENT":
            corners, size = _shape(options.get("TYPE", "").upper())
            numbers = np.array([entry for row in rows for entry in row if entry], dtype=np.int64)
            table = numbers.reshape(-1, 1 + size)
            nodes = table[:, 1 :: size - 1 if corners == 2 else 1]  # of a line the ends
            self.blocks.append((options["TYPE"].upper(), corners, table[:, 0], nodes))
            self.define("ELSET", options, table[:, 0])
        elif word in ("NSET", "ELSET"):
            self.define(word, options, self.listed(word, options, rows))
        elif word == "SURFACE":
            self.surfaces.append((options, rows))

    def define(self, kind: str, options: Options, numbers: NDArray) -> None:
        """Add members to the set that the options name, if they do."""
        if name := options.get(kind):
            if (kind, name.upper()) in self.of_part:
                raise BadInputError(f"{name} is a set of the part too: rename one of them")
            self.sets[kind, name.upper()].append(numbers)
            self.names.setdefault(name.upper(), name)

    def listed(self, kind: str, options: Options, rows: Rows) -> NDArray:
        """The numbers that a set lists by numbers, ranges and names of sets."""
        if "GENERATE" in options:
            return np.concatenate(
                [np.arange(a, b + 1, *step) for a, b, *step in (map(int, row) for row in rows)]
            )
        members = [self.found(kind, entry) for row in rows for entry in row if entry]
        if kind == "NSET" and "ELSET" in options:
            chosen = self.found("ELSET", options["ELSET"])
            members += [nodes[np.isin(numbers, chosen)].ravel() for _, _, numbers, nodes in self.blocks]
        return np.concatenate(members)

    def found(self, kind: str, entry: str) -> NDArray:
        """Members of a set by its name, or one by its number, perhaps with an instance before it."""
        name = entry.rpartition(".")[2].upper()
        if name.isdecimal():
            return np.array([int(name)])
        if (kind, name) not in self.sets:
            raise BadInputError(f"there is no {kind} {entry} before it")
        return np.concatenate(self.sets[kind, name])

    def mesh(self) -> FileMesh:
        """All that is defined."""
        nodes, blocks = np.vstack(self.nodes), list[Block]()
        index, sets = positions(nodes[:, 0]), {"ELSET": dict[str, NDArray](), "NSET": dict[str, NDArray]()}
        for (kind, name), members in self.sets.items():
            sets[kind][self.names[name]] = np.concatenate(members)
        for _, corners, numbers, cells in self.blocks:
            groups = {name: np.isin(numbers, chosen) for name, chosen in sets["ELSET"].items()}
            blocks.append(
                Block(corners, index(cells), {n: members for n, members in groups.items() if members.any()})
            )
        for options, rows in self.surfaces:
            with located(f"*SURFACE {options.get('NAME')}"):
                if options.get("TYPE", "").upper() == "NODE":
                    sets["NSET"][options["NAME"]] = np.concatenate(
                        [self.found("NSET", row[0]) for row in rows]
                    )
                else:
                    ends = np.vstack([self.sides(self.found("ELSET", row[0]), *row[1:2]) for row in rows])
                    blocks.append(Block(2, index(ends), {options["NAME"]: ...}))
        known = {name: np.intersect1d(members, nodes[:, 0]) for name, members in sets["NSET"].items()}
        return FileMesh(nodes[:, 1:], blocks, {name: index(members) for name, members in known.items()})

    def sides(self, chosen: NDArray, label: str = "") -> Index:
        """Ends (m, 2) of sides of elements: S1, S2, ..., of shells E1, ..., without a label the free ones."""
        owner, title, ends = list[NDArray](), list[str](), list[NDArray]()
        for kind, corners, numbers, nodes in self.blocks:
            for i in range(corners if corners > 2 else 0):
                owner.append(numbers)
                title += [f"{'SE'[kind[0] in 'SMR']}{i + 1}"] * len(numbers)
                ends.append(nodes[:, [i, (i + 1) % corners]])
        every = np.vstack(ends)
        is_named = np.array(title) == label.upper() if label else ~repeated(every)
        return every[is_named & np.isin(np.concatenate(owner), chosen)]


def _shape(kind: str) -> tuple[int, int]:
    """Corners and nodes of a type of elements."""
    if face := FACES.fullmatch(kind):
        return (4 if face[1] in "48" else 3), int(face[1])
    if line := LINES.fullmatch(kind):
        return 2, int(line[2]) + (line[1][0] in "BS")
    raise BadInputError(f"elements of the type {kind}: {USABLE}")
