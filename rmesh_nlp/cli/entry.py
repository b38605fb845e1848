"""Entry points of the commands ``rmesh`` and ``rmesh-mpcc``: Ctrl-C is one line, also while they load."""

from __future__ import annotations

import os
import sys

from rmesh_nlp.cli import load

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables of the threads of linear algebra, which are read when numpy is imported."""


def main() -> None:
    """Run the command line; linear algebra takes one thread unless the environment says otherwise."""
    if not any(name in os.environ for name in THREADS):
        os.environ.update(dict.fromkeys(THREADS, "1"))
    load("optimize.budget").end_like_interrupts()
    sys.exit(load("cli.app").run(sys.argv[1:]))


def mpcc() -> None:
    """Run ``rmesh mpcc``."""
    sys.argv[1:] = ["mpcc", *sys.argv[1:]]
    main()
