"""A ``.nl`` file written by hand from the specification, and its binary form."""

import struct

# min (x - 1)^2 + exp(y) - 2 z,  x + z <= 5,  0 <= y _|_ x + y - 1 >= 0,  -1 <= z <= 2 _|_ x^2 + z - 3
NL = """g3 1 1 0	# problem handmade
 3 3 1 0 0	# vars, constraints, objectives, ranges, eqns
 1 1 1 0 0 0	# nonlinear constrs, objs; ccons: lin, nonlin, nd, nzlb
 0 0	# network constraints: nonlinear, linear
 1 2 1	# nonlinear vars in constraints, objectives, both
 0 0 0 1	# linear network variables; functions; arith, flags
 0 0 0 0 0	# discrete variables: binary, integer, nonlinear (b,c,o)
 6 3	# nonzeros in Jacobian, obj. gradient
 0 0	# max name lengths: constraints, variables
 0 0 0 0 0	# common exprs: b,c,o,c1,o1
C0	# mixed
o54	# sumlist
3
o5	# ^
v0	# x
n2
n-3
n0
C1	# orthant
n-1
C2	# sum
n0
O0 0	# cost
o0	#+
o76	# square
o1	# -
v0
n1
o44	# exp
v1
x2	# initial guess
0 0.5
1 0.2
r	# bounds of rows
5 3 3	# complements z, both bounds
5 1 2	# complements y, lower bound
1 5
b	# bounds of unknowns
3
2 0
0 -1 2
k2
2
4
J0 2
0 0
2 1
J1 2
0 1
1 1
J2 2
0 1
2 1
G0 3
0 0
1 0
2 -2
"""


SOLUTION = [1, 0, 2], -3.0
"""z wants to grow, so z = 2 with x^2 + z - 3 <= 0, |x| <= 1; x = 1 and y = 0: f = 0 + 1 - 4."""


def binary(text: str, order: str = "<") -> bytes:
    """The binary form of a text file without names: letters are bytes, whole numbers 4 bytes, real ones 8."""
    lines = [line.split("#", 1)[0].split() for line in text.splitlines()]
    header = [["b" + lines[0][0][1:], *lines[0][1:]], *lines[1:10]]
    header[5][2] = "1" if order == "<" else "2"  # the kind of arithmetic
    found = "".join(f"{' '.join(words)}\n" for words in header).encode()
    segment = ""
    for first, *words in lines[10:]:
        is_bound = segment in ("r", "b") and first.isdigit()
        if first[0].isalpha() or is_bound:
            if first[0] in "CVOxrbkJG":
                segment = first[0]
            found += first[0].encode()
            numbers = [word for word in (first[1:], *words) if word]
            kind = "d" if first[0] == "n" or (is_bound and first != "5") else "i"
            kinds = kind * len(numbers)
        else:
            numbers, kinds = [first, *words], "id"[: 1 + len(words)]
        values = [float(n) if kind == "d" else int(n) for n, kind in zip(numbers, kinds, strict=True)]
        found += struct.pack(order + kinds, *values)
    return found
