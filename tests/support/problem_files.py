"""Valid problem files, and ways to break one."""

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

BROKEN: list[tuple[str, str, str]] = [
    ('name = "block"', 'name = block', 'is not valid TOML'),
    ('[motion]', '[motion', 'is not valid TOML'),
    ('[contact]', '[contacts]', "contacts = {'boundary'"),
    ('young = 2.2e4', 'youngs = 2.2e4',
     "materials.hard.youngs = 22000.0: unknown key, did you mean 'young'?"),
    ('pinned =', 'pined =', "motion.pined = ['top', 0]: unknown key, did you mean 'pinned'?"),
    ('quadrature = 4', 'quadratur = 4', "quadratur = 4: unknown key, did you mean 'quadrature'?"),
    ('{ relative = 0.3 }', '{ relativ = 0.3 }',
     "motion.delta = {'relativ': 0.3}: expected a positive number"),
    ('[mesh]\nshape = "rectangle"\nnx = 8\nny = 3\nx = [0, 4]', '',
     'mesh = nothing: expected, but it is missing'),
    ('nx = 8\n', '', "mesh.nx = nothing: the shape 'rectangle' needs it"),
    ('shape = "rectangle"\n', '', 'expected either a file or a shape'),
    ('poisson = 0.3\n', '', 'expected either young and poisson, or lame_lambda and lame_mu'),
    ('law = "plane-strain"\nyoung', 'young', 'materials.hard.law = nothing: expected, but it is missing'),
    ('boundary = "bottom"\n', '', 'expected either a boundary or interior'),
    ('left = [0, "0*y"]\nright = ["free", 0.0]\n', '', 'can still move as a rigid body'),
    ('quadrature = 4', 'quadrature = "simpson"',
     "quadrature = 'simpson': expected 'auto', 'midpoint' or a degree from 1 to 50"),
    ('quadrature = 4', 'order = 0', 'order = 0: expected 1 for linear displacements or 2 for quadratic ones'),
    ('quadrature = 4', 'order = 3', 'order = 3: expected 1 for linear'),
    ('quadrature = 4', 'order = "two"', "order = 'two': expected 1 for linear"),
    ('quadrature = 4', 'order = 2.0', 'order = 2.0: expected 1 for linear'),
    ('quadrature = 4', 'order = true', 'order = True: expected 1 for linear'),
    ('quadrature = 4', 'order = [1, 2]', 'order = [1, 2]: expected 1 for linear'),
    ('nx = 8', 'nx = 8\norder = 2', 'mesh.order = 2: unknown key here: it belongs at the top of the file'),
    ('name = "block"', 'name = 3', 'name = 3: expected a text'),
    ('nx = 8', 'nx = 8.5', 'mesh.nx = 8.5: expected a whole number from 1 to 10000'),
    ('nx = 8', 'nx = 0', 'mesh.nx = 0: expected a whole number from 1 to 10000'),
    ('x = [0, 4]', 'x = [0, 4, 8]', 'mesh.x = [0, 4, 8]: expected two numbers'),
    ('x = [0, 4]', 'x = [4, 0]', 'x must be two increasing numbers, got (4.0, 0.0)'),
    ('shape = "rectangle"', 'shape = "circle"', "mesh.shape = 'circle': expected 'rectangle', 'l-shape'"),
    ('shape = "rectangle"', 'file = "body.msh"', 'mesh.nx = 8: a mesh from a file takes file'),
    ('nx = 8\nny = 3', 'nx = 9000\nny = 9000', 'would be a mesh of about 2e+08 triangles'),
    ('left = [0', 'lft = [0', "expected a boundary of the mesh, did you mean 'left'?"),
    ('load = [0, "-30', 'laod = [0, "-30', 'tractions.laod'),
    ('boundary = "bottom"', 'boundary = "botom"',
     "contact.boundary = 'botom': expected a boundary of the mesh, did you mean 'bottom'?"),
    ('["top", 0]', '["tip", 0]',
     "motion.pinned = ['tip', 0]: expected a boundary of the mesh, did you mean 'top'?"),
    ('["top", 0]', '["top", 999]', 'the motion names node 999; nodes run from 0 to 35'),
    ('[materials.soft]', '[materials.sofd]', "expected a subdomain of the mesh, did you mean 'soft'?"),
    ('hard = "x > 2"', 'hard = "x > 1"', 'has 2 laws: every element needs exactly one'),
    ('load = "y == 1 and x > 2"', 'load = "y == 7"',
     "boundaries.load = 'y == 7': the boundary 'load' is empty"),
    ('load = "y == 1 and x > 2"', 'load = 3', 'boundaries.load = 3: expected a condition on x and y'),
    ('"-20*x"', '"x.__class__"', "'x.__class__' is not allowed in an expression"),
    ('"-20*x"', '"-20*sine(x)"', "unknown function 'sine', did you mean 'sin'?"),
    ('"-0.01*x**2"', '"sqrt(x - 1)"', "contact.height = 'sqrt(x - 1)': the obstacle is nan at (0, 0)"),
    ('"-20*x"', '"log(x - 3)"',
     "hard.body_force = [0.0, 'log(x - 3)']: component 2 of the body force of 'hard' is nan at (2, 0)"),
    ('"-30*sin(pi*x/4)"', '"-20*sqrt(x-10)"',
     "tractions.load = [0.0, '-20*sqrt(x-10)']: component 2 of the traction on 'load' is nan at (2, 1)"),
    ('"0*y"', '"log(y - 2)"', "left = [0.0, 'log(y - 2)']: the displacement given on 'left' is nan at"),
    ('"10 + x"', '"1/(x - 4)**2"', "friction = '1/(x - 4)**2': the friction bound is inf at (4, 0)"),
    ('poisson = 0.3', 'poisson = 0.5', 'materials.hard.poisson = 0.5: expected a number between -1 and 0.5'),
    ('young = 2.2e4', 'young = -1', 'materials.hard.young = -1: expected a positive number'),
    ('lame_mu = 0.83e4', 'young = 1.0', 'expected either young and poisson, or lame_lambda and lame_mu'),
    ('lame_mu = 0.83e4', 'lame_mu = 0.83e4\nsource = 1',
     "materials.soft.source = 1.0: the law 'plane-strain' takes"),
    ('law = "plane-strain"\nyoung', 'law = "plane"\nyoung',
     "materials.hard.law = 'plane': expected 'laplace'"),
    ('left = [0, "0*y"]', 'left = 0', 'dirichlet.left = [0.0]: expected 2 values'),
    ('left = [0, "0*y"]', 'left = [0, 0, 0]', 'dirichlet.left = [0, 0, 0]: expected one value, or two'),
    ('"10 + x"', '"x - 1"', "contact.friction = 'x - 1': the friction bound must not be negative"),
    ('height = "-0.01*x**2"', 'height = 0\noffset = 0',
     'expected one way to say where the obstacle is, got offset and height'),
    ('height = "-0.01*x**2"', 'line = { point = [0, 0], normal = [0, 0] }', 'must be a non-zero vector'),
    ('height = "-0.01*x**2"', 'points = [[0, 0], [0, 1]]', 'breakpoints must increase'),
    ('{ relative = 0.3 }', '-0.1', 'motion.delta = -0.1: expected a positive number, two of them'),
    ('min_area_fraction = 0.02', 'min_area_fraction = 2',
     'motion.min_area_fraction = 2: expected a number between 0 and 1'),
    ('min_area_fraction = 0.02', 'min_angle = 50', 'min_angle is 50.0 degrees, but element'),
    ('min_area_fraction = 0.02', 'tied = [[1, 2, 3]]',
     'motion.tied = [[1, 2, 3]]: expected pairs of node numbers'),
    ('formulation = "joint"', 'seed = -1', 'solve.seed = -1: expected a whole number of at least 0'),
    ('formulation = "joint"', 'starts = 2\nseed = 1', 'expected starts alone, without a seed'),
]  # fmt: skip
"""What is replaced by what, and what the one line of the error must say."""
