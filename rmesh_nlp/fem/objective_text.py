"""Outer objectives written as text: ``error-l2 + 0.01*quality``, ``0.1*resultant(bottom) - area``.

Named terms are those of :mod:`rmesh_nlp.fem.objectives`. Quantities of interest are

``body(EXPR)``                  integral over the body
``boundary(NAME, EXPR)``        integral over a named boundary
``mean(NAME, EXPR)``            the same over the boundary's length
``node(X, Y, EXPR)``            value at the vertex that is at (X, Y) on the given mesh
``peak-pressure(NAME, P)``      smoothed peak of the pressure on a boundary, P a pressure of its size
``peak-pressure(NAME, P, K)``   the same with exponent K, by default 8
``level-pressure(NAME)``        integral of ``(p - mean p)^2`` over a contact boundary
``resultant(NAME)``             integral of the contact pressure
``shear(NAME)``                 integral of the tangential stress of friction
``contact-length(NAME, P)``     integral of ``p^2 / (p^2 + P^2)``, the length of contact as P tends to 0
``max-pressure(NAME)``          largest pressure at a node of a contact boundary
``design(EXPR)``                an expression of design variables alone
``square(SUM - VALUE)``         square of what a sum of weighted terms lacks to a value
``fit(FILE)``                   least squares to measured displacements, see :mod:`rmesh_nlp.fem.fit`

EXPR is an expression of ``x``, ``y``, the displacement (``u`` of a scalar problem, else ``ux``, ``uy``), its
derivatives (``u_x``, ``u_y``, or ``ux_x``, ``ux_y``, ``uy_x``, ``uy_y``) in the body, and the outward normal
(``nx``, ``ny``) on a boundary. It is read by a whitelist and never evaluated as Python.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError, located
from rmesh_nlp.evaluation import Expression
from rmesh_nlp.expressions import FUNCTIONS, value_of
from rmesh_nlp.fem.fit import DISPLACEMENTS
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import TERMS
from rmesh_nlp.fem.quantities import (
    at_point,
    body_integral,
    boundary_integral,
    boundary_length,
    contact_length,
    fit_file,
    largest_pressure,
    level_pressure,
    of_design,
    peak_pressure,
    resultant,
    shear,
    square,
)
from rmesh_nlp.problem import ContactProblem, Traction
from rmesh_nlp.problem.design import symbol

SLOPES = {1: ("u_x", "u_y"), 2: ("ux_x", "ux_y", "uy_x", "uy_y")}
NORMAL = {1: ("nx", "ny"), 2: ("nx", "ny")}


def parse_objective(text: str | Objective) -> Objective:
    """Read an objective; one that is an object already is returned as it is.

    Raises
    ------
    BadInputError
        If a term is unknown, or a weight is not a number that suits it.
    """
    if isinstance(text, Objective):
        return text
    if not isinstance(text, str):
        raise BadInputError(f"objective must be a text or an Objective, got {text!r}")
    try:
        parts = [_weighted(part, text) for part in _summands(text)]
        return Objective(tuple(term for part in parts for term in part.terms))
    except ValueError as error:
        raise BadInputError(str(error)) from error


def load_of(text: str, problem: ContactProblem) -> Traction:
    """The load whose work is a linear quantity, ``boundary(NAME, EXPR)`` or ``mean(NAME, EXPR)``.

    Raises
    ------
    BadInputError
        If it is another quantity, not linear in the displacement, or depends on the normal.
    """
    kind, arguments = called(text)
    if kind not in ("boundary", "mean") or len(arguments) != 2:
        raise BadInputError(
            f"{text!r} has no bounds: mean, boundary, pressure and resultants of contact boundaries have"
        )
    boundary, expression = arguments
    x, y, u = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("u", problem.components)
    try:
        value = ca.SX(_density(text, expression, {})(x, y, u))
        length = boundary_length(problem, boundary)
    except ValueError as error:
        raise BadInputError(str(error)) from error
    load = ca.gradient(value, u) / (length if kind == "mean" else 1.0)
    at_zero = ca.substitute(value, u, ca.SX.zeros(problem.components))
    if ca.depends_on(load, u) or not ca.simplify(at_zero).is_zero():
        raise BadInputError(f"{text!r} has no bounds: it is not linear in the displacement")
    parts = (ca.Function("load", [x, y], [ca.densify(part)]) for part in ca.vertsplit(load))
    return Traction(boundary, tuple(parts))


def called(text: str) -> tuple[str, list[str]]:
    """The word before a bracket and the arguments in it; no word of a text of another form."""
    kind, _, rest = text.partition("(")
    return (kind.strip(), _split(rest[:-1], ",")) if rest.rstrip().endswith(")") else ("", [])


def _weighted(part: str, whole: str) -> Objective:
    """``0.5*term``, ``-term`` or ``term``."""
    first, *rest = _split(part, "*")
    if not rest:
        return -1.0 * _term(part[1:].strip(), whole) if part.startswith("-") else _term(part, whole)
    try:
        weight = float(first)
    except ValueError:
        raise BadInputError(f"the weight {first!r} in {whole!r} is not a number") from None
    term = _term("*".join(rest), whole)
    try:
        return weight * term
    except ValueError:
        raise BadInputError(f"the weight {first!r} in {whole!r} must be positive and finite") from None


def _term(text: str, whole: str) -> Objective:
    if text in TERMS:
        return TERMS[text].alone
    kind, arguments = called(text)
    if kind in QUANTITIES:
        return _quantity(kind, arguments, text)
    choices = (*TERMS, *(f"{kind}(...)" for kind in QUANTITIES))
    raise BadInputError(f"unknown objective {text!r} in {whole!r}: choose from {', '.join(choices)}")


def _density(text: str, expression: str, more: Mapping[int, tuple[str, ...]]) -> Callable[..., Expression]:
    """An expression as a function of x, y, u and the values of ``more`` names, by the components of u.

    It is read once with every name that it may have, whatever the problem.
    """

    def read(names: dict[str, Expression]) -> Expression:
        with located(text):
            return value_of(expression, names)

    def density(x: Expression, y: Expression, u: Expression, extra: Expression = None) -> Expression:
        n = u.shape[0]
        values = [x, y, *ca.vertsplit(u), *([] if extra is None else ca.vertsplit(ca.vec(extra.T)))]
        return read(dict(zip(("x", "y", *DISPLACEMENTS[n], *more.get(n, ())), values, strict=True)))

    every = (name for names in (DISPLACEMENTS, more) for group in names.values() for name in group)
    read({name: ca.SX.sym(name) for name in ("x", "y", *every)})
    return density


def _body(expression: str, *, name: str) -> Objective:
    return body_integral(_density(name, expression, SLOPES), name=name)


def _boundary(boundary: str, expression: str, *, name: str, mean: bool = False) -> Objective:
    return boundary_integral(boundary, _density(name, expression, NORMAL), name=name, mean=mean)


def _node(x: float, y: float, expression: str, *, name: str) -> Objective:
    return at_point((x, y), _density(name, expression, {}), name=name)


def _peak_pressure(boundary: str, reference: float, exponent: float = 8.0, *, name: str) -> Objective:
    if exponent != int(exponent):
        raise BadInputError(f"{name}: the exponent must be a whole number, got {exponent:g}")
    return peak_pressure(boundary, reference, exponent=int(exponent), name=name)


def _square(inside: str, *, name: str) -> Objective:
    for place in _places(inside, "+-"):
        try:
            value = float(inside[place:].replace(" ", ""))
        except ValueError:
            continue
        return square(parse_objective(inside[:place].strip()), -value, name=name)
    return square(parse_objective(inside), name=name)


def _design(expression: str, *, name: str) -> Objective:
    used = set(re.findall(r"\b[A-Za-z_]\w*", expression)) - {*FUNCTIONS, "pi"}
    with located(name):
        value = ca.SX(value_of(expression, {variable: symbol(variable) for variable in sorted(used)}))
    return of_design(value, name=name)


QUANTITIES: Mapping[str, tuple[str, Callable[..., Objective]]] = {
    "body": ("EXPR", _body),
    "boundary": ("NAME, EXPR", _boundary),
    "mean": ("NAME, EXPR", partial(_boundary, mean=True)),
    "node": ("X, Y, EXPR", _node),
    "peak-pressure": ("NAME, P, [K]", _peak_pressure),
    "level-pressure": ("NAME", level_pressure),
    "resultant": ("NAME", resultant),
    "shear": ("NAME", shear),
    "contact-length": ("NAME, P", contact_length),
    "square": ("SUM - VALUE", _square),
    "max-pressure": ("NAME", largest_pressure),
    "design": ("EXPR", _design),
    "fit": ("FILE", fit_file),
}
"""Quantities of interest by the word before their bracket: what stands in it, and what makes them of that."""

NUMBERS = ("X", "Y", "P", "[K]")
"""Which of these are numbers."""


def _quantity(kind: str, arguments: list[str], text: str) -> Objective:
    form, make = QUANTITIES[kind]
    words = form.split(", ")
    needed = [word for word in words if not word.startswith("[")]
    if not (len(needed) <= len(arguments) <= len(words) and all(arguments)):
        raise BadInputError(f"{text}: expected {kind}({form})")
    read = [_number(text, a) if word in NUMBERS else a for word, a in zip(words, arguments, strict=False)]
    return make(*read, name=text)


def beside(text: str, folder: Path) -> str:
    """The text with relative files of measurements taken to be in a folder, that of the file it stands in."""
    return re.sub(r"\bfit\(\s*([^()]*?)\s*\)", lambda match: f"fit({folder / match[1]})", text)


def _number(text: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise BadInputError(f"{text}: {value!r} is not a finite number")
    return number


def _summands(text: str) -> list[str]:
    """The terms of a sum, those that are subtracted with their sign; the hyphen of a name is no sign."""

    def ends_a_term(before: str) -> bool:
        return before.rstrip()[-1:] not in ("", *"+-*")

    places = [
        k for k in _places(text, "+-") if text[k] == "+" or (text[k - 1] in " )" and ends_a_term(text[:k]))
    ]
    terms = [text[a:b].strip() for a, b in zip([0, *places], [*places, len(text)], strict=True)]
    return [term[0].replace("+", "") + term[1:].strip() for term in terms if term] or [""]


def _split(text: str, separator: str) -> list[str]:
    """The parts between separators that are outside of all brackets, stripped."""
    places = _places(text, separator)
    return [
        text[a:b].strip() for a, b in zip([0, *(k + 1 for k in places)], [*places, len(text)], strict=True)
    ]


def _places(text: str, separators: str) -> list[int]:
    """Where separators are that stand outside of all brackets and of numbers."""
    places, depth = [], 0
    for place, sign in enumerate(text):
        depth += (sign == "(") - (sign == ")")
        # a sign inside a number (1e+3) belongs to the number
        exponent = place >= 2 and text[place - 1] in "eE" and text[place - 2] in ".0123456789"
        if sign in separators and depth == 0 and not exponent:
            places.append(place)
    return places
