"""What is said of stick zones is counted, not remembered."""

from __future__ import annotations

import pytest
from support.sliding import sliding_block

from formulations import fixed
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.report.tables import markdown


def test_example_63_has_no_stick_zone_and_the_notes_say_so() -> None:
    record = fixed.solve(EXAMPLES["6.3"]((6, 4))).record()
    assert record["sticking_nodes"] == 0
    assert record["sliding_nodes"] > 0
    assert "there is no stick zone" in markdown([record])


@pytest.mark.slow
def test_where_nodes_stick_nothing_is_said() -> None:
    record = fixed.solve(sliding_block(4)).record()
    assert record["sticking_nodes"] > 0
    assert record["sliding_nodes"] > 0
    assert "stick zone" not in markdown([record])
    assert "sticking_nodes" not in fixed.solve(EXAMPLES["6.2"]((6, 4))).record()
