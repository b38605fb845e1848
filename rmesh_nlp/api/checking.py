"""What looks wrong about a problem before it is solved."""

from __future__ import annotations

from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.setup_warnings import curve_warnings, penetration_warnings, setup_warnings
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import expect
from rmesh_nlp.problem import ContactProblem


def check(problem: ContactProblem) -> list[str]:
    """Say what looks wrong about a problem, in sentences, after a contact solve on its mesh as given.

    Such as a foundation that overlaps the body, a load that the mesh does not see, or a curved boundary
    without a curve. ``rmesh check FILE`` prints them.
    """
    expect("problem", problem, ContactProblem)
    model = ContactSolver(problem.at_design())
    space, u = model.discretisation.space, model.displacement.values(model.given.u)
    passing = penetrations(space, model.problem.mesh.p, u)
    signs = (*curve_warnings(problem), *setup_warnings(model), *penetration_warnings(passing))
    return [sign.message for sign in signs]
