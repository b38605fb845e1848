"""Random Pyomo models with every form of condition against all their branches, each a linear program."""

import itertools
from collections import Counter

import numpy as np
import pytest
from scipy.optimize import linprog

N = 4  # variables


def random_model(pe, mpec, random):
    """A model of linear parts; its cost, its box and its branches, each of rows (a, low, high)."""
    m = pe.ConcreteModel()
    box = np.sort(random.permuted(np.tile(np.arange(-4.0, 5.0), (N, 1)), axis=1)[:, :2])
    m.v = pe.Var(range(N), initialize=lambda m, i: box[i].mean(), bounds=lambda m, i: tuple(box[i]))
    for i in np.flatnonzero(random.random(N) < 0.15):
        m.v[i].fix(float(random.integers(box[i, 0], box[i, 1] + 1)))
        box[i] = m.v[i].value
    cost, sign = random.integers(-3, 4, N) * (random.random(N) < 0.7), int(random.choice([1, -1]))
    m.f = pe.Objective(expr=sum(int(c) * m.v[i] for i, c in enumerate(cost)) + m.v[0] * 1e-3, sense=sign)
    m.p = pe.Param(initialize=float(random.integers(-1, 2)), mutable=True)
    forms, branches = [], []

    def member():
        """A row, its constant and its expression: a variable, or a sum that may have zero coefficients."""
        if random.random() < 0.5:
            i = int(random.integers(N))
            return np.eye(N)[i], 0.0, m.v[i]
        a, constant = random.integers(-2, 3, N).astype(float), float(random.integers(-1, 2))
        return a, constant, sum(a[i] * m.v[i] for i in range(N)) + constant

    for _ in range(int(random.integers(1, 4))):
        (a, s, first), (b, t, second) = sides = member(), member()
        low, high = np.sort(random.choice(np.arange(-2.0, 3.0), 2))
        match random.choice(["one on each side", "both on one side", "equation"]):
            case "one on each side":
                form, rooms = [], []
                for row, constant, body in sides:
                    kind, up = random.integers(3), bool(random.integers(2))
                    j, q = int(random.integers(N)), float(random.integers(-2, 3))
                    row = row - np.eye(N)[j] if kind == 0 else row
                    constant -= (0.0, m.p.value, q)[kind]
                    other = (m.v[j], m.p, q)[kind]
                    form.append(body >= other if up else body <= other)
                    rooms.append((row, -constant) if up else (-row, constant))
                (a, s), (b, t) = rooms
                rows = [[(a, s, s), (b, t, np.inf)], [(a, s, np.inf), (b, t, t)]]
            case "both on one side":
                form, low, high = [pe.inequality(low, first, high), second], low - s, high - s
                rows = [
                    [(a, low, low), (b, -t, np.inf)],
                    [(a, low, high), (b, -t, -t)],
                    [(a, high, high), (b, -np.inf, -t)],
                ]
            case "equation":
                form, rows = [first == low, second], [[(a, low - s, low - s)]]
        forms.append(mpec.complements(*form[:: random.choice([1, -1])]))
        branches.append(rows)
    indexed = random.random() < 0.5
    m.all = mpec.Complementarity(range(len(forms) if indexed else 0), rule=lambda m, i: forms[i])
    for form in [] if indexed else forms:
        m.add_component(f"pair{len(list(m.component_objects()))}", mpec.Complementarity(expr=form))
    return (
        m,
        sign * (cost + 1e-3 * np.eye(N)[0]),
        box,
        [list(itertools.chain(*part)) for part in itertools.product(*branches)],
    )


def least(cost, box, rows):
    """Least cost on a branch, infinite if it is empty."""
    a, low, high = (np.array(part) for part in zip(*rows, strict=True))
    matrix, bound = np.vstack([a, -a]), np.append(high, -low)
    kept = np.isfinite(bound)
    found = linprog(cost, A_ub=matrix[kept], b_ub=bound[kept], bounds=box)
    return found.fun if found.status == 0 else np.inf


def judged(pe, mpec, seed):
    """What a solve ended with: right where it is the least of each branch that it lies in."""
    m, cost, box, branches = random_model(pe, mpec, np.random.default_rng(seed))
    values = [least(cost, box, rows) for rows in branches]
    found = pe.SolverFactory("rmesh-mpcc").solve(m)
    if found.solver.termination_condition != "optimal":
        return "infeasible" if np.isinf(values).all() else "lost"
    x = np.array([box[i, 0] if m.v[i].value is None else m.v[i].value for i in range(N)])
    inside = np.all((x > box[:, 0] - 1e-6) & (x < box[:, 1] + 1e-6))
    own = [
        value
        for value, rows in zip(values, branches, strict=True)
        if inside and all(low - 1e-6 <= a @ x <= high + 1e-6 for a, low, high in rows)
    ]
    return "right" if own and cost @ x <= min(own) + 1e-5 else "wrong"


@pytest.mark.slow
def test_ends_are_feasible_and_least_on_their_branches():
    """200 models: bounds of the variables and of the conditions, fixed ones, parameters, maxima."""
    pe, mpec = (pytest.importorskip(f"pyomo.{name}") for name in ("environ", "mpec"))
    import rmesh_nlp.mpcc.pyomo_solver  # noqa: F401

    counts = Counter(judged(pe, mpec, seed) for seed in range(200))
    assert counts["wrong"] == counts["lost"] == 0
    assert counts["right"] > 70
