"""A small collection of MPCCs in the form that the benchmarks take."""

MPCC_COLLECTION = """
import casadi as ca

def names():
    return ["corner", "arms"]

def get(name):
    x = ca.SX.sym("x", 2)
    centre = {"corner": -1.0, "arms": 1.0}[name]
    inf = float("inf")
    return dict(x=x, f=ca.sumsqr(x - centre), g=ca.SX(0, 1), G=x[0], H=x[1], lbx=[-inf] * 2, ubx=[inf] * 2,
                lbg=[], ubg=[], x0=[0.5, 0.2], target={"corner": 2.0, "arms": 0.5}[name])
"""
"""Two MPCCs in the form of a collection that the benchmarks take."""
