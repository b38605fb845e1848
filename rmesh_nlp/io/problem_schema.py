"""The keys of a problem file and what may stand there: one pydantic model per table."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from rmesh_nlp.io.problem_values import (
    Angle,
    Condition,
    Count,
    Delta,
    DesignedFinite,
    DesignedPair,
    DesignedPoisson,
    DesignedPositive,
    Finite,
    Flag,
    Fraction,
    Given,
    Limits,
    Order,
    Pair,
    Places,
    Points,
    Positive,
    Quadrature,
    Remesh,
    Scalar,
    Seed,
    Text,
    Ties,
    Triple,
    Vector,
    Weights,
    as_list,
    expected,
)


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
    young: DesignedPositive | None = None
    poisson: DesignedPoisson | None = None
    lame_lambda: DesignedFinite | None = None
    lame_mu: DesignedPositive | None = None
    body_force: Vector | None = None
    source: Scalar | None = None
    conductivity: DesignedPositive | None = None


class LineTable(Table):
    """A rigid straight line."""

    point: DesignedPair
    normal: Pair


class CircleTable(Table):
    """A rigid disc, or a round hole around the body."""

    centre: DesignedPair
    radius: DesignedPositive
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
    coulomb: Scalar | None = None
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


class VariableTable(Table):
    """One of ``[design]``: a number that is optimised."""

    start: Finite
    bounds: Pair


class ShapeTable(Table):
    """One of ``[design.shapes]``: a motion of a boundary times an amplitude."""

    boundary: Text
    motion: Vector
    bounds: Pair


class DesignTable(BaseModel):
    """``[design]``: variables by their names, and ``shapes`` by theirs."""

    model_config = ConfigDict(extra="allow", frozen=True)

    __pydantic_extra__: dict[str, VariableTable] = Field(init=False)
    shapes: dict[str, ShapeTable] = Field(default_factory=dict)

    @property
    def variables(self) -> dict[str, VariableTable]:
        """All but the shapes."""
        return self.__pydantic_extra__

    @property
    def names(self) -> list[str]:
        """Of all."""
        return [*self.variables, *self.shapes]


class ConstraintTable(Table):
    """One of ``[[constraints]]``."""

    value: Text
    bounds: Limits


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
    if not isinstance(value, dict):
        raise ValueError
    try:
        return CurveTable.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        text = "unknown key" if first["type"] == "extra_forbidden" else first["msg"]
        text = text.removeprefix("Value error, ")
        raise ValueError(f"{key}: {text}" if key else text) from None


FittedCurve = Annotated[
    Any,
    BeforeValidator(_curve),
    expected("'circle', 'spline' or a table such as {circle = [0.0, 0.0, 1.0]}"),
]


class SolveTable(BaseModel):
    """``[solve]``: defaults of ``rmesh solve`` for this file, and any other option of the formulation."""

    model_config = ConfigDict(extra="allow", frozen=True)

    formulation: Text = "auto"
    objective: Text = "energy"
    seed: Seed | None = None
    starts: Seed = 0
    regularisation: Weights | None = None
    remesh: Remesh = False
    certify: bool = False

    @model_validator(mode="after")
    def _starts_alone(self) -> SolveTable:
        if self.starts and self.seed is not None:
            raise ValueError("expected starts alone, without a seed")
        return self

    def options(self) -> dict[str, Any]:
        """Those that are not the defaults."""
        given = self.model_dump(exclude={"formulation", "certify"}, exclude_defaults=True)
        return {name: value for name, value in given.items() if value is not None}


class ProblemTable(Table):
    """A whole problem file."""

    name: Text | None = None
    order: Order = 1
    quadrature: Quadrature = "auto"
    mesh: MeshTable
    boundaries: dict[str, Condition] = Field(default_factory=dict)
    subdomains: dict[str, Condition] = Field(default_factory=dict)
    material: MaterialTable | None = None
    materials: dict[str, MaterialTable] = Field(default_factory=dict)
    dirichlet: dict[str, Given] = Field(default_factory=dict)
    tractions: dict[str, Vector] = Field(default_factory=dict)
    point_loads: tuple[PointLoadTable, ...] = ()
    contact: Annotated[tuple[ContactTable, ...], BeforeValidator(as_list)] = ()
    design: DesignTable = Field(default_factory=DesignTable)
    constraints: tuple[ConstraintTable, ...] = ()
    units: UnitsTable = UnitsTable()
    motion: MotionTable = MotionTable()
    curves: dict[str, FittedCurve] = Field(default_factory=dict)
    solve: SolveTable = SolveTable()

    @model_validator(mode="after")
    def _one_material(self) -> ProblemTable:
        if (self.material is None) == (not self.materials):
            raise ValueError("expected either [material] or [materials.<subdomain>]")
        return self
