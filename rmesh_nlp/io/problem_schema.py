"""The keys of a problem file and what may stand there: one pydantic model per table.

Each kind of value is checked by one function, and the error says in one sentence what was expected instead of
pydantic's list of all branches of a union.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from rmesh_nlp.expressions import Expression

LARGEST = 1e100  # numbers must be smaller than this, so that their squares are finite
FREE = "free"  # written in ``[dirichlet]`` for a component that is not given
SYMMETRY = "symmetry"  # written in ``[dirichlet]`` for a straight boundary whose nodes stay on it


def _kind(expected: str, read: Callable[..., Any], *bounds: float) -> BeforeValidator:
    """A kind of value: ``read`` raises a ValueError, whose message is ``expected`` unless it has its own."""

    def check(value: Any) -> Any:
        try:
            return read(value, *bounds)
        except ValueError as error:
            raise ValueError(str(error) or f"expected {expected}") from None

    return BeforeValidator(check)


def _need(condition: bool) -> None:
    if not condition:
        raise ValueError


def _number(value: Any, low: float = -LARGEST, high: float = LARGEST) -> float:
    """A number between bounds that it does not reach."""
    _need(type(value) in (int, float) and low < value < high)
    return float(value)


def _whole(value: Any, low: int, high: float = float("inf")) -> int:
    _need(type(value) is int and low <= value <= high)
    return int(value)


def _list(value: Any, least: int, most: float = float("inf")) -> list[Any]:
    _need(isinstance(value, list) and least <= len(value) <= most)
    return list(value)


def _numbers(value: Any, count: int, low: float = -LARGEST) -> tuple[float, ...]:
    return tuple(_number(item, low) for item in _list(value, count, count))


def _points(value: Any) -> list[tuple[float, ...]]:
    return [_numbers(point, 2) for point in _list(value, 2)]


def _circle(value: Any) -> tuple[float, ...]:
    x, y, radius = _numbers(value, 3)
    return x, y, _number(radius, 0)


def _coefficient(value: Any) -> float | Expression:
    if isinstance(value, str):
        expression = Expression(value)
        if not expression.is_constant:
            return expression
        # a number after all: nodes fixed at it may slide, those fixed at a function may not
        value = float(expression(0.0, 0.0))
    try:
        return _number(value)
    except ValueError:
        raise ValueError(
            "expected a finite number or an expression of x and y such as 'sin(pi*x)*y'"
        ) from None


def _condition(value: Any) -> Expression:
    _need(isinstance(value, str))
    return Expression(value)


def _vector(value: Any, *words: str) -> tuple[float | Expression | None, ...]:
    """One or two components; a word stands for one that is not given."""
    items = _list(value if isinstance(value, list) else [value], 1, 2)
    return tuple(None if item in words else _coefficient(item) for item in items)


def _given(value: Any) -> str | tuple[float | Expression | None, ...]:
    return SYMMETRY if value == SYMMETRY else _vector(value, FREE)


def _flag(value: Any) -> bool:
    _need(isinstance(value, bool))
    return bool(value)


def _text(value: Any) -> str:
    _need(isinstance(value, str) and bool(value.strip()))
    return str(value)


def _quadrature(value: Any) -> str | int:
    return str(value) if value in ("auto", "midpoint") else _whole(value, 1, 50)


def _delta(value: Any) -> Any:
    if value == "none":
        return None
    if isinstance(value, dict):
        _need(set(value) == {"relative"})
        return {"relative": _number(value["relative"], 0)}
    return _numbers(value, 2, 0) if isinstance(value, list) else _number(value, 0)


def _places(value: Any) -> tuple[str | int, ...]:
    places = tuple(_list(value, 0))
    _need(all(type(place) in (str, int) for place in places))
    return places


def _ties(value: Any) -> tuple[tuple[int, ...], ...]:
    pairs = [tuple(_list(pair, 2, 2)) for pair in _list(value, 0)]
    _need(all(type(node) is int for pair in pairs for node in pair))
    return tuple(pairs)


def _angle(value: Any) -> float:
    return 0.0 if type(value) in (int, float) and value == 0 else _number(value, 0, 60)


def _weights(value: Any) -> tuple[float, ...]:
    found = tuple(_number(item) for item in _list(value if isinstance(value, list) else [value], 1))
    _need(min(found) >= 0 and 0 not in found[:-1])
    return found


POSITIVE_OR_LIST = "a positive number, or a list of them such as [1, 0.1, 0.01], of which the last may be 0"
ONE_OR_TWO = "one value, or two in a list, one per displacement component"

Flag = Annotated[bool, _kind("true or false", _flag)]
Finite = Annotated[float, _kind("a finite number", _number)]
Positive = Annotated[float, _kind("a positive number", _number, 0)]
Poisson = Annotated[float, _kind("a number between -1 and 0.5", _number, -1, 0.5)]
Fraction = Annotated[float, _kind("a number between 0 and 1", _number, 0, 1)]
Angle = Annotated[float, _kind("degrees from 0 to less than 60", _angle)]
Count = Annotated[int, _kind("a whole number from 1 to 10000", _whole, 1, 10_000)]
Seed = Annotated[int, _kind("a whole number of at least 0", _whole, 0)]
Levels = Annotated[int, _kind("a whole number from 0 to 4", _whole, 0, 4)]
Text = Annotated[str, _kind("a text", _text)]
Pair = Annotated[tuple[float, float], _kind("two numbers such as [0.0, 1.0]", _numbers, 2)]
Triple = Annotated[tuple[float, float, float], _kind("centre and radius such as [0.0, 0.0, 1.0]", _circle)]
Points = Annotated[
    list[tuple[float, float]], _kind("points such as [[0, 0], [1, 0.1]], two or more", _points)
]
Scalar = Annotated[Any, _kind("a number or an expression", _coefficient)]
Vector = Annotated[Any, _kind(ONE_OR_TWO, _vector)]
Given = Annotated[Any, _kind(ONE_OR_TWO, _given)]
Condition = Annotated[Any, _kind("a condition on x and y such as 'y == 1 and x > 2'", _condition)]
Quadrature = Annotated[str | int, _kind("'auto', 'midpoint' or a degree from 1 to 50", _quadrature)]
Delta = Annotated[Any, _kind("a positive number, two of them, {relative = number} or 'none'", _delta)]
Places = Annotated[Any, _kind("a list of boundary names and node numbers such as ['top', 17]", _places)]
Ties = Annotated[Any, _kind("pairs of node numbers such as [[12, 40], [13, 41]]", _ties)]
Weights = Annotated[tuple[float, ...], _kind(POSITIVE_OR_LIST, _weights)]


def _as_list(value: Any) -> Any:
    """``[contact]`` is one contact, ``[[contact]]`` several."""
    return [value] if isinstance(value, dict) else value


class Table(BaseModel):
    """A table whose keys are all known."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def given(self, *names: str) -> list[str]:
        """Which of these keys have a value."""
        return [name for name in names if getattr(self, name) is not None]


class MeshTable(Table):
    """``[mesh]``: a file, or a shape with its own parameters."""

    file: Text | None = None
    shape: (
        Literal["rectangle", "l-shape", "plate-with-hole", "half-disc", "wedge-block", "polygon"] | None
    ) = None
    nx: Count | None = None
    ny: Count | None = None
    x: Pair | None = None
    y: Pair | None = None
    diagonal: Literal["rising", "falling"] | None = None
    h: Positive | None = None
    size: Positive | None = None
    radius: Positive | None = None
    contact: Positive | None = None
    h_contact: Positive | None = None
    width: Positive | None = None
    height: Positive | None = None
    rise: Finite | None = None
    points: Points | None = None

    @model_validator(mode="after")
    def _one_source(self) -> MeshTable:
        if len(self.given("file", "shape")) != 1:
            raise ValueError("expected either a file or a shape")
        return self


class MaterialTable(Table):
    """``[material]`` or ``[materials.<subdomain>]``."""

    law: Literal["laplace", "plane-strain", "plane-stress"]
    young: Positive | None = None
    poisson: Poisson | None = None
    lame_lambda: Finite | None = None
    lame_mu: Positive | None = None
    body_force: Vector | None = None
    source: Scalar | None = None
    conductivity: Positive | None = None


class LineTable(Table):
    """A rigid straight line."""

    point: Pair
    normal: Pair


class CircleTable(Table):
    """A rigid disc, or a round hole around the body."""

    centre: Pair
    radius: Positive
    inside: Flag = False


class ContactTable(Table):
    """``[contact]`` or each ``[[contact]]``: on a boundary, or above an obstacle in the interior."""

    boundary: Text | None = None
    offset: Scalar | None = None
    normal: Pair | None = None
    line: LineTable | None = None
    circle: CircleTable | None = None
    curve: Scalar | None = None
    height: Scalar | None = None
    points: Points | None = None
    interior: Scalar | None = None
    friction: Scalar | None = None
    gap: Literal["node", "edge"] = "node"

    @model_validator(mode="after")
    def _one_kind(self) -> ContactTable:
        if len(self.given("boundary", "interior")) != 1:
            raise ValueError("expected either a boundary or interior")
        kinds = self.given("offset", "line", "circle", "curve", "height", "points")
        if len(kinds) > 1 or (kinds and self.interior is not None):
            raise ValueError(f"expected one way to say where the obstacle is, got {' and '.join(kinds)}")
        if self.normal is not None and kinds not in ([], ["offset"]):
            raise ValueError("expected normal only together with offset")
        return self


class PointLoadTable(Table):
    """One of ``[[point_loads]]``: a force at the node at a place."""

    at: Pair
    force: Vector


class UnitsTable(Table):
    """``[units]``: names that are written beside numbers and axes; nothing is converted."""

    length: Text = ""
    force: Text = ""


class MotionTable(Table):
    """``[motion]``."""

    delta: Delta = None
    pinned: Places = ()
    slides: Places = ()
    free: Places = ()
    tied: Ties = ()
    min_area_fraction: Fraction = 0.01
    min_angle: Angle = 0.0


class CurveTable(Table):
    """One of ``[curves]``: a circle, the points of a spline, or two expressions of t."""

    circle: Triple | None = None
    spline: Points | None = None
    x: Text | None = None
    y: Text | None = None
    t: Pair | None = None
    closed: Flag = False

    @model_validator(mode="after")
    def _one_kind(self) -> CurveTable:
        if self.given("circle", "spline", "x", "y", "t") not in (["circle"], ["spline"], ["x", "y", "t"]):
            raise ValueError(
                "expected circle = [cx, cy, r], spline = [[x, y], ...], or x, y and t = [from, to]"
            )
        return self


def _curve(value: Any) -> CurveTable | str:
    """A table, or the word for what is fitted to the nodes; one sentence says what is wrong."""
    if value in ("circle", "spline"):
        return str(value)
    _need(isinstance(value, dict))
    try:
        return CurveTable.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        text = "unknown key" if first["type"] == "extra_forbidden" else first["msg"]
        text = text.removeprefix("Value error, ")
        raise ValueError(f"{key}: {text}" if key else text) from None


FittedCurve = Annotated[
    Any, _kind("'circle', 'spline' or a table such as {circle = [0.0, 0.0, 1.0]}", _curve)
]


class SolveTable(Table):
    """``[solve]``: defaults of ``rmesh solve`` for this file."""

    formulation: Text = "auto"
    objective: Text = "energy"
    seed: Seed | None = None
    starts: Seed = 0
    levels: Levels = 0
    regularisation: Weights | None = None
    flips: Flag = False
    certify: bool = False

    @model_validator(mode="after")
    def _starts_alone(self) -> SolveTable:
        if self.starts and (self.levels or self.seed is not None):
            raise ValueError("expected starts alone, without levels or seed")
        return self


class PathTable(Table):
    """``[path]``: a foundation that moves in steps, for ``rmesh path``."""

    move: Pair
    steps: Count = 5
    contact: Count = 1
    relocate: Literal["each", "once", "never"] = "each"


class ProblemTable(Table):
    """A whole problem file."""

    name: Text | None = None
    quadrature: Quadrature = "auto"
    mesh: MeshTable
    boundaries: dict[str, Condition] = Field(default_factory=dict)
    subdomains: dict[str, Condition] = Field(default_factory=dict)
    material: MaterialTable | None = None
    materials: dict[str, MaterialTable] = Field(default_factory=dict)
    dirichlet: dict[str, Given] = Field(default_factory=dict)
    tractions: dict[str, Vector] = Field(default_factory=dict)
    point_loads: tuple[PointLoadTable, ...] = ()
    contact: Annotated[tuple[ContactTable, ...], BeforeValidator(_as_list)] = ()
    units: UnitsTable = UnitsTable()
    motion: MotionTable = MotionTable()
    curves: dict[str, FittedCurve] = Field(default_factory=dict)
    solve: SolveTable = SolveTable()
    path: PathTable | None = None

    @model_validator(mode="after")
    def _one_material(self) -> ProblemTable:
        if (self.material is None) == (not self.materials):
            raise ValueError("expected either [material] or [materials.<subdomain>]")
        return self
