"""Entry points of the commands ``rmesh`` and ``rmesh-mpcc``: Ctrl-C is one line, also while they load."""

from __future__ import annotations

import os
import signal
import sys

from rmesh_nlp.cli import hand_over, leave, load

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables of the threads of linear algebra, which are read when numpy is imported."""


def main() -> None:
    """Run the command line; linear algebra takes one thread unless the environment says otherwise.

    A request to terminate, SIGTERM, ends what runs as Ctrl-C does: with all that was reached kept.
    """
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        if not any(name in os.environ for name in THREADS):
            os.environ.update(dict.fromkeys(THREADS, "1"))
        code = load("cli.app").run(sys.argv[1:])
        hand_over(leave)  # nothing is left to keep while the interpreter ends
    except KeyboardInterrupt:  # before or after what `run` answers
        leave()
    sys.exit(code)


def mpcc() -> None:
    """Run ``rmesh mpcc``."""
    sys.argv[1:] = ["mpcc", *sys.argv[1:]]
    main()
