"""``SolverFactory("rmesh-mpcc")`` of Pyomo, once this module is imported.

Without it Pyomo finds the executable ``rmesh-mpcc`` on the PATH and calls it as any AMPL solver. What is
added here: conditions with both bounds on one side, ``l <= y <= u`` against an expression, which Pyomo 6.10
does not write; ``timelimit=`` reaches the solver, which then returns its best point; the model may be solved
again without warnings, and keeps its bounds; neither a PATH nor a process is needed.
"""

from __future__ import annotations

from typing import Any

from pyomo.core.base import Constraint, Objective, Var, value
from pyomo.core.expr.visitor import identify_variables
from pyomo.mpec import Complementarity
from pyomo.mpec.plugins.mpec4 import MPEC4_Transformation
from pyomo.opt import SolverFactory
from pyomo.solvers.plugins.solvers.ASL import ASL

from rmesh_nlp import __version__
from rmesh_nlp.mpcc import ampl

_NAME = "rmesh-mpcc"
_ADDED = ("bv", "v", "c", "bc", "e")  # by the transformation, to each condition


class Transformation(MPEC4_Transformation):
    """Pyomo's ``mpec.nl``, with mixed conditions, and again for a model that it was applied to before."""

    def _apply_to(self, instance: Any, **keywords: Any) -> None:
        parts = instance.component_data_objects((Constraint, Objective), active=True, descend_into=True)
        self._used = {id(var) for part in parts for var in identify_variables(part.expr, include_fixed=False)}
        super()._apply_to(instance, **keywords)

    def to_common_form(self, cdata: Any, free_vars: dict[int, Any]) -> None:
        """Write a condition as a constraint ``c`` that complements a variable."""
        for name in _ADDED:
            if cdata.component(name) is not None:
                cdata.del_component(name)
        if len(cdata._args) != 2:
            raise ValueError(f"the condition {cdata.name} is not a pair")
        members = [cdata._canonical_expression(member) for member in cdata._args]
        for member in members:  # the writer knows only variables that are in a row or the objective
            if id(member[1]) not in self._used:
                free_vars.pop(id(member[1]), None)
        bare = [len(member) == 3 and member[0] is None and member[2] is None for member in members]
        both = [len(member) == 3 and member[0] is not None and member[2] is not None for member in members]
        if (bare[0] and both[1]) or (bare[1] and both[0]):
            self._mixed(cdata, members[bare.index(True)][1], members[both.index(True)], free_vars)
        else:
            super().to_common_form(cdata, free_vars)

    def _mixed(self, cdata: Any, body: Any, bounded: Any, free_vars: dict[int, Any]) -> None:
        lower, variable, upper = bounded
        if free_vars.pop(id(variable), None) is None:
            cdata.v = Var()
            cdata.e = Constraint(expr=cdata.v == variable)
            variable = cdata.v
        cdata.bv = Var()
        cdata.bc = Constraint(expr=cdata.bv == body)
        # the writer leaves out rows without bounds, and constants of rows that complement; it ignores -1, 1
        cdata.c = Constraint(expr=(-1, cdata.bv, 1))
        cdata.c._vid, cdata.c._complementarity = id(variable), 3
        variable.setlb(lower if variable.lb is None else max(value(lower), variable.lb))
        variable.setub(upper if variable.ub is None else min(value(upper), variable.ub))


@SolverFactory.register(_NAME, doc="The MPCC solver of rmesh_nlp")
class PyomoSolver(ASL):
    """The solver for Pyomo, by AMPL's files; options are those of the command, ``ipopt.NAME`` included."""

    _timelimit: float | None
    _tee: bool

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**{**keywords, "type": _NAME})

    def _default_executable(self) -> str:
        return _NAME  # no other process is started

    def _get_version(self) -> tuple[int, ...]:
        return tuple(int(part) for part in __version__.split(".")[:3])

    def solve(self, model: Any, **keywords: Any) -> Any:
        """As any solver of Pyomo; the model keeps its conditions and its bounds."""
        conditions = list(model.component_objects(Complementarity, active=True, descend_into=True))
        variables = list(model.component_data_objects(Var, active=True, descend_into=True))
        bounds = [(variable.lower, variable.upper) for variable in variables]
        Transformation().apply_to(model)
        try:
            return super().solve(model, **keywords)
        finally:
            for condition in conditions:
                condition.parent_block().reclassify_component_type(condition, Complementarity)
            for variable, (lower, upper) in zip(variables, bounds, strict=True):
                variable.lower, variable.upper = lower, upper

    def create_command_line(self, executable: str, problem_files: Any) -> Any:
        """As of any AMPL solver, with the time limit among the options."""
        self.options.solver = _NAME
        if self._timelimit is not None:
            self.options.setdefault("time_limit_s", self._timelimit)
        return super().create_command_line(executable, problem_files)

    def _execute_command(self, command: Any) -> tuple[int, str]:
        words = [*command.cmd[1:], *([] if self._tee else ["outlev=0"])]
        try:
            return ampl.run(words), ""
        except ValueError as error:
            return 2, str(error)
