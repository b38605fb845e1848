"""The commented template that ``rmesh new --study`` writes: a valid study that takes some seconds."""

TEMPLATE = """# A study for rmesh: every problem by every formulation, one row each.
# Check it:  rmesh check {file}       Plan it:  rmesh study {file} --out {name} --dry-run
# Run it:    rmesh study {file} --out {name} --jobs 2
# Run the last command again at any moment: it goes on where it was.

name = "{name}"
question = "How far does relocation lower the energy, and at what cost?"

# --- problems -------------------------------------------------------------------------------
examples = ["6.1"]               # of the paper: "6.1", "6.2", "6.3"
sizes = [4, 6]                   # squares per side, or "12x6"; or {{ "6.1" = [8], "6.2" = ["12x6"] }}
# files = ["my.toml"]            # problem files, relative to this one
random = {{ seed = 0, count = 4 }} # random contact problems, of
#                                  kinds = ["scalar", "membrane", "elastic", "rough"]
quadrature = 8                   # of the examples: a degree, or "midpoint", the paper's rule, whose error
#                                  relocation can exploit on coarse meshes: such a row is no success

# --- what is varied -------------------------------------------------------------------------
formulations = ["fixed", "auto"] # or nested, joint, mpcc, which do as they are told: over a curved
#                                  foundation auto lets gaps hold along edges, they hold them at nodes only
# or with settings, each under a name of its own:
#   [formulations.newton]
#   formulation = "nested"
#   outer = "newton"
# objectives = ["energy"]        # outer objectives
# seeds = ["given", 1, 2]        # starts: the mesh as given, and random ones
# repeats = 3                    # for times: tables then show medians and ranges
# fields = true                  # keep meshes and fields of every solve, for figures and the report
# certify = true                 # bound the error of every solve

[limits]                         # of each solve; a solve that exceeds them is a row with its status
time = 60.0                      # seconds
memory = 4000.0                  # megabytes
# iterations = 500
"""


def template(name: str, file: str) -> str:
    """The template for a study called ``name`` in ``file``."""
    return TEMPLATE.format(name=name, file=file)
