"""Relocation without move limits: the energy with a distortion, over a cascade of coarser meshes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formulations.confirmed import Confirmed
from formulations.schedule import Schedule
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.cascade import CascadeSettings, cascade
from rmesh_nlp.models.levels import prolonged
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.regularisation import ESTIMATE_SOLVES
from rmesh_nlp.models.regularised_descent import descend, finished
from rmesh_nlp.optimize.budget import processor_seconds
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import Count, Limit, Positive
from rmesh_nlp.solving.formulation import Formulation, Wrapper
from rmesh_nlp.solving.monitor import Monitor, Track
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part, Work

SPARE = 6
"""Contact solves that one more iteration may take, steps that are refused included."""


@dataclass(frozen=True)
class Cascade(CascadeSettings, Formulation):
    """Minimises the energy over the positions of all nodes, by a cascade of meshes, from the given mesh.

    The rule for the loads is raised until the assessment agrees with the gain. Where it is asked for, with
    ``stationary``, the descent goes on to a stationary point.
    """

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        if not objective.is_energy:
            raise BadInputError(
                f"the cascade minimises the energy, not {objective.text!r}: use nested or mpcc"
            )

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        maps = Confirmed(self._descents(outer), Descent(end=self.end))
        whole = Polished(maps, nodes=self.stationary, finish=self.finish, most=self.most)
        return whole.run(outer, q, monitor)

    def _descents(self, outer: Outer) -> Formulation:
        if not outer.is_near:
            return Maps(self)
        # a mesh that was made for the solution: coarser ones know less of it
        order = outer.problem.order
        return Schedule(Descent(iterations=self.near(order)), (self.regularisation,), self.distortion)


@dataclass(frozen=True)
class CascadeFigures(Part):
    """What the cascade minimised, and its levels where it came to an end."""

    outer: str
    regularisation: float
    distortion: str
    stationary_for: str
    cascade: list[dict[str, Any]] | None = None
    gain_estimate: float | None = None


@dataclass(frozen=True)
class FinishWork(Part):
    """Work of the way to a stationary point."""

    finish: dict[str, float]


@dataclass(frozen=True)
class Maps(Formulation):
    """The descents of a cascade: each mesh begins with the map of the next coarser one.

    Attributes
    ----------
    settings : CascadeSettings
    """

    settings: CascadeSettings = field(default_factory=CascadeSettings)

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        chosen, levels = self.settings, _Levels(outer, monitor)
        weight, distortion = chosen.regularisation, chosen.distortion
        minimised = f"the energy with {distortion} weighted {weight:g} of its estimated error"
        figures = partial(CascadeFigures, "newton", weight, distortion, minimised)
        monitor.work += Work(ESTIMATE_SOLVES)
        given = outer.problem, chosen, levels, monitor.budget, outer.contact
        maps = monitor.attempt(lambda: cascade(*given))
        if maps is None:
            return Outcome(outer, levels.best(outer), monitor.end, details=(figures(),))
        with monitor.budget.during("build"):
            if maps.built is None:
                end = outer.minimising(maps.objective)
            else:
                end = Outer.around(maps.built, outer.tolerance)
        end = monitor.tracked(end.knowing(maps.gain_estimate))
        q = maps.q if end.is_valid(maps.q) else np.zeros(end.n)
        said = [f"over meshes of {', '.join(str(level.nodes) for level in maps.levels)} nodes"]
        if parts := [f"{level.taken:g} on {level.nodes} nodes" for level in maps.levels if level.taken < 1]:
            taken = f"of a prolonged map a part was taken ({', '.join(parts)})"
            said.append(f"{taken}, since more did not lower the energy")
        return Outcome(
            end, q, maps.status, details=(figures(maps.record(), maps.gain_estimate),), remarks=tuple(said)
        )


class _Levels:
    """What listens to a cascade: :data:`rmesh_nlp.models.cascade.OnStep`."""

    def __init__(self, outer: Outer, monitor: Monitor) -> None:
        self._outer, self._monitor = outer, monitor
        self._track: Track | None = None
        self._first = 0
        self._last: Array | None = None
        self._map: tuple[Array, NDArray[np.int64], Array] | None = None

    def __call__(self, iteration: int, energy: ReducedEnergy, q: Array, value: float) -> bool:
        """Note an iteration; whether to stop."""
        track = self._track
        if track is None or track.outer.energy is not energy:
            track = self._track = self._monitor.track(Outer.around(energy, self._outer.tolerance))
            self._first = iteration
        mesh = energy.relocation.problem.mesh
        if mesh.p.shape[1] == self._outer.problem.mesh.p.shape[1]:
            self._last = np.array(q)
        else:
            self._map = mesh.p, energy.relocation.problem.triangles, energy.relocation.nodes(q) - mesh.p
        given = track.outer.given.energy
        return track.exact(iteration - self._first, q, energy(q), energy_given=given)

    def best(self, outer: Outer) -> Array:
        """The last ones on the given mesh, which are the best; if it was not reached, the map so far."""
        if self._last is not None:
            return self._last
        if self._map is None:
            return np.zeros(outer.n)
        q = prolonged(*self._map, outer.discretisation)
        while not outer.is_valid(q):
            q = 0.5 * q
        return q


@dataclass(frozen=True)
class Descent(Formulation):
    """A few iterations of Newton-CG with local trust regions, for an energy with a distortion.

    Attributes
    ----------
    end : float
        It ends where the model predicts less than this part of what there is to gain.
    iterations : int
    """

    end: Positive = 3e-4
    iterations: Count = 10

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        track, energy = monitor.track(outer), outer.energy
        gain = monitor.estimate(outer)
        descent = descend(
            energy,
            q,
            gain_tolerance=self.end,
            reference=energy(q).value + gain,
            max_iterations=self.iterations,
            on_step=lambda iteration, x, _: track.exact(iteration, x, energy(x)),
        )
        monitor.check()
        return Outcome(outer, descent.x, descent.status)


@dataclass(frozen=True)
class Polished(Wrapper):
    """Goes on from the end of a formulation to a stationary point.

    Attributes
    ----------
    nodes : int
        Largest number of nodes of a mesh where it does.
    finish : int
        Limit of the iterations.
    most : int
        Contact solves of all together after which it does not.
    """

    nodes: Limit = CascadeSettings.stationary
    finish: Count = CascadeSettings.finish
    most: Count = CascadeSettings.most

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        outcome = monitor.run(self.inner, outer, q)
        end, q = outcome.outer, outcome.q
        small = q.size > 0 and end.problem.mesh.p.shape[1] <= self.nodes
        if monitor.is_over() or not small or not end.objective.has_barrier or not end.is_valid(q):
            return outcome
        energy = end.energy
        if end.residual(energy(q)) <= end.tolerance:
            return outcome
        began, before = processor_seconds(), energy.contact_solves
        last = before + max(self.most - monitor.spent.contact_solves - SPARE, 1)
        track, begin = monitor.track(end), q
        finish = monitor.attempt(
            lambda: finished(
                energy,
                begin,
                end.residual,
                tolerance=end.tolerance,
                reference=energy(begin).value + (end.gain or 0.0),
                max_iterations=self.finish,
                on_step=lambda i, x, _: (
                    track.exact(i, x, energy(x), energy_given=end.given.energy)
                    or energy.contact_solves >= last
                ),
            )
        )
        if finish is None:
            return outcome.having(q=track.best(q), status=monitor.end)
        x, status = finish.result.x, finish.result.status
        if status is Status.INTERRUPTED:
            status = monitor.stopped or Status.ITERATION_LIMIT
        figures = {
            "iterations": finish.result.iterations,
            "products": finish.result.products,
            "contact_solves": energy.contact_solves - before,
            "factorisations": finish.factorisations,
            "seconds": processor_seconds() - began,
        }
        continuous = end.assessor.solve(end.nodes(x), energy(x).equilibrium.active)
        if not (end.is_valid(x) and continuous.energy <= end.assessor.initial.energy):
            return outcome
        return outcome.having(FinishWork(figures), q=x, status=status)
