"""The commented template that ``rmesh new`` writes: a valid problem file that solves in a second."""

TEMPLATE = """# A contact problem for rmesh. Check it:  rmesh check {file}
#                               Solve it:  rmesh solve {file}
# Lengths, forces and stresses are in one system of units of your choice.
# Where "number or expression" is said, an expression of x and y may stand as text, such as
# "sin(2*pi*x)*y". It may use + - * / **, comparisons, and, or, not, pi, sin cos tan asin acos atan
# atan2 sinh cosh tanh exp log sqrt abs min max hypot, and where(condition, a, b).

name = "{name}"
quadrature = "auto"              # rule for loads: "auto" (exact or of high degree), "midpoint", a degree

[mesh]
shape = "rectangle"              # boundaries left, right, bottom, top
nx = 16
ny = 4
x = [0.0, 4.0]
y = [0.0, 1.0]
# diagonal = "falling"           # or "rising"
# Other shapes (they need gmsh: pip install rmesh-nlp[gmsh]):
#   shape = "l-shape"            h, size                           boundaries corner, outer
#   shape = "plate-with-hole"    h, size, radius                   left, right, bottom, top, hole
#   shape = "half-disc"          h, radius, contact, h_contact     axis, top, arc, contact
#   shape = "wedge-block"        h, width, height, rise            left, right, top, wedge
#   shape = "polygon"            points = [[0, 0], ...], h         edge-0, edge-1, ...
# or a file that meshio reads, relative to this one; its groups are the names:
#   file = "body.msh"

[boundaries]                     # further names, by a condition on the midpoints of boundary edges
load = "y == 1 and x > 2"

# [subdomains]                   # further names, by a condition on the midpoints of triangles
# hard = "x > 2"

[material]                       # or one table [materials.<subdomain>] per subdomain
law = "plane-strain"             # "plane-strain", "plane-stress" or "laplace"
young = 21600.0                  # young and poisson, or lame_lambda and lame_mu
poisson = 0.3
body_force = [0.0, 0.0]          # numbers or expressions
# For "laplace":  source = "..."  (number or expression),  conductivity = 1.0

[dirichlet]                      # given displacements: numbers, expressions, or "free"
left = [0.0, 0.0]
# axis = "symmetry"              # a straight boundary on an axis of symmetry

[tractions]                      # loads per length of boundary: numbers or expressions
load = [0.0, -57.5]

# [[point_loads]]                # a force at the node at a place; its node does not move
# at = [4.0, 1.0]
# force = [0.0, -10.0]

[contact]                        # leave it out for no contact; [[contact]] several times for several
boundary = "bottom"
height = -0.05                   # foundation below the graph y = height: number or expression
# points = [[0, 0], [4, 0.1]]    # or a piecewise-linear graph
# line = {{ point = [0, 0], normal = [0, 1] }}   # or a rigid straight line; normal towards the body
# circle = {{ centre = [2, -9], radius = 9 }}   # or a rigid disc; inside = true for a round hole
# curve = "y - 0.01*x**2"        # or any curve: zero on it, positive where the body may be
# offset = 0.05                  # or the initial gap itself, along normal = [0, 1]
# friction = 10.0                # Tresca bound: number or expression
# gap = "edge"                   # gaps hold along edges too, not only at "node"s; chosen by auto for curves
# For a scalar problem with u >= psi in the whole domain, instead of boundary:  interior = "..."

[motion]
delta = {{ relative = 0.3 }}       # of the shortest edge at the node; or a number, or [dx, dy], or "none"
pinned = ["top"]                 # boundaries, or node numbers, that do not move
# slides = []                    # that slide on their straight piece although a part ends there
# free = []                      # that move freely; on the outer boundary this changes the domain
# tied = [[12, 40]]              # node 12 makes the moves of node 40
min_area_fraction = 0.01         # least area of an element over its given one; with delta = "none" auto
#                                  keeps areas positive by a barrier instead, unless min_angle is given
# min_angle = 5.0                # least angle of an element in degrees

# [curves]                       # what boundaries are parts of; their nodes slide along it
# hole = {{ circle = [5.0, 5.0, 2.5] }}   # centre and radius; or "circle", fitted to the nodes
# rim = {{ spline = [[0, 0], [1, 0.2], [2, 0.3], [3, 0.2]] }}   # or "spline", through the nodes
# cam = {{ x = "2*cos(t)", y = "sin(t)", t = [0, 6.2832], closed = true }}

# [units]                        # names for texts and pictures; nothing is converted
# length = "mm"
# force = "N"

# [path]                         # for rmesh path: the foundation moves in steps
# move = [0.0, 0.05]
# steps = 5
# contact = 1                    # which of several
# relocate = "each"              # in each step, "once" for all, or "never"

[solve]                          # defaults of rmesh solve
formulation = "auto"             # chosen for the problem; or fixed, nested, joint, mpcc
# objective = "energy"
# seed = 1                       # a random start instead of the mesh as given
# starts = 4                     # as many random starts besides; the best counts, the spread is reported
# regularisation = 0.01          # weight of the distortion, for large moves without boxes; or a schedule
# flips = true                   # flip edges by energy between relocations
# levels = 1                     # optimise on this mesh, refine it, go on; as many times
# certify = true                 # bound the error in the energy norm, before and after
"""


def template(name: str, file: str) -> str:
    """The template for a problem called ``name`` in ``file``."""
    return TEMPLATE.format(name=name, file=file)
