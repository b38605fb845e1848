"""Shared fixtures. Small meshes only: large ones belong in the benchmark scripts."""

import gc
import signal

import pytest
from hypothesis import settings

from rmesh_nlp.optimize import budget
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving import driver
from support.problems import sloped_block

# the same inputs in every run: a test fails for a change, not by chance; scripts/ draw other ones
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")


# a job in the background is started with Ctrl-C ignored, and so would be all that tests press
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """What was imported and collected lives as long as the run: the garbage collector may skip it."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def nothing_that_no_test_looks_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cold contact solve that is the unit of cost is not repeated; errors are not estimated unasked.

    And audits after a limit take as long as they need, however loaded the machine is.
    """
    monkeypatch.setattr(budget, "TIMING_SECONDS", 0.0)
    monkeypatch.setattr(budget, "LEAST_AUDIT", 60.0)
    monkeypatch.setattr(driver, "MOST", 0)


@pytest.fixture
def estimates_unasked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors are estimated after each solve on a small mesh, as for users."""
    monkeypatch.setattr(driver, "MOST", 2000)


@pytest.fixture
def sloped() -> ContactProblem:
    """A block whose lower edge rises in two straight pieces above a flat, rough foundation."""
    return sloped_block()
