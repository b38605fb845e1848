"""The benchmark of whole solves: its table, and that the package is left as it was."""

from __future__ import annotations

import pytest

import benchmark_cost as script
from formulations import cascade
from rmesh_nlp.contact.solver import ContactSolver


def test_parts_add_up_to_the_whole_and_are_told_apart_in_one_run_only(
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = cascade.descend, ContactSolver.__init__
    assert script.main(["6.1:3"]) == 0
    assert (cascade.descend, ContactSolver.__init__) == before
    lines = capsys.readouterr().out.splitlines()
    header, _, row = ([one.strip() for one in line.split("|")[1:-1]] for line in lines)
    parts = [*script.PARTS, "rest"]
    assert header[-len(parts) :] == parts
    found = dict(zip(header, row, strict=True))
    assert (found["problem"], found["nodes"]) == ("6.1:3", "16")
    # rounded to three digits
    assert sum(float(found[part]) for part in parts) == pytest.approx(float(found["whole"]), rel=0.05)
    assert min(float(found[part]) for part in ("models", "descents", "assess", "reduction", "unit")) > 0
