"""Settings on the command line: plain ones, those of a method within a formulation, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest

from rmesh_nlp.cli.inputs import parse_settings
from rmesh_nlp.errors import BadInputError


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ([], {}),
        (["tol=1e-8", "relaxation = scholtes"], {"tol": 1e-8, "relaxation": "scholtes"}),
        (["blocks=[8, 4]", "without_first=true"], {"blocks": [8, 4], "without_first": True}),
        (
            ["newton.forcing=0.2", "newton.step.searches=5", "tight=1"],
            {"newton": {"forcing": 0.2, "step": {"searches": 5}}, "tight": 1},
        ),
    ],
)
def test_a_name_with_dots_is_a_setting_of_settings(given: list[str], found: dict[str, Any]) -> None:
    assert parse_settings(given) == found


@pytest.mark.parametrize("text", ["tol", "=1", ".x=1", "newton.=1", "a..b=1", "tol.x=1"])
def test_what_is_no_setting_is_refused(text: str) -> None:
    said = r"--set tol\.x=1: tol has a value already, 0\.5" if text == "tol.x=1" else "must be NAME=VALUE"
    with pytest.raises(BadInputError, match=said):
        parse_settings(["tol=0.5", text])
