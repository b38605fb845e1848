"""Names of units: what a user works in, written beside numbers and axes and nowhere else."""

from __future__ import annotations

from dataclasses import dataclass

from rmesh_nlp.errors import expect
from rmesh_nlp.settings import ByName


@dataclass(frozen=True)
class Units:
    """Names of the units of length and force; empty where nothing is said.

    They name, they do not convert: all numbers of a problem are in one consistent system.

    Attributes
    ----------
    length, force : str
        Such as "mm" and "N"; stresses are then in N/mm^2.
    per : str
        "revolution" where forces and energies are of a whole body of revolution, which the problem decides;
        else they are per unit of depth.
    """

    length: str = ""
    force: str = ""
    per: str = ""

    def __post_init__(self) -> None:
        for name, unit in vars(self).items():
            expect(f"the unit of {name}", unit, str)

    @property
    def line_force(self) -> str:
        """Unit of contact forces: force per unit of depth if both are named, or of the revolution."""
        if self.per:
            return f"{self.force}, whole revolution".removeprefix(", ")
        return f"{self.force}/{self.length}" if self.length and self.force else ""

    @property
    def axes(self) -> list[str]:
        """Labels of the coordinates: r and z of a body of revolution."""
        return [f"${name}${bracketed(self.length)}" for name in (("r", "z") if self.per else ("x_1", "x_2"))]

    @property
    def energy(self) -> str:
        """Unit of energies: force, being per unit of depth, or force times length."""
        return f"{self.force} {self.length}" if self.per and self.force and self.length else self.force

    @property
    def stress(self) -> str:
        """Force per area; empty unless both units are named."""
        return f"{self.force}/{self.length}²" if self.length and self.force else ""


NO_UNITS = Units()


def units_of(record: ByName) -> Units:
    """The units in a record; none where it has none."""
    given = record.get("units") or {}
    return Units(*(given.get(name, "") for name in ("length", "force", "per")))


def bracketed(unit: str) -> str:
    """The unit in brackets after a label, or nothing."""
    return f" [{unit}]" if unit else ""


def after(unit: str) -> str:
    """The unit after a number, or nothing."""
    return f" {unit}" if unit else ""
