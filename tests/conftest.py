"""Shared fixtures. Small meshes only: large ones belong in the benchmark scripts."""

from __future__ import annotations

import pytest
from support.problems import sloped_block

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem


@pytest.fixture(params=["6.1", "6.2", "6.3"])
def example(request: pytest.FixtureRequest) -> ContactProblem:
    """Each of the paper's examples at the paper's size."""
    return EXAMPLES[request.param]()


@pytest.fixture
def sloped() -> ContactProblem:
    """A block whose lower edge rises in two straight pieces above a flat, rough foundation."""
    return sloped_block()
