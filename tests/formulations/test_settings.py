"""The settings of every method: each number is documented, and a wrong one is refused by its name."""

import re
from dataclasses import fields
from typing import Any

import casadi as ca
import pytest

from formulations.auto import Auto
from formulations.cascade import Cascade, Descent, Polished
from formulations.confirmed import Confirmed
from formulations.fixed import Fixed
from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from formulations.multistart import MultiStart
from formulations.nested import Nested
from formulations.remeshed import Remeshed
from formulations.schedule import Schedule
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.models.cascade import CascadeSettings
from rmesh_nlp.models.outer_solvers import NestedSettings
from rmesh_nlp.mpcc import MPCC, Options, solve
from rmesh_nlp.optimize.budget import Limits
from rmesh_nlp.optimize.trust_region import NewtonSettings
from rmesh_nlp.settings import Settings
from rmesh_nlp.vectorised import AssemblySettings

WRAPPERS = (Confirmed, MultiStart, Polished, Remeshed, Schedule)
FORMULATIONS = (AllAtOnce, Auto, Descent, Fixed, Joint, Nested, *WRAPPERS)
KINDS = (NewtonSettings, *FORMULATIONS, NestedSettings, CascadeSettings, AssemblySettings, Options, Limits)


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_documented(kind: type[Settings]) -> None:
    documented = " ".join(re.findall(r"^ *([\w, ]+) : ", kind.__doc__ or "", re.M)).replace(",", " ").split()
    known = {field.name for field in fields(kind)}
    assert documented == [name for name in vars(kind).get("__annotations__", {}) if name in known]


@pytest.mark.parametrize("kind", KINDS)
def test_every_number_is_checked(kind: Any) -> None:
    usual = kind(Fixed()) if kind in WRAPPERS else kind()
    for one in fields(kind):
        default = getattr(usual, one.name)
        if isinstance(default, (int, float)) and not isinstance(default, bool):
            for bad in (-1.0, float("nan"), "1", True):
                with pytest.raises(BadInputError, match=one.name):
                    usual.having({one.name: bad})


def test_what_is_no_field_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(BadInputError, match=r"unknown setting 'forcin': did you mean forcing\?"):
        NestedSettings.of({"newton": {"forcin": 0.5}})
    with pytest.raises(BadInputError, match=r"unknown setting 'cross': did you mean crossover\?"):
        solve(MPCC(*_pair()), [1.0, 1.0], cross=1.0)


@pytest.mark.parametrize("schedules", [((1.0, -1.0),), ((1.0, "x"),), ((1.0, 0.0),), (1.0,), 8])
def test_numbers_of_a_tuple_are_checked_one_by_one(schedules: Any) -> None:
    with pytest.raises(BadInputError, match="schedule"):
        Cascade(schedules=schedules)


@pytest.mark.parametrize(
    ("kind", "given"),
    [(Joint, {"ipopt": 3}), (Options, {"warm_duals": "yes"}), (Cascade, {"distortion": 1})],
)
def test_what_is_no_number_is_checked_too(kind: type[Settings], given: dict[str, Any]) -> None:
    with pytest.raises(BadInputError, match=next(iter(given))):
        kind.of(given)


def test_a_change_keeps_what_was_chosen_before() -> None:
    first = NestedSettings.of({"iterations": 7, "newton": {"close": 0.5}})
    both = first.having({"newton": {"max_products": 5}})
    assert both.changed() == {"iterations": 7, "newton": {"max_products": 5, "close": 0.5}}


def _pair() -> tuple[Any, ...]:
    x = ca.SX.sym("x", 2)
    return x, ca.sumsqr(x - 1), None, x[0], x[1]
