"""The tables of a problem file: most keys are the arguments of the class or function that a table calls."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    SkipValidation,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
    model_validator,
)
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.expressions import value_of
from rmesh_nlp.io.problem_messages import Source
from rmesh_nlp.io.problem_values import (
    KINDS,
    Condition,
    Flag,
    Given,
    Limits,
    ObjectiveText,
    Pair,
    Points,
    Scalar,
    Seed,
    Text,
    Vector,
    as_list,
    source_of,
)
from rmesh_nlp.meshes import shapes
from rmesh_nlp.meshes.abaqus import law_of
from rmesh_nlp.meshes.curves import FITTED, Circle, Curve, Parametrised, Spline
from rmesh_nlp.meshes.reading import read_mesh
from rmesh_nlp.problem import (
    Axisymmetric,
    DesignVariable,
    Elastic,
    Laplace,
    Law,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    PlaneStress,
    PointLoad,
    Shape,
    Units,
)
from rmesh_nlp.problem.obstacle import GAPS, MOVES
from rmesh_nlp.problem.surfaces import unit
from rmesh_nlp.settings import Values

SHAPES: Mapping[str, Callable[..., MeshTri]] = {
    "rectangle": shapes.rectangle,
    "l-shape": shapes.l_shape,
    "plate-with-hole": shapes.plate_with_hole,
    "half-disc": shapes.half_disc,
    "wedge-block": shapes.wedge_block,
    "polygon": shapes.polygon,
}
"""The function that makes each shape."""

LAWS: Mapping[str, tuple[Callable[..., Law], ...]] = {
    "laplace": (Laplace,),
    "plane-strain": (PlaneStrain.from_young, PlaneStrain),
    "plane-stress": (PlaneStress.from_young, PlaneStress),
    "axisymmetric": (Axisymmetric.from_young, Axisymmetric),
}
"""What may make each law."""

FOUNDATIONS: Mapping[str, tuple[Callable[..., Obstacle], str]] = {
    "interior": (Obstacle.interior, "psi"),
    "line": (Obstacle.line, ""),
    "circle": (Obstacle.circle, ""),
    "curve": (Obstacle.curve, "level"),
    "height": (Obstacle.graph, "height"),
    "points": (Obstacle.graph, "height"),
    "offset": (Obstacle, "offset"),
    "pair": (Obstacle.pair, "first"),
    "interface": (Obstacle.interface, "name"),
}
"""Keys of a contact that say where the foundation is: what makes it, and the argument that the key is; empty
for a table of arguments."""

LAST = ("gap", "force", "move", "displacement")
"""Keys of a contact that any foundation takes."""

FORCES = ("friction", "coulomb")
"""Keys of a contact that say which friction there is."""


def _circle(circle: tuple[float, float, float]) -> Circle:
    x, y, radius = circle
    return Circle((x, y), radius)


def _spline(spline: list[tuple[float, float]], closed: bool = False) -> Spline:
    return Spline(tuple(spline), closed)


def _parametrised(x: str, y: str, t: tuple[float, float], closed: bool = False) -> Parametrised:
    return Parametrised(partial(_value_at, x), partial(_value_at, y), t, closed)


def _value_at(text: str, t: Any) -> Any:
    return value_of(text, {"t": t})


CURVES: tuple[Callable[..., Curve], ...] = (_circle, _spline, _parametrised)
"""What may make a curve."""

T = TypeVar("T", bound="FileTable")


class FileTable(BaseModel):
    """A table whose keys are all known."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    either: ClassVar[tuple[str, ...]] = ()
    """Keys of which it has exactly one."""

    @model_validator(mode="after")
    def _one_of(self: T) -> T:
        if self.either and len(self.given(*self.either)) != 1:
            raise ValueError(f"expected either {' or '.join(self.either)}")
        return self

    def given(self, *names: str) -> list[str]:
        """Which of these keys have a value."""
        return [name for name in names if getattr(self, name) is not None]

    def entries(self, *without: str) -> Values:
        """The keys that the file has, with their values, but for some."""
        keys = [name for name in type(self).model_fields if name in self.model_fields_set]
        return {name: getattr(self, name) for name in keys if name not in without}


def arguments(make: Callable[..., object]) -> dict[str, Parameter]:
    """The arguments that a file can give: those whose type has a kind of value, in the place of the type."""
    types, parameters = get_type_hints(make), signature(make).parameters
    return {
        name: argument.replace(annotation=KINDS[types[name]])
        for name, argument in parameters.items()
        if types[name] in KINDS
    }


def taking(*makes: Callable[..., object], without: tuple[str, ...] = ()) -> Callable[[type[T]], type[T]]:
    """A table with the arguments of ``make`` as further keys; of one of several each may be left out."""

    def extended(table: type[T]) -> type[T]:
        fields: Values = {}
        for make in makes:
            for name, argument in arguments(make).items():
                if name not in without:
                    is_needed = argument.default is Parameter.empty and len(makes) == 1
                    fields[name] = (argument.annotation, ... if is_needed else None)
        return create_model(table.__name__, __base__=table, **fields)

    return extended


M = TypeVar("M")


def call(what: str, makes: Sequence[Callable[..., M]], given: Mapping[str, object]) -> M:
    """The first of some functions that takes the given arguments, called with them."""
    forms, known = [], set[str]()
    for make in makes:
        takes = arguments(make)
        needs = {name for name, argument in takes.items() if argument.default is Parameter.empty}
        if needs <= given.keys() <= takes.keys():
            return make(**given)
        forms.append(", ".join(name if name in needs else f"[{name}]" for name in takes))
        known |= takes.keys()
    place = tuple(name for name in given if name not in known)[:1]
    head = f"{place[0]} is not taken: " if place else ""
    raise BadInputError(f"{head}{what} takes {', or '.join(forms)}", place)


@taking(*SHAPES.values())
class MeshTable(FileTable):
    """``[mesh]``: a file, or a shape with the arguments of its function."""

    either = ("file", "shape")
    file: Text | None = None
    shape: Literal[tuple(SHAPES)] | None = None  # type: ignore[valid-type]

    def made(self, folder: Path, pairs: Collection[tuple[str, str]] = ()) -> MeshTri:
        """The mesh; its file is relative to a folder, the nodes of pairs of boundaries are not merged."""
        if self.shape is not None:
            return call(f"the shape {self.shape!r}", [SHAPES[self.shape]], self.entries("shape"))

        def read(file: str) -> MeshTri:
            return read_mesh(folder / file, pairs)

        return call("a mesh from a file", [read], self.entries())


@taking(Laplace, Elastic.from_young, Elastic)
class MaterialTable(FileTable):
    """``[material]`` or ``[materials.<subdomain>]``: a law with its arguments."""

    law: Literal[tuple(LAWS)] | None = None  # type: ignore[valid-type]

    def made(self, mesh: Path) -> Law:
        """The law; that of the elements of a mesh ``.inp`` where none is named."""
        law = self.law or (law_of(mesh) if mesh.suffix.lower() == ".inp" else None)
        if law is None:
            raise BadInputError(f"law is missing: {', '.join(LAWS)}")
        return call(f"the law {law!r}", LAWS[law], self.entries("law"))


BrokenLine = Annotated[Points, AfterValidator(lambda points: PiecewiseLinear(*zip(*points, strict=True)))]
"""The points of a graph."""


@taking(Obstacle.line, without=("boundary", *FORCES))
class LineTable(FileTable):
    """A rigid straight line."""


@taking(Obstacle.circle, without=("boundary", *FORCES))
class CircleTable(FileTable):
    """A rigid disc, or a round hole around the body."""


class ContactTable(FileTable):
    """``[contact]`` or each ``[[contact]]``: on or between boundaries, or above an obstacle inside."""

    either = ("boundary", "interior", "pair", "interface")
    boundary: Text | None = None
    pair: tuple[Text, Text] | None = None
    interface: Text | None = None
    interference: Scalar | None = None
    offset: Scalar | None = None
    normal: Pair | None = None
    line: LineTable | None = None
    circle: CircleTable | None = None
    curve: Scalar | None = None
    height: Scalar | None = None
    points: BrokenLine | None = None
    interior: Scalar | None = None
    friction: Scalar | None = None
    coulomb: Scalar | None = None
    gap: Literal[GAPS] = "node"  # type: ignore[valid-type]
    force: Pair | None = None
    move: Literal[MOVES] | None = None  # type: ignore[valid-type]
    displacement: Pair | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> ContactTable:
        kinds = self.given(*FOUNDATIONS)
        if len(kinds) > 1:
            raise ValueError(f"expected one way to say where the obstacle is, got {' and '.join(kinds)}")
        if self.normal is not None and kinds not in ([], ["offset"]):
            raise ValueError("expected normal only together with offset")
        if self.interference is not None and not self.given("pair", "interface"):
            raise ValueError("expected interference only together with pair or interface")
        if self.interior is not None and self.given(*FORCES):
            raise ValueError("friction needs contact on a boundary")
        return self

    def made(self, components: int) -> Obstacle:
        """The foundation for a body with so many components of the displacement."""
        given, last = self.entries(*LAST, *FOUNDATIONS), {name: getattr(self, name) for name in LAST}
        (kind,) = self.given(*FOUNDATIONS) or ["offset"]
        make, argument = FOUNDATIONS[kind]
        value = getattr(self, kind)
        if isinstance(value, FileTable):
            given |= value.entries()
        elif kind == "pair":
            given["first"], given["second"] = value
        elif value is not None:
            given[argument] = value
        if kind == "offset":
            given["normal"] = (1.0,) if components == 1 else unit(self.normal or (0.0, 1.0))
        return replace(make(**given), **last)


@taking(PointLoad, without=("node",))
class PointLoadTable(FileTable):
    """One of ``[[point_loads]]``: a force at the node at a place."""

    at: Pair


@taking(DesignVariable, without=("name",))
class VariableTable(FileTable):
    """One of ``[design]``: a number that is optimised."""


@taking(Shape, without=("name",))
class ShapeTable(FileTable):
    """One of ``[design.shapes]``: a motion of a boundary times an amplitude."""


class DesignTable(BaseModel):
    """``[design]``: variables by their names, and ``shapes`` by theirs."""

    model_config = ConfigDict(extra="allow", frozen=True)

    __pydantic_extra__: dict[str, VariableTable] = Field(init=False)
    shapes: dict[str, ShapeTable] = Field(default_factory=dict)

    @property
    def variables(self) -> dict[str, VariableTable]:
        """All but the shapes."""
        return self.__pydantic_extra__


class ConstraintTable(FileTable):
    """One of ``[[constraints]]``."""

    value: ObjectiveText
    bounds: Limits


@taking(Units, without=("per",))  # the law decides that
class UnitsTable(FileTable):
    """``[units]``: names that are written beside numbers and axes; nothing is converted."""


@taking(Motion)
class MotionTable(FileTable):
    """``[motion]``."""


@taking(*CURVES)
class CurveTable(FileTable):
    """One of ``[curves]``: a circle, the points of a spline, or two expressions of t."""

    def made(self) -> Curve:
        """The curve."""
        return call("a curve", CURVES, self.entries())


def _curve(value: object, read: ValidatorFunctionWrapHandler) -> CurveTable | str:
    """A table, or the word for what is fitted to the nodes."""
    if isinstance(value, dict):
        return read(value)
    if value in FITTED:
        return str(value)
    raise ValueError("expected 'circle', 'spline' or a table such as {circle = [0.0, 0.0, 1.0]}")


class SolveTable(BaseModel):
    """``[solve]``: defaults of ``rmesh solve`` for this file, and any other option of the formulation."""

    model_config = ConfigDict(extra="allow", frozen=True)

    formulation: Text = "auto"
    objective: ObjectiveText = "energy"
    seed: Seed | None = None
    starts: SkipValidation[int | None] = None
    remesh: SkipValidation[bool | int] = False
    certify: Flag = False

    def options(self) -> Values:
        """Those that are not the defaults."""
        return self.model_dump(exclude={"formulation", "certify"}, exclude_defaults=True)


class StepTable(FileTable):
    """One of ``[[steps]]``: loads and given displacements that change, and forces of tools."""

    tractions: dict[str, Vector] = Field(default_factory=dict)
    point_loads: tuple[PointLoadTable, ...] = ()
    dirichlet: dict[str, Given] = Field(default_factory=dict)
    tools: dict[str, Pair] = Field(default_factory=dict)


class ProblemTable(FileTable):
    """A whole problem file."""

    name: Text | None = None
    order: SkipValidation[int] = 1
    quadrature: SkipValidation[str | int] = "auto"
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
    steps: tuple[StepTable, ...] = ()
    units: UnitsTable = UnitsTable()
    motion: MotionTable = MotionTable()
    curves: dict[str, Annotated[CurveTable, WrapValidator(_curve)]] = Field(default_factory=dict)
    solve: SolveTable = SolveTable()
    _source: Source = PrivateAttr()

    @property
    def source(self) -> Source:
        """The file that it stands in."""
        return self._source

    @model_validator(mode="after")
    def _one_material(self, info: ValidationInfo) -> ProblemTable:
        self._source = source_of(info)
        if (self.material is None) == (not self.materials):
            raise ValueError("expected either [material] or [materials.<subdomain>]")
        return self
