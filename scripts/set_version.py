"""Write a version, such as that of a tag, where the package states it: ``scripts/set_version.py 0.2.0``."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PLACES = {
    "pyproject.toml": r'^version = "(.*)"$',
    "rmesh_nlp/__init__.py": r'^__version__ = "(.*)"$',
    "CITATION.cff": r"^version: (.*)$",
}
"""Files, and the line of each that has the version."""


def versions(root: Path = ROOT) -> dict[str, list[str]]:
    """The versions that stand in each file."""
    return {name: re.findall(line, (root / name).read_text(), re.M) for name, line in PLACES.items()}


def write(version: str, root: Path = ROOT) -> None:
    """Write a version into each file; a ValueError if it is none, or a file does not have one line for it."""
    if not re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc)\d+)?", version):
        raise ValueError(f"{version!r} is no version such as 0.2.0 or 0.2.0rc1")
    for name, found in versions(root).items():
        if len(found) != 1:
            raise ValueError(f"{name} has {len(found)} lines with a version, not one")
        path, line = root / name, PLACES[name].replace("(.*)", re.escape(found[0]))
        new = PLACES[name].strip("^$").replace("(.*)", version)
        path.write_text(re.sub(line, new, path.read_text(), flags=re.M))


if __name__ == "__main__":
    write(sys.argv[1])
    print(f"version {sys.argv[1]} in {', '.join(PLACES)}")
