"""Valid problem files."""

VALID = """\
name = "block"
quadrature = 4

[mesh]
shape = "rectangle"
nx = 8
ny = 3
x = [0, 4]

[boundaries]
load = "y == 1 and x > 2"

[subdomains]
hard = "x > 2"
soft = "x < 2"

[materials.hard]
law = "plane-strain"
young = 2.2e4
poisson = 0.3
body_force = [0, "-20*x"]

[materials.soft]
law = "plane-strain"
lame_lambda = 1.15e4
lame_mu = 0.83e4

[dirichlet]
left = [0, "0*y"]
right = ["free", 0.0]

[tractions]
load = [0, "-30*sin(pi*x/4)"]

[contact]
boundary = "bottom"
height = "-0.01*x**2"
friction = "10 + x"

[motion]
delta = { relative = 0.3 }
pinned = ["top", 0]
min_area_fraction = 0.02

[solve]
formulation = "joint"
"""

SCALAR = """\
[mesh]
shape = "rectangle"
nx = 4
ny = 4

[material]
law = "laplace"
source = "sin(2*pi*x)*y"

[dirichlet]
left = 0
top = "x*(1-x)"

[contact]
interior = -0.1

[motion]
delta = "none"
min_angle = 5
"""

TWO = VALID.replace("[contact]", "[[contact]]\nboundary = 'top'\noffset = 0.1\n[[contact]]")

PLATE = """\
mesh = { shape = "plate-with-hole", h = 2.0 }
material = { law = "plane-strain", young = 1000.0, poisson = 0.3 }
dirichlet = { left = [0.0, 0.0] }
[motion]
delta = "none"
[curves]
hole = "circle"
"""

DESIGN = """\
[mesh]
shape = "rectangle"
nx = 6
ny = 3
x = [0.0, 4.0]
y = [0.0, 1.0]
[material]
law = "plane-strain"
young = "20000*E"
poisson = 0.3
body_force = ["load*x", 0.0]
[dirichlet]
top = [0.0, 0.0]
[contact]
boundary = "bottom"
height = "h0 + 0.01*x"
coulomb = "F"
[tractions]
right = ["20*load", 0.0]
[design]
E = { start = 1.0, bounds = [0.5, 2.0] }
F = { start = 0.1, bounds = [0.0, 0.5] }
h0 = { start = 0.02, bounds = [-0.02, 0.04] }
load = { start = 1.0, bounds = [0.5, 2.0] }
[design.shapes]
bow = { boundary = "bottom", motion = ["0", "x*(4-x)/4"], bounds = [-0.02, 0.03] }
[[constraints]]
value = "boundary(bottom, uy)"
bounds = [0.01, inf]
[[constraints]]
value = "max-pressure(bottom)"
bounds = [-inf, 900.0]
"""

FILES = {"block": VALID, "membrane": SCALAR, "two": TWO, "plate": PLATE, "design": DESIGN}
"""All of them by name."""
