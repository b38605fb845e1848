"""The settings of every method: each number is documented, and a wrong one is refused by its name."""

import re
from dataclasses import fields
from typing import Any

import casadi as ca
import pytest

from formulations.fixed import FixedSettings
from formulations.joint import JointSettings
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.mpcc import MPCC, Options, solve
from rmesh_nlp.optimize.newton_settings import (
    LocalNewtonSettings,
    NewtonSettings,
    ProjectionSettings,
    StepSettings,
    TrustRegionSettings,
)
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.programs.nested_settings import NestedSettings
from rmesh_nlp.settings import Settings
from rmesh_nlp.vectorised import AssemblySettings

NEWTON = (TrustRegionSettings, NewtonSettings, LocalNewtonSettings, StepSettings, ProjectionSettings)
KINDS = (*NEWTON, NestedSettings, JointSettings, FixedSettings, CascadeSettings, AssemblySettings, Options)


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_documented(kind: type[Settings]) -> None:
    documented = " ".join(re.findall(r"^ *([\w, ]+) : ", kind.__doc__ or "", re.M)).replace(",", " ").split()
    assert documented == list(vars(kind)["__annotations__"])


@pytest.mark.parametrize("kind", KINDS)
def test_every_number_is_checked(kind: Any) -> None:
    usual = kind()
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


@pytest.mark.parametrize("blocks", [(), (4, 0), (2.5,), 8])
def test_numbers_of_a_tuple_are_checked_one_by_one(blocks: Any) -> None:
    with pytest.raises(BadInputError, match="blocks"):
        NestedSettings(blocks=blocks)


@pytest.mark.parametrize(
    ("kind", "given"),
    [(JointSettings, {"ipopt": 3}), (Options, {"warm_duals": "yes"}), (CascadeSettings, {"distortion": 1})],
)
def test_what_is_no_number_is_checked_too(kind: type[Settings], given: dict[str, Any]) -> None:
    with pytest.raises(BadInputError, match=next(iter(given))):
        kind.of(given)


def test_a_change_keeps_what_was_chosen_before() -> None:
    first = NestedSettings.of({"tol": 1e-5, "newton": {"close": 0.5}})
    both = first.having({"newton": {"step": {"searches": 5}}})
    assert both.changed() == {"tol": 1e-5, "newton": {"close": 0.5, "step": {"searches": 5}}}


def _pair() -> tuple[Any, ...]:
    x = ca.SX.sym("x", 2)
    return x, ca.sumsqr(x - 1), None, x[0], x[1]
