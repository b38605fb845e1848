"""Conditions of a Pyomo model as rows of a ``.nl`` file, those with both bounds on one side included."""

from __future__ import annotations

from typing import Any

from pyomo.core.base import Constraint, Objective, Var, value
from pyomo.core.expr.visitor import identify_variables
from pyomo.mpec.plugins.mpec4 import MPEC4_Transformation

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
