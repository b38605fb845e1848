"""Coulomb friction against closed forms and published figures, by the problems of its benchmark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import benchmark_coulomb
from benchmark_coulomb import StickZone, fixed_point, plate, plate_slips, pressed_block, slab, system_of
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.solver import ContactSolver


@pytest.mark.parametrize("shear", [0.03, 0.06])
def test_partial_slip_is_that_of_cattaneo_and_mindlin(shear: float) -> None:
    """c/a to 2 % on 516 nodes; the interpolation within an edge is less than what brackets the zone."""
    zone = StickZone.of(ContactSolver(pressed_block(8, shear)))
    assert 0.2 < zone.load < 0.8
    assert abs(zone.error) < 0.02
    low, high = zone.bracket
    edge = 1 / 8
    assert low - edge < np.sqrt(1 - zone.load) * zone.contact < high + edge


def test_slips_of_a_plate_are_the_published_ones() -> None:
    """Within the 5 % of their source, and at the first four places within the rounding of three digits."""
    slips = plate_slips(plate(32, 1))
    np.testing.assert_allclose(slips, 1.0, atol=0.05)
    np.testing.assert_allclose(slips[:4], 1.0, atol=0.005)


def test_a_fixed_point_of_the_bounds_takes_more_active_sets() -> None:
    system = system_of(slab((12, 6)))
    steps, sets = fixed_point(system)
    assert steps > 1
    assert solve(system).iterations < sets
    still = replace(system, coulomb=np.zeros(system.offset.size))
    assert fixed_point(still)[0] <= 2


@pytest.mark.slow
def test_tables_are_printed(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        benchmark_coulomb.TABLES, "partial", lambda: benchmark_coulomb.partial_slip(8, (0.5,))
    )
    assert benchmark_coulomb.main(["partial"]) == 0
    rows = capsys.readouterr().out.split("\n\n")[0].splitlines()
    assert len(rows) == 3
    assert float(rows[2].split("|")[1]) == pytest.approx(0.5, abs=0.01)
