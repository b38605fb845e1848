"""Draw the stress of the parts in docs/parts: ``python scripts/parts_picture.py docs/parts.png``."""

from __future__ import annotations

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import rmesh_nlp as rm


def main(target: str) -> None:
    """Write the picture; each part is solved on its mesh."""
    files = sorted(Path("docs/parts").glob("*.toml"))
    _, axes = plt.subplots(2, len(files) // 2, figsize=(15, 6.5), layout="constrained")
    for axis, file in zip(axes.ravel(), files, strict=True):
        rm.solve(rm.read_problem(file), "fixed").plot("stress", axes=axis)
        axis.set(title=file.stem.replace("_", " "), xlabel="", ylabel="", xticks=[], yticks=[])
        axis.set_axis_off()
    plt.savefig(target, dpi=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
