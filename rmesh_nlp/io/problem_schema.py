"""The keys of a problem file and what may stand there: one pydantic model per table.

Each kind of value is checked by one function that says what was expected. An error is then one sentence
rather than pydantic's list of all branches of a union.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from rmesh_nlp.expressions import Expression

LARGEST = 1e100
"""Numbers must be smaller than this, so that their squares are finite."""

FREE = "free"
"""Written in ``[dirichlet]`` for a component that is not given."""

SYMMETRY = "symmetry"
"""Written in ``[dirichlet]`` for a straight boundary whose nodes stay on it."""


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < LARGEST:
        raise ValueError("expected a finite number")
    return float(value)


def _positive(value: Any) -> float:
    return _positive_or(value, "expected a positive number")


def _poisson(value: Any) -> float:
    number = _number_or(value, "expected a number between -1 and 0.5")
    if not -1 < number < 0.5:
        raise ValueError("expected a number between -1 and 0.5")
    return number


def _number_or(value: Any, message: str) -> float:
    try:
        return _number(value)
    except ValueError:
        raise ValueError(message) from None


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 10_000:
        raise ValueError("expected a whole number from 1 to 10000")
    return value


def _pair(value: Any) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError("expected two numbers such as [0.0, 1.0]")
    return tuple(_number_or(v, "expected two numbers such as [0.0, 1.0]") for v in value)  # type: ignore[return-value]


def _triple(value: Any) -> tuple[float, float, float]:
    expected = "expected centre and radius such as [0.0, 0.0, 1.0]"
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(expected)
    x, y, radius = (_number_or(v, expected) for v in value)
    return x, y, _positive_or(radius, expected)


def _points(value: Any) -> list[tuple[float, float]]:
    if not isinstance(value, list) or len(value) < 2:
        raise ValueError("expected two or more points such as [[0, 0], [1, 0.1]]")
    return [_pair(point) for point in value]


def _coefficient(value: Any) -> Any:
    if isinstance(value, str):
        expression = Expression(value)
        if not expression.is_constant:
            return expression
        # a number after all: nodes held at it may slide, those held at a function may not
        value = float(expression(0.0, 0.0))
    return _number_or(value, "expected a finite number or an expression of x and y such as 'sin(pi*x)*y'")


def _condition(value: Any) -> Expression:
    if not isinstance(value, str):
        raise ValueError("expected a condition on x and y such as 'y == 1 and x > 2'")
    return Expression(value)


def _vector(value: Any) -> tuple[Any, ...]:
    items = value if isinstance(value, list) else [value]
    if not 1 <= len(items) <= 2:
        raise ValueError("expected one value, or two in a list, one per displacement component")
    return tuple(_coefficient(item) for item in items)


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("expected true or false")
    return value


def _given(value: Any) -> Any:
    if value == SYMMETRY:
        return SYMMETRY
    items = value if isinstance(value, list) else [value]
    if not 1 <= len(items) <= 2:
        raise ValueError("expected one value, or two in a list, one per displacement component")
    return tuple(None if item == FREE else _coefficient(item) for item in items)


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError("expected a text")
    return value


def _quadrature(value: Any) -> str | int:
    whole = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 50
    if value not in ("auto", "midpoint") and not whole:
        raise ValueError("expected 'auto', 'midpoint' or a degree from 1 to 50")
    return value


def _delta(value: Any) -> Any:
    expected = "expected a positive number, two of them, {relative = number} or 'none'"
    if value == "none":
        return None
    if isinstance(value, dict):
        if set(value) != {"relative"}:
            raise ValueError(expected)
        return {"relative": _positive_or(value["relative"], expected)}
    if isinstance(value, list):
        if len(value) != 2:
            raise ValueError(expected)
        return tuple(_positive_or(v, expected) for v in value)
    return _positive_or(value, expected)


def _positive_or(value: Any, message: str) -> float:
    number = _number_or(value, message)
    if number <= 0:
        raise ValueError(message)
    return number


def _places(value: Any) -> tuple[Any, ...]:
    good = isinstance(value, list) and all(
        isinstance(v, str) or (isinstance(v, int) and not isinstance(v, bool)) for v in value
    )
    if not good:
        raise ValueError("expected a list of boundary names and node numbers such as ['top', 17]")
    return tuple(value)


def _ties(value: Any) -> tuple[tuple[int, int], ...]:
    good = isinstance(value, list) and all(
        isinstance(v, list) and len(v) == 2 and all(type(k) is int for k in v) for v in value
    )
    if not good:
        raise ValueError("expected pairs of node numbers such as [[12, 40], [13, 41]]")
    return tuple((a, b) for a, b in value)


def _fraction(value: Any) -> float:
    number = _number_or(value, "expected a number between 0 and 1")
    if not 0 < number < 1:
        raise ValueError("expected a number between 0 and 1")
    return number


def _angle(value: Any) -> float:
    number = _number_or(value, "expected degrees from 0 to less than 60")
    if not 0 <= number < 60:
        raise ValueError("expected degrees from 0 to less than 60")
    return number


def _seed(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError("expected a whole number of at least 0")
    return value


def _weights(value: Any) -> tuple[float, ...]:
    """Positive weights, of which the last may be 0."""
    expected = (
        "expected a positive number, or a list of them such as [1, 0.1, 0.01], of which the last may be 0"
    )
    found = tuple(_number_or(v, expected) for v in (value if isinstance(value, list) else [value]))
    if not found or min(found) < 0 or 0 in found[:-1]:
        raise ValueError(expected)
    return found


def _levels(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 4:
        raise ValueError("expected a whole number from 0 to 4")
    return value


Flag = Annotated[Any, BeforeValidator(_flag)]
Finite = Annotated[Any, BeforeValidator(_number)]
Positive = Annotated[Any, BeforeValidator(_positive)]
Poisson = Annotated[Any, BeforeValidator(_poisson)]
Count = Annotated[Any, BeforeValidator(_count)]
Pair = Annotated[Any, BeforeValidator(_pair)]
Triple = Annotated[Any, BeforeValidator(_triple)]
Points = Annotated[Any, BeforeValidator(_points)]
Scalar = Annotated[Any, BeforeValidator(_coefficient)]
Condition = Annotated[Any, BeforeValidator(_condition)]
Vector = Annotated[Any, BeforeValidator(_vector)]
Given = Annotated[Any, BeforeValidator(_given)]
Text = Annotated[Any, BeforeValidator(_text)]
Delta = Annotated[Any, BeforeValidator(_delta)]
Places = Annotated[Any, BeforeValidator(_places)]
Ties = Annotated[Any, BeforeValidator(_ties)]
Fraction = Annotated[Any, BeforeValidator(_fraction)]
Angle = Annotated[Any, BeforeValidator(_angle)]
Seed = Annotated[Any, BeforeValidator(_seed)]
Weights = Annotated[Any, BeforeValidator(_weights)]
Levels = Annotated[Any, BeforeValidator(_levels)]
Quadrature = Annotated[Any, BeforeValidator(_quadrature)]


def _as_list(value: Any) -> Any:
    """``[contact]`` is one contact, ``[[contact]]`` several."""
    return [value] if isinstance(value, dict) else value


class Table(BaseModel):
    """A table whose keys are all known."""

    model_config = ConfigDict(extra="forbid", frozen=True)


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
        if (self.file is None) == (self.shape is None):
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
        if (self.boundary is None) == (self.interior is None):
            raise ValueError("expected either a boundary or interior")
        kinds = [
            k
            for k in ("offset", "line", "circle", "curve", "height", "points")
            if getattr(self, k) is not None
        ]
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
        by_parameter = [part is not None for part in (self.x, self.y, self.t)]
        kinds = [self.circle is not None, self.spline is not None, any(by_parameter)]
        if sum(kinds) != 1 or (any(by_parameter) and not all(by_parameter)):
            raise ValueError(
                "expected circle = [cx, cy, r], spline = [[x, y], ...], or x, y and t = [from, to]"
            )
        return self


def _curve(value: Any) -> Any:
    """A table, or the word for what is fitted to the nodes; one sentence says what is wrong."""
    if value in ("circle", "spline"):
        return value
    if not isinstance(value, dict):
        raise ValueError("expected 'circle', 'spline' or a table such as {circle = [0.0, 0.0, 1.0]}")
    try:
        return CurveTable.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        text = "unknown key" if first["type"] == "extra_forbidden" else first["msg"]
        text = text.removeprefix("Value error, ")
        raise ValueError(f"{key}: {text}" if key else text) from None


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
    def _one_way(self) -> SolveTable:
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
    curves: dict[str, Annotated[Any, BeforeValidator(_curve)]] = Field(default_factory=dict)
    solve: SolveTable = SolveTable()
    path: PathTable | None = None

    @model_validator(mode="after")
    def _one_material(self) -> ProblemTable:
        if (self.material is None) == (not self.materials):
            raise ValueError("expected either [material] or [materials.<subdomain>]")
        return self
