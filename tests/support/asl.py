"""What JuMP's AmplNLWriter reads of a ``.sol`` file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Sol:
    """The parts of a ``.sol`` file."""

    message: str
    options: list[str]
    duals: list[float]
    x: list[float]
    code: int
    suffixes: dict[str, dict[int, float]] = field(default_factory=dict)


def read_sol(path: Path) -> Sol:
    """Read a file in the order in which MathOptInterface's ``sol.jl`` does."""
    lines = iter(path.read_text().splitlines())
    words: list[str] = []
    for line in lines:
        if line.startswith("Options"):
            break
        words.append(line)
    options = [next(lines)]
    count, has_tolerance = int(options[0]), False
    options += [next(lines), next(lines)]
    if options[2] == "3":
        count, has_tolerance = count - 2, True
    options += [next(lines) for _ in range(3, count + 1)]
    _, n_duals, _, n_values = (int(next(lines)) for _ in range(4))
    if has_tolerance:
        options.append(next(lines))
    duals = [float(next(lines)) for _ in range(n_duals)]
    x = [float(next(lines)) for _ in range(n_values)]
    kind, number, code = next(lines).split()
    assert (kind, number) == ("objno", "0")
    found = Sol("\n".join(words).strip(), options, duals, x, int(code))
    for line in lines:
        suffix, _, n, *_ = line.split()
        assert suffix == "suffix"
        name = next(lines)
        pairs = (next(lines).split() for _ in range(int(n)))
        found.suffixes[name] = {int(j): float(value) for j, value in pairs}
    return found
