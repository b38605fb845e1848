"""Problems seen from another frame: x = turn @ X + shift."""

from dataclasses import replace
from typing import Any

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Laplace, at


def turned(problem: ContactProblem, turn: Array, shift: Array) -> ContactProblem:
    """The same problem, its functions of position and its vectors with it."""

    def back(x: Any, y: Any) -> tuple[Any, Any]:
        a, b = x - shift[0], y - shift[1]
        return turn[0, 0] * a + turn[1, 0] * b, turn[0, 1] * a + turn[1, 1] * b

    def scalar(value: Any) -> Any:
        return (lambda x, y: value(*back(x, y))) if callable(value) else value

    def vector(values: Any) -> Any:
        if problem.components == 1:
            return tuple(map(scalar, values))
        if not any(map(callable, values)):
            return tuple(float(value) for value in turn @ values)
        first, second = map(scalar, values)
        return tuple(
            lambda x, y, i=i: turn[i, 0] * at(first, x, y) + turn[i, 1] * at(second, x, y) for i in range(2)
        )

    def material(law: Any) -> Any:
        if isinstance(law, Laplace):
            return replace(law, source=scalar(law.source))
        return replace(law, body_force=vector(law.body_force))

    law, obstacle = problem.law, problem.obstacle
    return replace(
        problem,
        mesh=replace(problem.mesh, doflocs=turn @ problem.mesh.p + shift[:, None]),
        law={name: material(each) for name, each in law.items()} if isinstance(law, dict) else material(law),
        dirichlet=tuple(replace(each, value=vector(each.value)) for each in problem.dirichlet),
        tractions=tuple(replace(each, value=vector(each.value)) for each in problem.tractions),
        obstacle=replace(
            obstacle,
            normal=vector(obstacle.normal),
            offset=scalar(obstacle.offset),
            friction=scalar(obstacle.friction),
        ),
    )
