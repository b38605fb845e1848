"""``SolverFactory("rmesh-mpcc")`` of Pyomo, once this module is imported.

Without it Pyomo finds the executable ``rmesh-mpcc`` on the PATH and calls it as any AMPL solver. What is
added here: conditions with both bounds on one side, ``l <= y <= u`` against an expression, which Pyomo 6.10
does not write; bounds of a variable beside those of its condition, which it merges; ``timelimit=`` reaches
the solver, which then returns its best point; the model may be solved again without warnings, and keeps its
bounds; neither a PATH nor a process is needed.
"""

from __future__ import annotations

from typing import Any

from pyomo.opt import SolverFactory
from pyomo.solvers.plugins.solvers.ASL import ASL

from rmesh_nlp import __version__
from rmesh_nlp.mpcc import ampl
from rmesh_nlp.mpcc.pyomo_model import conditions_as_rows

_NAME = "rmesh-mpcc"


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
        return tuple(map(int, __version__.split(".")[:3]))

    def solve(self, model: Any, **keywords: Any) -> Any:
        """As any solver of Pyomo; the model keeps its conditions and its bounds."""
        with conditions_as_rows(model) as written:
            return super().solve(model, **written, **keywords)

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
