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
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import TERMS
from rmesh_nlp.fem.quantities import (
    at_point,
    body_integral,
    boundary_integral,
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
from rmesh_nlp.problem.design import symbol

DISPLACEMENTS = {1: ("u",), 2: ("ux", "uy")}
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
    try:
        parts = [_weighted(part, text) for part in _summands(text)]
        return Objective(tuple(term for part in parts for term in part.terms))
    except ValueError as error:
        raise BadInputError(str(error)) from error


def _weighted(part: str, whole: str) -> Objective:
    """``0.5*term``, ``-term`` or ``term``."""
    first, *rest = _split(part, "*")
    if not rest:
        return -1.0 * _term(part[1:].strip(), whole) if part.startswith("-") else _term(part, whole)
    try:
        weight = float(first)
    except ValueError:
        raise ValueError(f"the weight {first!r} in {whole!r} is not a number") from None
    term = _term("*".join(rest), whole)
    try:
        return weight * term
    except ValueError:
        raise ValueError(f"the weight {first!r} in {whole!r} must be positive and finite") from None


def _term(text: str, whole: str) -> Objective:
    if text in TERMS:
        return Objective(((1.0, TERMS[text]),))
    kind, bracket, rest = text.partition("(")
    if bracket and rest.endswith(")") and kind.strip() in QUANTITIES:
        return QUANTITIES[kind.strip()](text, _split(rest[:-1], ","))
    choices = (*TERMS, *(f"{kind}(...)" for kind in QUANTITIES))
    raise ValueError(f"unknown objective {text!r} in {whole!r}: choose from {', '.join(choices)}")


def _density(text: str, expression: str, more: Mapping[int, tuple[str, ...]]) -> Callable[..., Expression]:
    """An expression as a function of x, y, u and the values of ``more`` names, by the components of u.

    It is read once with every name that it may have, whatever the problem.
    """

    def read(names: dict[str, Expression]) -> Expression:
        with located(text):
            return value_of(expression, names)

    def density(x: Expression, y: Expression, u: Expression, extra: Expression = None) -> Expression:
        n = int(u.shape[0])
        values = [x, y, *ca.vertsplit(u), *([] if extra is None else ca.vertsplit(ca.vec(extra.T)))]
        return read(dict(zip(("x", "y", *DISPLACEMENTS[n], *more.get(n, ())), values, strict=True)))

    every = (name for names in (DISPLACEMENTS, more) for group in names.values() for name in group)
    read({name: ca.SX.sym(name) for name in ("x", "y", *every)})
    return density


def _body(text: str, arguments: list[str]) -> Objective:
    (expression,) = _take(text, arguments, "body(EXPR)")
    return body_integral(_density(text, expression, SLOPES), name=text)


def _boundary(text: str, arguments: list[str], *, mean: bool = False) -> Objective:
    name, expression = _take(text, arguments, f"{'mean' if mean else 'boundary'}(NAME, EXPR)")
    return boundary_integral(name, _density(text, expression, NORMAL), name=text, mean=mean)


def _node(text: str, arguments: list[str]) -> Objective:
    x, y, expression = _take(text, arguments, "node(X, Y, EXPR)")
    return at_point((_number(text, x), _number(text, y)), _density(text, expression, {}), name=text)


def _peak_pressure(text: str, arguments: list[str]) -> Objective:
    if len(arguments) == 2:
        arguments = [*arguments, "8"]
    name, reference, exponent = _take(text, arguments, "peak-pressure(NAME, P) or peak-pressure(NAME, P, K)")
    power = _number(text, exponent)
    if power != int(power):
        raise ValueError(f"{text}: the exponent must be a whole number, got {exponent}")
    return peak_pressure(name, _number(text, reference), exponent=int(power), name=text)


def _on_boundary(make: Callable[..., Objective], kind: str, text: str, arguments: list[str]) -> Objective:
    (name,) = _take(text, arguments, f"{kind}(NAME)")
    return make(name, name=text)


def _contact_length(text: str, arguments: list[str]) -> Objective:
    name, reference = _take(text, arguments, "contact-length(NAME, P)")
    return contact_length(name, _number(text, reference), name=text)


def _largest(text: str, arguments: list[str]) -> Objective:
    (boundary,) = _take(text, arguments, "max-pressure(NAME)")
    return largest_pressure(boundary, name=text)


def _square(text: str, arguments: list[str]) -> Objective:
    inside = ", ".join(arguments)
    for place in _places(inside, "+-"):
        try:
            value = float(inside[place:].replace(" ", ""))
        except ValueError:
            continue
        return square(parse_objective(inside[:place].strip()), -value, name=text)
    return square(parse_objective(inside), name=text)


def _design(text: str, arguments: list[str]) -> Objective:
    (expression,) = _take(text, arguments, "design(EXPR)")
    used = set(re.findall(r"\b[A-Za-z_]\w*", expression)) - {*FUNCTIONS, "pi"}
    with located(text):
        value = ca.SX(value_of(expression, {name: symbol(name) for name in sorted(used)}))
    return of_design(value, name=text)


def _fit(text: str, arguments: list[str]) -> Objective:
    (path,) = _take(text, arguments, "fit(FILE)")
    return fit_file(path, name=text)


def beside(text: str, folder: Path) -> str:
    """The text with relative files of measurements taken to be in a folder, that of the file it stands in."""
    return re.sub(r"\bfit\(\s*([^()]*?)\s*\)", lambda match: f"fit({folder / match[1]})", text)


QUANTITIES: dict[str, Callable[[str, list[str]], Objective]] = {
    "body": _body,
    "boundary": _boundary,
    "mean": partial(_boundary, mean=True),
    "node": _node,
    "peak-pressure": _peak_pressure,
    "level-pressure": partial(_on_boundary, level_pressure, "level-pressure"),
    "resultant": partial(_on_boundary, resultant, "resultant"),
    "shear": partial(_on_boundary, shear, "shear"),
    "contact-length": _contact_length,
    "square": _square,
    "max-pressure": _largest,
    "design": _design,
    "fit": _fit,
}
"""Quantities of interest by the word before their bracket."""


def _take(text: str, arguments: list[str], form: str) -> list[str]:
    if len(arguments) != form.split(" or ")[-1].count(",") + 1 or not all(arguments):
        raise ValueError(f"{text}: expected {form}")
    return arguments


def _number(text: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise ValueError(f"{text}: {value!r} is not a finite number")
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
