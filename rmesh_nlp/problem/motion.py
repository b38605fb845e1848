"""What a user says about the motion of nodes; :mod:`rmesh_nlp.mapping` makes outer variables of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

import numpy as np

from rmesh_nlp.display import figure
from rmesh_nlp.errors import BadInputError, require
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.problem.coefficients import as_tuple, convert, each
from rmesh_nlp.settings import Checked, Part, real

BY_BARRIER = "by auto, and with a regularisation: only positive"
"""What becomes of the least area where a distortion is minimised with the energy: it is a barrier."""

RULES = ("pinned", "slides", "free")

Where = str | int
"""A named boundary (or subdomain interface given by a boundary name), or a node number."""


@dataclass(frozen=True)
class Relative:
    """A move limit of ``fraction``, at most 1, times the shortest edge at the node, in both directions."""

    fraction: float

    def __post_init__(self) -> None:
        convert(self)
        must = "be a positive part of the shortest edge at the node, at most 1"
        require(0 < self.fraction <= 1, "relative", must, self.fraction)


@dataclass(frozen=True)
class Motion(Checked):
    """How far nodes may move: the set M of (2.1), (2.2), kept valid.

    Without further rules interior nodes are free, boundary nodes and nodes on interfaces
    between subdomains slide along their straight piece, and corners, ends of named parts,
    points where an interface begins or several meet, and nodes fixed at a value that varies
    with position do not move.

    Parameters
    ----------
    delta : float, (float, float), Relative or None
        Move limits: half-widths around each initial position, in units of length; 0 where no node is
        relocated, None, the default, for no limits: only element validity limits the motion.
    pinned, slides, free : tuples of str or int, or one alone
        Names of boundaries, or node numbers; none by default. Rules for names apply first, then those for
        numbers; among equals ``pinned`` beats ``slides`` beats ``free``. A node slides only
        where its piece is straight. A free node on the outer boundary changes the domain.
    tied : tuple of (int, int)
        Pairs (node, leader): the node moves as its leader does; none by default.
    min_area_fraction : float
        Least signed area of an element, as a fraction of its given one; 0.01 by default. It is a constraint,
        except where a distortion is minimised with the energy: with a ``regularisation``, which ``auto``
        chooses if ``delta`` is None and the objective is the energy. The distortion is a barrier that keeps
        areas positive, also far below this fraction. With a ``min_angle`` both are constraints again.
    min_angle : float
        Least angle of an element in degrees; 0, the default, for none.
    curves : mapping from boundary names to Curve
        Curves that the boundaries were made from; none by default. Their nodes slide along them, and the
        mesh is refined along them. Move limits are then measured along the curve.
    """

    delta: float | tuple[float, float] | Relative | None = None
    pinned: tuple[Where, ...] = ()
    min_area_fraction: Part = 0.01
    slides: tuple[Where, ...] = ()
    free: tuple[Where, ...] = ()
    tied: tuple[tuple[int, int], ...] = ()
    min_angle: float = 0.0
    curves: Mapping[str, Curve] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if self.delta is not None and not isinstance(self.delta, Relative):
            given = each("delta", self.delta)
            pair = given * 2 if len(given) == 1 else given
            require(len(pair) == 2, "delta", "be a number, two numbers, Relative or None", self.delta)
            is_width = pair == (0, 0) or all(0 < value < np.inf for value in pair)
            require(is_width, "delta", "be positive and finite, or 0", self.delta)
            object.__setattr__(self, "delta", pair)
        super().__post_init__()
        angle = real("min_angle", self.min_angle)
        require(0 <= angle < 60, "min_angle", "be at least 0 and less than 60 degrees", angle)
        object.__setattr__(self, "min_angle", angle)
        for name in RULES:
            places = as_tuple(getattr(self, name))
            for place in places:
                is_place = isinstance(place, (str, Integral))
                require(is_place, name, "be names of boundaries or node numbers", place)
            plain = tuple(place if isinstance(place, str) else int(place) for place in places)
            object.__setattr__(self, name, plain)
        for pair in as_tuple(self.tied):
            is_pair = isinstance(pair, (tuple, list)) and len(pair) == 2
            require(is_pair, "tied", "be pairs of node numbers", pair)
        require(isinstance(self.curves, Mapping), "curves", "be a mapping from boundaries", self.curves)
        for name, curve in self.curves.items():
            if not isinstance(curve, Curve):
                said = f"the curve of {name!r} must be a Circle, Spline or Parametrised, got {curve!r}"
                raise BadInputError(said, ("curves", name))

    @property
    def is_fixed(self) -> bool:
        """Whether no node is relocated."""
        return self.delta == (0, 0)

    @property
    def numbers(self) -> tuple[int, ...]:
        """All node numbers that the rules mention."""
        rules = (*self.pinned, *self.slides, *self.free, *(node for pair in self.tied for node in pair))
        return tuple(w for w in rules if not isinstance(w, str))

    def in_words(self) -> str:
        """Move limits, element validity and rules, for people."""
        if isinstance(self.delta, Relative):
            text = f"delta {figure(self.delta.fraction)} of the shortest edge"
        elif self.delta is None:
            text = "no move limits"
        elif self.is_fixed:
            return "no node is relocated"
        else:
            text = "delta " + " x ".join(map(figure, self.delta))  # type: ignore[arg-type]
        text += f", areas at least {figure(self.min_area_fraction)} of the given ones"
        if self.min_angle > 0:
            text += f", angles at least {figure(self.min_angle)} degrees"
        elif self.delta is None:
            text += f" ({BY_BARRIER})"
        for rule in RULES:
            if places := getattr(self, rule):
                text += f"; {rule}: {', '.join(map(str, places))}"
        if self.curves:
            text += f"; along curves: {', '.join(self.curves)}"
        return text + (f"; {len(self.tied)} nodes tied" if self.tied else "")

    def delta_record(self) -> Any:
        """The delta as plain JSON values: two numbers, a mapping, or None."""
        if isinstance(self.delta, Relative):
            return {"relative": self.delta.fraction}
        return None if self.delta is None else list(self.delta)  # type: ignore[arg-type]
