"""Coulomb friction: closed forms, published results, all branches of a small problem, and what is refused."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.assessment.measures import residuals
from rmesh_nlp.contact.active_set import at_rest, solve
from rmesh_nlp.contact.coulomb import laws, newton
from rmesh_nlp.contact.next_set import next_set
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.contact.uniqueness import condensed, contraction, spectral_radius
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples.random_problems import random_problem
from support.problems import COULOMB, PRESSURE, SHEAR, coulomb_slab, sliding_block

SAG = "mean(top, -uy)"


def is_solved(system: ContactSystem, state: Equilibrium) -> bool:
    """Whether the laws hold, whatever the solver says."""
    found = residuals(system, state)
    exact = max(found.equilibrium, found.complementarity) < 1e-9
    return state.status is rm.Status.CONVERGED and exact


def all_solutions(system: ContactSystem) -> list[Array]:
    """The displacements of all solutions: open, stick, slide either way, in every combination."""
    solutions: list[Array] = []
    for nodes in product([(False, 1), (True, 0), (True, 1), (True, -1)], repeat=system.offset.size):
        touching, sliding = (np.array(part) for part in zip(*nodes, strict=True))
        state = system.equilibrium(ActiveSet(touching, sliding.astype(np.int8)))
        size = np.max(np.abs(state.u))
        is_new = all(np.max(np.abs(state.u - u)) > 1e-6 * size for u in solutions)
        if is_new and is_solved(system, state):
            solutions.append(state.u)
    return solutions


def slab(coulomb: Any = 0.5, n: tuple[int, int] = (8, 4), **changes: Any) -> rm.ContactProblem:
    return coulomb_slab(coulomb, n, **changes)


class TestSolver:
    @pytest.mark.parametrize("order", [1, 2])
    def test_a_sliding_block_under_constant_stress(self, order: int) -> None:
        mu, p, F = SHEAR, PRESSURE, COULOMB
        problem = sliding_block(order)
        model = ContactSolver(problem)
        found, space = model.given, model.discretisation.space
        _, y = space.points(problem.mesh.p)
        u = space.values(model.displacement.values(found.u))
        np.testing.assert_allclose(u, [0.02 + F * p / mu * y, -p / (2 * mu) * y], atol=1e-13)
        np.testing.assert_allclose(found.normal_force, p * space.weights(problem.mesh.p), rtol=1e-10)
        np.testing.assert_allclose(found.tangential_force, -F * found.normal_force, rtol=1e-10)
        assert np.all(found.active.sliding == 1)

    @pytest.mark.parametrize("order", [1, 2])
    @pytest.mark.parametrize("coulomb", [0.0, 0.5, 3.0, lambda x, y: 0.2 + 0.3 * x])
    def test_laws_hold_whatever_the_coefficient(self, coulomb, order: int) -> None:
        problem = slab(coulomb, order=order)
        model = ContactSolver(problem)
        system = model.system(problem.mesh.p)
        assert model.given.status is rm.Status.CONVERGED
        assert is_solved(system, model.given)
        assert model.given.iterations <= 12

    def test_solution_is_the_only_one_of_all_branches(self) -> None:
        """Four contact nodes that are open, stick, or slide either way: 256 branches."""
        problem = slab(0.6, (4, 2), motion=rm.Motion(None))
        model = ContactSolver(problem)
        system = model.system(problem.mesh.p)
        assert system.offset.size == 4
        (found,) = all_solutions(system)
        np.testing.assert_allclose(found, model.given.u, atol=1e-12)

    @pytest.mark.parametrize("coulomb", [0.3, 1.0])
    def test_where_newton_fails_bounds_follow_the_forces_to_the_same_solution(self, coulomb, monkeypatch):
        problem = slab(coulomb)
        system = ContactSolver(problem).system(problem.mesh.p)
        by_newton = solve(system)
        # it is the solution for the bound of Tresca that is reached
        bounded = replace(system, slip_bound=system.bound(by_newton.normal_force), coulomb=None)
        np.testing.assert_allclose(solve(bounded).u, by_newton.u, atol=1e-12)
        at_once = replace(system.equilibrium(at_rest(system)), status=rm.Status.STALLED)
        monkeypatch.setattr("rmesh_nlp.contact.active_set.newton", lambda *_: at_once)
        slow = solve(system)
        assert slow.status is rm.Status.CONVERGED
        np.testing.assert_allclose(slow.u, by_newton.u, atol=1e-12)

    def test_bounds_of_tresca_and_of_coulomb_add_up(self) -> None:
        problem = slab(0.3)
        both = replace(problem, obstacle=replace(problem.obstacle, friction=4.0))
        system = ContactSolver(both).system(both.mesh.p)
        state = solve(system)
        assert is_solved(system, state)
        slides = state.active.touching & (state.active.sliding != 0)
        assert np.any(slides)
        omega = ContactSolver(both).discretisation.space.weights(both.mesh.p)
        expected = (4.0 * omega + 0.3 * state.normal_force)[slides]
        np.testing.assert_allclose(np.abs(state.tangential_force[slides]), expected, rtol=1e-10)

    @pytest.mark.parametrize(("seed", "order", "coulomb"), [(18, 1, 3.0), (19, 2, 10.0)])
    def test_newton_is_damped_where_full_steps_cycle(self, seed: int, order: int, coulomb: float) -> None:
        rough = random_problem(seed, kind="rough", order=order)
        problem = rm.refined(replace(rough, obstacle=replace(rough.obstacle, friction=0.0, coulomb=coulomb)))
        system = ContactSolver(problem).system(np.asarray(problem.mesh.p))
        active, seen = at_rest(system), set()
        while active.key() not in seen:  # full steps alone
            seen.add(active.key())
            active, wrong = next_set(system, system.equilibrium(active), active)
        assert wrong > 0
        state = newton(system, at_rest(system), 30)
        assert state.status is rm.Status.CONVERGED
        assert is_solved(system, state)

    def test_a_node_that_meets_the_foundation_slides_as_it_moves_unless_the_overlap_holds_it(self) -> None:
        """Whatever way it slid at an earlier guess."""
        problem = slab(0.5, (4, 2), motion=rm.Motion(None))
        system = ContactSolver(problem).system(problem.mesh.p)
        ones = np.ones(system.offset.size)
        for direction in (-1, 1):
            apart = ActiveSet(ones < 0, (direction * ones).astype(np.int8))
            for slip, gap, way in ((0.3, -0.2, 1), (-0.3, -0.2, -1), (0.3, -0.7, 0), (-0.3, -0.7, 0)):
                u = system.tangents.T @ (slip * ones) + system.normals.T @ (gap * ones)
                proposal, _ = next_set(system, replace(system.equilibrium(apart), u=u), apart)
                assert np.all(proposal.touching)
                np.testing.assert_array_equal(proposal.sliding, way)

    def test_laws_vanish_at_the_solution_alone(self) -> None:
        problem = slab(1.0)
        system = ContactSolver(problem).system(problem.mesh.p)
        state = solve(system)
        unit = system.force_scale**2 / system.stiffness.diagonal().max()
        assert laws(system, state)[0] < 1e-20 * unit
        wrong = {"normal_force": 0.9 * state.normal_force, "tangential_force": -state.tangential_force}
        for name, value in {**wrong, "u": -state.u}.items():
            assert laws(system, replace(state, **{name: value}))[0] > 1e-6 * unit

    @pytest.mark.parametrize("turned", [False, True])
    def test_contraction_is_that_of_the_fixed_point(self, turned: bool) -> None:
        problem = slab(0.8)
        system = ContactSolver(problem).system(problem.mesh.p)
        state = solve(system)
        bound, active = system.bound(state.normal_force), state.active
        if turned:  # as if every other node slid the other way
            active = ActiveSet(
                active.touching, (active.sliding * (-1) ** np.arange(bound.size)).astype(np.int8)
            )

        def after(change: np.ndarray) -> np.ndarray:
            bounded = replace(system, slip_bound=bound + change, coulomb=None)
            return system.coulomb * bounded.equilibrium(active).normal_force

        small = 1e-3 * bound.max()
        first = after(np.zeros(bound.size))
        jacobian = [(after(small * unit) - first) / small for unit in np.eye(bound.size)]
        expected = np.max(np.abs(np.linalg.eigvals(np.stack(jacobian, axis=1))))
        assert 0.01 < spectral_radius(system, condensed(system), active) == pytest.approx(expected, rel=1e-6)
        assert contraction(system, state) >= spectral_radius(system, condensed(system), state.active)
        assert contraction(replace(system, coulomb=None), state) == 0.0
        own = spectral_radius(system, condensed(system), active)
        assert contraction(system, replace(state, active=active)) >= own

    def test_a_body_that_gaps_alone_hold_is_looked_at_with_all_nodes_sliding(self) -> None:
        """Rollers at the top leave it a translation and a rotation."""
        problem = rm.ContactProblem(
            rm.shapes.rectangle(8, 4, x=(0, 2)),
            rm.PlaneStrain.from_young(100.0, 0.4),
            rm.Dirichlet("top", (0.0, None)),
            rm.Obstacle("bottom", (0.0, 1.0), coulomb=2.0),
            tractions=(rm.Traction("top", (0.0, -1.0)),),
        )
        system = ContactSolver(problem).system(np.asarray(problem.mesh.p))
        assert system.rigid.shape[1] == 2
        every = np.ones(system.offset.size, dtype=bool)
        stick, slide = (ActiveSet(every, np.full(every.size, way, dtype=np.int8)) for way in (0, 1))
        expected = spectral_radius(system, condensed(system), slide)
        assert 0.01 < expected == pytest.approx(contraction(system, replace(solve(system), active=stick)))

    @pytest.mark.slow
    @pytest.mark.parametrize(("seed", "draw"), [(21, 41), (38, 7)])
    def test_several_solutions_are_warned_of_where_one_is_found_that_sticks(self, seed, draw) -> None:
        """All branches of three contact nodes under random loads there."""
        rough, rng = random_problem(seed, kind="rough"), np.random.default_rng(draw)
        problem = replace(rough, obstacle=replace(rough.obstacle, friction=0.0, coulomb=8.0))
        system = ContactSolver(problem).system(np.asarray(problem.mesh.p))
        assert system.offset.size == 3
        push = system.tangents.T @ rng.uniform(-3, 3, 3) + system.normals.T @ rng.uniform(-3, 1, 3)
        loaded = replace(system, load=system.load + system.force_scale * push)
        assert len(all_solutions(loaded)) > 1
        found = solve(loaded)
        assert is_solved(loaded, found)
        assert spectral_radius(loaded, condensed(loaded), found.active) < 1
        assert contraction(loaded, found) >= 1

    @pytest.mark.parametrize(
        ("coulomb", "touching", "normal", "tangential"),
        [(3.3, 1, (0.1, 0.8, -0.5), (0.2, -0.3, 0.5)), (1.8, 3, (-0.4, -0.4, -0.4), (-0.7, -0.9, 0.8))],
    )
    def test_several_solutions_are_warned_of_where_they_touch_elsewhere(
        self, coulomb, touching, normal, tangential
    ) -> None:
        """Where every node slides one way the bounds contract."""
        mesh, line = rm.shapes.rectangle(2, 1, x=(0, 1.1), y=(0, 1.9)), rm.PlaneStrain.from_young(1.0, 0.4)
        disc = rm.Obstacle.circle("bottom", (0.7, -2.5), 2.5, coulomb=coulomb)
        system = ContactSolver(rm.ContactProblem(mesh, line, ("top",), disc)).system(np.asarray(mesh.p))
        loaded = replace(
            system, load=system.load + system.normals.T @ normal + system.tangents.T @ tangential
        )
        found = solve(loaded)
        assert np.sum(found.active.touching) == touching
        assert len(all_solutions(loaded)) > 1
        one_way = ActiveSet(np.ones(3, dtype=bool), np.ones(3, dtype=np.int8))
        assert spectral_radius(loaded, condensed(loaded), one_way) < 1 <= contraction(loaded, found)


class TestFormulations:
    @pytest.mark.slow
    def test_nested_and_mpcc_lower_the_objective_and_are_measured_alike(self) -> None:
        ends = {name: rm.solve(slab(0.5, (4, 2)), name, objective=SAG) for name in ("nested", "mpcc")}
        for solution in ends.values():
            row = solution.record()
            assert solution.success
            assert row["objective_value"] < 0.75 * row["objective_initial"]
            assert row["complementarity_residual"] < 1e-8
            assert solution.assessment.first_order.residual < 1e-5
        assert ends["mpcc"].assessment.first_order.stationarity == "S"

    def test_fixed_solves_the_contact_problem_without_a_certificate(self) -> None:
        problem = slab(1.0)
        solution = rm.solve(problem, "fixed", certify=True)
        assert solution.status is rm.Status.CONVERGED
        row, state = solution.record(), ContactSolver(problem).given
        touching = state.active.touching
        assert row["sticking_nodes"] == np.count_nonzero(state.active.sliding == 0) > 0
        assert row["sliding_nodes"] == np.count_nonzero(state.active.sliding != 0)
        assert 0 < np.count_nonzero(touching) < touching.size
        assert "Coulomb" in solution.certificate_remark

    @pytest.mark.parametrize("name", ["joint", "nested", "mpcc", "cascade"])
    def test_there_is_no_energy_to_minimise(self, name: str) -> None:
        with pytest.raises(rm.BadInputError, match="with Coulomb friction"):
            rm.solve(slab(), name)
        if name == "joint":
            with pytest.raises(rm.BadInputError, match=r"joint minimises an energy.*use mpcc or nested"):
                rm.solve(slab(), name, objective=SAG)

    def test_a_strong_coefficient_is_warned_of(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("rmesh_nlp.solving.state.contraction", lambda *_: 1.25)
        assert "the only one" in " ".join(rm.solve(slab(), "fixed").record()["warnings"])


COEFFICIENT, RADIUS, PRESS, EDGE = 0.3, 10.0, 0.19, 1 / 8
"""Of partial slip, Young's modulus one: F, the radius of the cylinder, the approach at which the half-width
of the contact is about one, and the length of its edges."""


def graded(fine: float, size: float) -> Array:
    """Places from 0 to ``size``, ``EDGE`` apart up to ``fine`` and then farther."""
    places, step = list(np.arange(0, fine + EDGE / 2, EDGE)), EDGE
    while places[-1] < size:
        step *= 1.5
        places.append(places[-1] + step)
    x, start = np.array(places), places[np.searchsorted(places, fine)]
    x[x > start] = start + (x[x > start] - start) * (size - start) / (x[-1] - start)
    return x


def pressed_block(shear: float) -> rm.ContactProblem:
    """A block on a rigid cylinder, its top moved down and sideways.

    It is 24 half-widths high and 48 wide: in one of half that size pressing alone makes the ends of the
    contact slip, along 5 % of it.
    """
    x, y = graded(1.25, 24.0), graded(0.0, 24.0)
    mesh = MeshTri.init_tensor(np.concatenate([-x[:0:-1], x]), y)
    mesh = mesh.with_boundaries({"bottom": lambda z: z[1] == 0, "top": lambda z: z[1] == y[-1]})
    return rm.ContactProblem(
        mesh,
        rm.PlaneStrain.from_young(1.0, 0.49),
        rm.Dirichlet("top", (shear, -PRESS)),
        rm.Obstacle("bottom", offset=lambda x, y: x**2 / (2 * RADIUS), coulomb=COEFFICIENT),
        rm.Motion(None),
        order=2,
    )


def half_width(x: Array, stress: Array) -> float:
    """Half the distance of the zeros of the parabola through the squares of a stress."""
    zeros = np.roots(np.polyfit(x, stress**2, 2))
    return float(abs(zeros[0] - zeros[1]) / 2)


def means(x: Array, force: Array) -> Array:
    """Of stresses over edges, by forces at their ends and middles."""
    return np.asarray(((force[:-1:2] + force[2::2]) / 2 + force[1::2]) / np.diff(x[::2]))


def test_partial_slip_is_that_of_cattaneo_and_mindlin() -> None:
    """Stick over contact is sqrt(1 - Q/(F P)), to 2 % on 516 nodes; a bracket of its end is an edge wide.

    In the closed form the squares of the pressure, and of what friction leaves of its bound where the block
    sticks, are parabolas in x. They are fitted to means of stresses over edges.
    """
    model = ContactSolver(pressed_block(shear=0.04))
    state, nodes = model.given, np.asarray(model.problem.mesh.p)
    places = model.discretisation.space.points(nodes)[0, model.contact_nodes]
    along = np.argsort(places)
    x, normal, tangential = (v[along] for v in (places, state.normal_force, state.tangential_force))
    sticks = (state.active.touching & (state.active.sliding == 0))[along]
    load = abs(tangential.sum()) / (COEFFICIENT * normal.sum())
    assert 0.2 < load < 0.8

    middle, pressure, friction = (x[:-1:2] + x[2::2]) / 2, means(x, normal), means(x, tangential)
    held = sticks[:-1:2] & sticks[1::2] & sticks[2::2]
    pressed = (normal[:-1:2] > 0) & (normal[2::2] > 0)
    contact = half_width(middle[pressed], pressure[pressed])
    stick = half_width(middle[held], (COEFFICIENT * pressure - np.abs(friction))[held])
    assert stick / contact == pytest.approx(np.sqrt(1 - load), rel=0.02)
    first, last = np.flatnonzero(sticks)[[0, -1]]
    low, high = (x[last] - x[first]) / 2, (x[last + 1] - x[first - 1]) / 2
    assert low - EDGE < np.sqrt(1 - load) * contact < high + EDGE


def test_unloading_leaves_the_stress_of_mindlin() -> None:
    """Where Q falls from Q1, slip turns outside of b = a sqrt(1 - (Q1 - Q)/(2 F P)).

    The stress is then -1, 2 and -1 times the ellipses over a, b and c = a sqrt(1 - Q1/(F P)): R. D. Mindlin,
    H. Deresiewicz, J. Appl. Mech. 20 (1953) 327-344, as for a line in K. L. Johnson, Contact Mechanics, 7.4.
    """
    before = ContactSolver(pressed_block(shear=0.04))
    back = rm.LoadStep(dirichlet=rm.Dirichlet("top", (0.012, -PRESS)))
    after = ContactSolver(before.problem.after(back, before.displacement.values(before.given.u)))
    places = after.discretisation.space.points(np.asarray(after.problem.mesh.p))[0, after.contact_nodes]
    along = np.argsort(places)
    x, state = places[along], after.given
    normal, loaded, left = (
        v[along] for v in (state.normal_force, before.given.tangential_force, state.tangential_force)
    )
    most, now = (abs(v.sum()) / (COEFFICIENT * normal.sum()) for v in (loaded, left))
    assert 0.1 < now < most - 0.2 < 0.5
    middle, pressure, stress = (x[:-1:2] + x[2::2]) / 2, means(x, normal), means(x, left)
    pressed = (normal[:-1:2] > 0) & (normal[2::2] > 0)
    a = half_width(middle[pressed], pressure[pressed])
    b, c = a * np.sqrt(1 - (most - now) / 2), a * np.sqrt(1 - most)
    sticks = (state.active.touching & (state.active.sliding == 0))[along]
    first, last = np.flatnonzero(sticks)[[0, -1]]
    assert (x[last] - x[first]) / 2 < b < (x[last + 1] - x[first - 1]) / 2
    inner, unit = np.abs(middle) < c - EDGE, COEFFICIENT * pressure.max()
    one, two, three = (np.sqrt(r**2 - middle[inner] ** 2) for r in (a, b, c))
    wanted = np.sign(loaded.sum()) * unit / a * (2 * two - one - three)
    np.testing.assert_allclose(stress[inner], wanted, rtol=0, atol=0.01 * unit)


PLATE = {0.0: 2.86e-5, 0.00125: 2.72e-5, 0.005: 2.28e-5, 0.0075: 1.98e-5, 0.01125: 1.50e-5}
"""Slip in m at places of the lower edge in m: code_aster's test SSNV128 (V6.04.128, to 5 %), a mean of codes
after R. A. Feijoo, H. J. C. Barbosa, N. Zouain, Numerical formulations for contact problems with friction,
Journal of Theoretical and Applied Mechanics."""


def test_slips_of_a_plate_are_the_published_ones() -> None:
    """Half of a square plate of 80 mm, F = 1, pressed from above by 50 and from the side by 150 MPa.

    Within the 5 % of their source, and at the first four places within the rounding of three digits.
    """
    problem = rm.ContactProblem(
        rm.shapes.rectangle(32, 32, x=(0, 0.04), y=(0, 0.04)),
        rm.PlaneStrain.from_young(1.3e11, 0.2),
        rm.Dirichlet("right", (0.0, None)),
        rm.Obstacle("bottom", coulomb=1.0),
        rm.Motion(None),
        (rm.Traction("top", (0.0, -5e7)), rm.Traction("left", (15e7, 0.0))),
    )
    model, nodes = ContactSolver(problem), np.asarray(problem.mesh.p)
    u = model.displacement.values(model.given.u)[0]
    bottom = np.flatnonzero(nodes[1] == 0)
    along = bottom[np.argsort(nodes[0, bottom])]
    slips = np.interp(list(PLATE), nodes[0, along], u[along]) / np.array(list(PLATE.values()))
    np.testing.assert_allclose(slips, 1.0, atol=0.05)
    np.testing.assert_allclose(slips[:4], 1.0, atol=0.005)
