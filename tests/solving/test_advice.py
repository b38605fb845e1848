"""What is advised, from energies on three meshes and what relocation was measured to gain."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.models.cascade import CascadeSettings
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving import advice as advising
from rmesh_nlp.solving.advice import Advice, advise, recommended


@pytest.mark.parametrize(
    ("energies", "rate", "error"),
    [
        ((-1, -1.75, -1.9375), 1.0, 1.0),  # it falls by 3/4 and by a quarter of that
        ((-1, -1.5, -1.75), 0.5, 1.0),
        ((-1, -2, -2.0001), 1.5, 8 / 7),  # no faster than this is believed,
        ((-1, -1.5, -1.99), 0.2, 0.5 / (1 - 4**-0.2)),  # and no slower
        ((-1, -1.75, -1.7), 1.0, 1.0),  # where it does not fall both times the solution counts as smooth
        ((-1, -0.5, -0.75), 1.0, 0.0),
    ],
)
def test_rate_and_error_are_extrapolated_from_two_refinements(
    energies: tuple[float, ...], rate: float, error: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, left, seen = EXAMPLES["6.1"](2), list(energies), {}

    def admissible(there: ContactProblem, *where: Any) -> Any:
        if where:
            assert where == ("moved", 0)  # from the contact on the mesh as given
            return "relocated"
        assert there.motion.delta is None
        number, triangles = 3 - len(left), problem.mesh.t.shape[1]
        assert there.mesh.t.shape[1] == 4**number * triangles
        return SimpleNamespace(energy=left.pop(0), state=SimpleNamespace(active=number))

    def cascade(there: ContactProblem, settings: CascadeSettings) -> Any:
        assert (settings.brief, settings.brief_unnested, settings.iterations) == (1, 1, 7)
        energy = SimpleNamespace(relocation=SimpleNamespace(nodes=lambda _: "moved"))
        return SimpleNamespace(energy=energy, q=0, levels=[SimpleNamespace(contact_solves=n) for n in (3, 4)])

    def reduction(before: Any, after: Any, solves: int) -> tuple[Any, None]:
        seen["reduction"] = (before.energy, after, solves)
        return SimpleNamespace(factor=1.6), None

    for double in (admissible, cascade):
        monkeypatch.setattr(advising, double.__name__, double)
    monkeypatch.setattr(advising, "error_reduction", reduction)
    advice = advise(problem, {"iterations": 7})
    assert (advice.rate, advice.error) == pytest.approx((rate, error), rel=1e-12)
    assert seen["reduction"] == (energies[0], "relocated", 7)
    assert advice.recommendation == recommended(1.6, rate)
    monkeypatch.setattr(advising, "error_reduction", lambda *_: (None, None))
    left[:] = energies
    assert advise(problem, {"iterations": 7}).recommendation == recommended(1.0, rate)


@pytest.mark.parametrize(
    ("factor", "rate", "words"),
    [
        (1.49, 0.85, "refine uniformly"),
        (1.49, 0.84, "refine locally"),
        (1.5, 0.85, "relocate"),
        (1.5, 0.84, "both"),
    ],
)
def test_relocation_is_advised_by_its_least_factor_and_local_refinement_by_the_rate(
    factor: float, rate: float, words: str
) -> None:
    assert recommended(factor, rate).startswith(words)


def test_advice_is_told_in_four_rows() -> None:
    reduction = SimpleNamespace(text=lambda: "twice less")
    rows = Advice(reduction, 0.5, 0.25, "relocate").rows()
    assert [value for _, value in rows] == ["0.25", "N^-0.50", "twice less", "relocate"]
    assert dict(Advice(None, 1.0, 0.25, "").rows())["relocation, coarse map only"] == "nothing can be claimed"
