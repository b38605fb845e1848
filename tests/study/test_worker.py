"""Workers take cores for themselves, whatever the study they belong to."""

from __future__ import annotations

import os
import sys

import pytest

from rmesh_nlp.study import worker

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are pinned on Linux")


CORES = {900_001, 900_002}
"""Cores that no machine has, so that studies which run beside the tests do not matter."""


def test_no_core_is_given_twice_and_a_core_given_back_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: CORES)
    held = [worker._own_core() for _ in CORES]
    assert {core[0] for core in held if core is not None} == CORES
    assert worker._own_core() is None
    number, holder = held[0]  # type: ignore[misc]
    holder.close()
    again = worker._own_core()
    assert again is not None
    assert again[0] == number
    for _, each in (again, held[1]):  # type: ignore[misc]
        each.close()
