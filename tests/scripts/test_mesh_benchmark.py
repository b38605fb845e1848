"""What the benchmark of meshes measures with: the plain loop of scikit-fem, references, the tables."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from skfem import MeshTri

import benchmark_bounds
import benchmark_mesh
import benchmark_order
from best_mesh import adaptive as plain
from best_mesh import cases, methods, tables
from best_mesh.methods import ADAPTIVE, ATTAINABLE, LOOP, METRIC, RELOCATED, REMESHED, UNIFORM, measure
from rmesh_nlp.contact.solver import ContactSolver
from rows import Row, Store
from support.orders import ORDERS


def falling(
    method: str, nodes: list[int], factor: float, rate: float = 1.0, order: int = 1, pace: float = 2.0
) -> list[Row]:
    """Rows whose errors fall with a power of the nodes; times are in proportion to them."""
    key = {"case": "6.3", "method": method, "order": order, "status": ""}
    return [
        {**key, "size": n, "nodes": n, "error": factor * float(n) ** -rate, "seconds": pace * n}
        for n in nodes
    ]


def test_factors_are_at_equal_nodes_beside_what_is_attainable() -> None:
    rows = [
        *falling(UNIFORM, [100, 400], 8.0),
        *falling(ADAPTIVE, [50, 900], 4.0),
        *falling(REMESHED, [400], 2.0),
        *falling(ATTAINABLE, [400], 1.0),
    ]
    # a mesh with 2 % more nodes and as much less error has the same factor
    rows.append({**rows[4], "method": METRIC, "nodes": 408, "error": rows[4]["error"] / 1.02})
    last = benchmark_mesh.factors(rows).iloc[-1]
    expected = {"nodes": 400, ADAPTIVE: 2, METRIC: 4, REMESHED: 4, ATTAINABLE: 8, "share": 0.5}
    assert last[list(expected)].to_dict() == pytest.approx(expected)
    assert last[f"{REMESHED} [s]"] == 800
    assert last[["P2", RELOCATED]].isna().all()


def test_times_are_compared_at_equal_error() -> None:
    rows = [*falling(ADAPTIVE, [50, 4000], 4.0), *falling(LOOP, [100, 400], 1.0)]
    # the adaptive mesh of this error has 1600 nodes
    first = tables.times(rows, 1, [LOOP], [ADAPTIVE], 300).iloc[0].tolist()
    assert first == ["6.3", LOOP, 400, 800.0, "0.25"]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    "name", ["6.1", "L-shape", "free boundary", "Signorini", "jNO's L-shape, held", "wedge"]
)
def test_plain_solver_agrees_with_the_package(name: str, order: int) -> None:
    case = cases.CASES[name]
    problem = replace(case.problem(case.sizes[0]), order=order)
    mesh = MeshTri(problem.mesh.p, problem.mesh.t)
    found, own = plain.solve(case.equations, mesh, order), ContactSolver(problem).given
    assert found.energy == pytest.approx(own.energy, rel=1e-10)
    if case.slope is not None:
        assert case.error_of(found) == pytest.approx(case.error(problem), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "order", "rate"), [("L-shape r^(2/3)", 2, 1.7), ("wedge", 2, 1.7), ("L-shape r^(2/3)", 1, 0.9)]
)
def test_refinement_gives_singular_solutions_the_rate_of_the_order(name, order, rate):
    case = {**cases.CASES, **cases.MORE}[name]
    mesh = case.problem(4).mesh
    found = list(plain.adaptive(case.equations, MeshTri(mesh.p, mesh.t), order, 1500))
    if case.slope is None:  # falls of the energy have the rate of errors
        errors = [one.energy - found[-1].energy for one in found[:-3]]
    else:
        errors = [case.error_of(one) for one in found]
    nodes = [one.nodes for one in found[: len(errors)]]
    assert np.log(errors[2] / errors[-1]) > rate * np.log(nodes[-1] / nodes[2])


@pytest.mark.slow
def test_energies_are_extrapolated_and_errors_of_as_many_triangles_bounded(monkeypatch) -> None:
    monkeypatch.setattr(cases, "FINE_NODES", 2000)
    case, store = cases.CASES["L-shape"], Store(None)
    given = case.problem(0)
    methods.measured(store, replace(case, known=np.nan), lambda _: [])
    energy, doubt = methods.limit(store.rows, case.name)
    error = case.error(given)
    assert abs(energy - case.known) < 1e-3 * error
    assert doubt < 1e-3 * error
    assert case.least(given.mesh.t.shape[1]) < 0.5 * error  # a corner: graded meshes are far better
    assert case.least(case.fine.mesh.t.shape[1]) < case.error(case.fine)  # what refinement reaches is above


@pytest.mark.slow
def test_bounds_of_a_force_are_measured_on_meshes_of_both_orders(tmp_path):
    body = tmp_path / "body.toml"
    body.write_text(
        'mesh = { shape = "rectangle", nx = 6, ny = 2, x = [0, 3] }\n'
        'material = { law = "plane-strain", young = 1000, poisson = 0.3 }\n'
        "dirichlet = { left = [0, 0] }\ntractions = { top = [0, -10] }\n"
        'contact = { boundary = "bottom", height = -0.02 }\n'
    )
    assert benchmark_bounds.main([str(body), "--levels", "1", "--out", str(tmp_path)]) == 0
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert {(row["order"], row["method"]) for row in rows} == set(product((1, 2), benchmark_bounds.METHODS))
    width = {(row["order"], row["method"]): row["error"] for row in rows}
    assert 0 < width[2, REMESHED] < width[2, UNIFORM] < width[1, UNIFORM]
    assert (tmp_path / "force_bounds.png").stat().st_size > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "case", "row"),
    [
        (benchmark_mesh, "6.1", "| 6.1     |    81 |"),
        (benchmark_order, "L-shape r^(2/3)", "| L-shape r^(2/3) |   225 |"),
    ],
)
def test_benchmarks_measure_each_mesh_once_and_write_their_tables(script, case, row, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "FINE_NODES", 2000)
    monkeypatch.setattr(benchmark_order, "MOST", {UNIFORM: 1000, ADAPTIVE: 1000})
    found = []
    for _ in range(2):
        assert script.main(["--cases", case, "--levels", "1", "--out", str(tmp_path)]) == 0
        found.append([(tmp_path / name).read_text() for name in ("table.md", "rows.jsonl")])
    assert found[0] == found[1]
    assert row in found[0][0]
    assert '"remeshed, relocated"' in found[0][1]
    assert script is benchmark_order or (tmp_path / "best_mesh.png").stat().st_size > 0


def test_factors_and_rates_of_orders_are_at_equal_unknowns() -> None:
    rows = [
        *falling(UNIFORM, [100, 400, 1600, 6400], 1.0, 1.0, 2, 1e-3),
        *falling(ADAPTIVE, [100, 6400], 5.0, 2.0, 2, 1e-3),
        *falling(RELOCATED, [100, 1600], 10.0, 2.0, 2, 1e-3),
        *falling(REMESHED, [102, 1600], 5.0, 2.0, 2, 1e-3),
    ]
    energies = [(1000, 5.0), (2000, 2.0)]
    key = {"case": "6.3", "method": methods.REFERENCE, "order": 2, "size": 0, "seconds": np.nan}
    rows += [{**key, "nodes": nodes, "error": energy, "status": "energy"} for nodes, energy in energies]
    assert methods.limit(rows, "6.3") == (1.0, 1.0)
    # a mesh with 2 % more nodes and 4 % less error is as good
    first, last = benchmark_order.factors(rows).iloc[:, 1:].to_numpy()
    assert first == pytest.approx([100, 0.01, 1, 20, 10, 20, np.nan, np.nan, np.nan], nan_ok=True)
    assert last == pytest.approx([1600, 1 / 1600, 1, 320, 160, 320, 1, 2, 2])
    # of 1600 nodes and 10 / 1600^2: the adaptive mesh has 1131, uniform ones 256 000
    own, peers = (RELOCATED, REMESHED), (UNIFORM, ADAPTIVE)
    first, last = tables.times(rows, 2, own, peers, 1000).drop(columns="s").to_numpy().tolist()
    assert first == ["6.3", RELOCATED, 1600, "< 0.00625", "1.41"]
    assert last == ["6.3", REMESHED, 1600, "< 0.00313", "1"]


def test_what_fails_is_a_row() -> None:
    def fails():  # type: ignore[no-untyped-def]
        yield {"nodes": 81, "error": 1.0}
        raise ValueError("no mesh")

    store = Store(None)
    measure(store, "6.1", 1, METRIC, 8, fails)
    (row,) = store.rows
    assert row["status"] == "ValueError: no mesh"
    assert tables.of(store.rows, "6.1", METRIC).empty
    measure(store, "6.1", 1, METRIC, 8, fails)  # it is not measured again
    assert len(store.rows) == 1
