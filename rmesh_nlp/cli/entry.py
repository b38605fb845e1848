"""Entry points of the commands ``rmesh`` and ``rmesh-mpcc``: Ctrl-C is one line, also while they load."""

from __future__ import annotations

import os
import sys

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables of the threads of linear algebra, which are read when numpy is imported."""


def main() -> None:
    """Run the command line; linear algebra takes one thread unless the environment says otherwise."""
    if not any(name in os.environ for name in THREADS):
        os.environ.update(dict.fromkeys(THREADS, "1"))
    sys.exit(_run(sys.argv[1:]))


def mpcc() -> None:
    """Run ``rmesh mpcc``."""
    sys.argv[1:] = ["mpcc", *sys.argv[1:]]
    main()


def _run(words: list[str]) -> int:
    try:
        # what is loaded with these takes most of a second
        from rmesh_nlp.cli.app import run
        from rmesh_nlp.optimize.budget import end_like_interrupts

        end_like_interrupts()
        return run(words)
    except KeyboardInterrupt:
        from rmesh_nlp.errors import Exit

        print("rmesh: interrupted", file=sys.stderr)
        return Exit.INTERRUPTED
