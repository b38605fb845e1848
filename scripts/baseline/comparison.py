"""What a version lost against a baseline: statuses, labels, minimised values, entries, numbers and time.

A baseline has several runs of one version that differ in rounding alone. Some cases are chaotic: rounding
decides between local minima, or where a solve stops. So a case is worse only if it is worse than in every
run, and differences of a kind count only if they are more than a run of the baseline has to the others.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, sqrt
from typing import TypedDict


class Row(TypedDict):
    """How a case ended; ``keys`` are those of its record, ``numbers`` what was measured."""

    keys: list[str]
    status: str
    text: str
    success: bool
    label: str
    value: float | None
    iterations: int
    contact_solves: int
    seconds: float
    numbers: dict[str, float]


Rows = Mapping[str, Row]
"""Rows by the names of their cases, ``group: ...``."""

SAME_VALUE, SAME_END, SAME_NUMBER, ABSOLUTE = 1e-6, 1e-9, 1e-4, 1e-9
"""Relative differences of values that are equal, of values of the same end, and of its measured numbers."""

OF_GAIN = 1e-3
"""Part of what a solve gained that counts as equal where it stopped before it converged."""

SLOWER = 1.1
"""Factor of processor time that is reported."""

LABELS = ("S", "B", "KKT", "M", "C", "W", "none", "")
"""Of stationarity, the strongest first."""

REFUSED, CRASHED, OVERTIME = "refused", "crashed", "over the time limit"
"""Words for a case without a record."""

WITHOUT_RECORD = (REFUSED, CRASHED, OVERTIME)


@dataclass
class Comparison:
    """Differences: ``faults`` count, ``remarks`` do not."""

    faults: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def add(self, line: str, is_fault: bool) -> None:
        """A line of either."""
        (self.faults if is_fault else self.remarks).append(line)

    def __str__(self) -> str:
        lines = [f"remark: {line}" for line in self.remarks] + [f"FAULT: {line}" for line in self.faults]
        return "\n".join([*lines, f"{len(self.faults)} faults, {len(self.remarks)} remarks"])


def compare(baseline: Sequence[Rows], rows: Rows, allowed: Collection[str] = ()) -> Comparison:
    """Hold rows against the runs of a baseline; entries of records that are ``allowed`` may be missing."""
    common = [name for name in rows if all(name in run for run in baseline)]
    result, lost = Comparison(), losses(baseline, rows, common)
    among: list[dict[str, list[str]]] = []
    for k in range(len(baseline) if len(baseline) > 1 else 0):
        among.append(losses([*baseline[:k], *baseline[k + 1 :]], baseline[k], common))
    for kind, lines in sorted(lost.items()):
        usual = max((len(run.get(kind, [])) for run in among), default=0)
        entry = kind.partition("entry missing ")[2]
        may_go = any(entry == name or entry.startswith(f"{name}.") for name in allowed)
        result.remarks += [f"{kind}: {line}" for line in lines]
        said = f"{kind}: {len(lines)} cases, up to {usual} among runs of the baseline; {lines[0]}"
        result.add(said, len(lines) > _chance(usual) and not may_go)
    for name in common:
        result.remarks += _gains([run[name] for run in baseline], rows[name], name)
    for group in sorted({_group(name) for name in common}):
        _count_best(result, baseline, rows, [name for name in common if _group(name) == group], group)
    same = sum(any(_is_same_end(run[name], rows[name]) for run in baseline) for name in common)
    result.remarks.append(f"{same} of {len(common)} cases have the same end and iterations as a run")
    result.remarks += [f"not in the baseline: {name}" for name in rows if name not in common]
    return result


def losses(baseline: Sequence[Rows], rows: Rows, names: Collection[str]) -> dict[str, list[str]]:
    """What is worse than in every run, by kind."""
    lost: dict[str, list[str]] = defaultdict(list)
    for name in names:
        olds, new = [run[name] for run in baseline], rows[name]
        for kind, line in [*_worse_end(olds, new), *_other_record(olds, new)]:
            of_group = "" if kind.startswith(("entry", "number")) else f"{_group(name)}: "
            lost[of_group + kind].append(f"{name}: {line}")
    return lost


def _worse_end(olds: Sequence[Row], new: Row) -> list[tuple[str, str]]:
    before = ", ".join(sorted({_said(old) for old in olds}))
    change = f"status {before} -> {_said(new)} {new['text']}".rstrip()
    if (new["status"] == REFUSED) != any(old["status"] == REFUSED for old in olds):
        return [("refused or not", change)]
    if new["status"] in WITHOUT_RECORD:
        return [(new["status"], change)] if all(old["status"] != new["status"] for old in olds) else []
    if not new["success"]:
        return [("no success", change)] if all(old["success"] for old in olds) else []
    worse = []
    if new["status"] != "converged" and all(old["status"] == "converged" for old in olds):
        worse.append(("not converged", change))
    if label_rank(new) > max(map(label_rank, olds)):
        worse.append(
            ("weaker label", f"{', '.join(sorted({old['label'] for old in olds}))} -> {new['label']}")
        )
    return [*worse, *(("higher value", line) for line in _beyond(olds, new, 1.0))]


def _other_record(olds: Sequence[Row], new: Row) -> list[tuple[str, str]]:
    """Entries and numbers that differ although the solve ended as in a run."""
    same = [old for old in olds if _is_same_end(old, new)]
    if not same:
        return []
    changes = []
    for key in set.intersection(*(set(old["keys"]) for old in same)) - set(new["keys"]):
        changes.append((f"entry missing {key}", "in its record"))
    for key in set(new["keys"]) - set.union(*(set(old["keys"]) for old in same)):
        changes.append((f"entry new {key}", "in its record"))
    for key, number in new["numbers"].items():
        numbers = [old["numbers"][key] for old in same if key in old["numbers"]]
        off = max(min(numbers) - number, number - max(numbers)) if numbers else 0.0
        if off > SAME_NUMBER * max(abs(number), *map(abs, numbers), 0.0) + ABSOLUTE:
            changes.append((f"number {key}", f"{_range(numbers)} -> {number:.7g}"))
    return changes


def _gains(olds: Sequence[Row], new: Row, name: str) -> list[str]:
    """What is better, or refused with another message."""
    better = []
    if new["status"] == "converged" and all(old["status"] != "converged" for old in olds):
        better.append(f"{name}: status {', '.join(sorted({_said(old) for old in olds}))} -> {_said(new)}")
    better += [f"{name}: lower value, {line}" for line in _beyond(olds, new, -1.0)]
    if new["status"] == REFUSED and new["text"] not in {old["text"] for old in olds}:
        better.append(f"{name}: message {olds[0]['text']!r} -> {new['text']!r}")
    return better


def _beyond(olds: Sequence[Row], new: Row, sign: float) -> list[str]:
    """A line if a value is above (``sign`` 1) or below (-1) those of all runs that succeeded."""
    values = [_end(old) for old in olds if _end(old) < inf]
    if not values or new["value"] is None:
        return []
    bar = sign * max(sign * value for value in values)
    is_beyond = sign * (new["value"] - bar) > _margin([*olds, new], bar)
    return [f"{_range(values)} -> {new['value']:.8g}"] * is_beyond


def _count_best(
    result: Comparison, baseline: Sequence[Rows], rows: Rows, names: Sequence[str], group: str
) -> None:
    """How many cases of a group end at the best value that is known for them."""
    runs = [*baseline, rows]
    ends = [[_end(run[name]) for name in names] for run in runs]
    best = [min(values) for values in zip(*ends, strict=True)]
    margins = [_margin([run[name] for run in runs], low) for name, low in zip(names, best, strict=True)]
    counts = [
        sum(value <= low + margin for value, low, margin in zip(end, best, margins, strict=True) if low < inf)
        for end in ends
    ]
    *before, now = counts
    solved = sum(low < inf for low in best)
    line = f"{group}: {min(before)} to {max(before)} -> {now} of {solved} cases at the best known value"
    result.add(line, solved - now > _chance(solved - min(before)))


def compare_seconds(
    result: Comparison, baseline: Sequence[Mapping[str, float]], seconds: Mapping[str, float]
) -> None:
    """Hold processor times, by formulation, against the slowest of the runs."""
    for name, spent in [*sorted(seconds.items()), ("all", sum(seconds.values()))]:
        before = [sum(run.values()) if name == "all" else run[name] for run in baseline]
        line = f"seconds of {name}: {min(before):.1f} to {max(before):.1f} -> {spent:.1f}"
        result.add(line, spent > SLOWER * max(before))


def label_rank(row: Row) -> float:
    """Place among the labels; "at least M" is weaker than M itself."""
    label = row["label"].removeprefix("at least ")
    return LABELS.index(label) + 0.5 * (label != row["label"]) if label in LABELS else len(LABELS)


def _chance(usual: int) -> float:
    """Number of differences that rounding explains where it explained this many."""
    return usual + sqrt(usual)


def _group(name: str) -> str:
    return name.partition(":")[0]


def _said(row: Row) -> str:
    return row["status"] + (" (success)" if row["success"] else "")


def _end(row: Row) -> float:
    return row["value"] if row["success"] and row["value"] is not None else inf


def _is_same_end(old: Row, new: Row) -> bool:
    """Whether two solves went the same way, apart from rounding."""
    first, last = old["value"], new["value"]
    if first is None or last is None or old["status"] != new["status"]:
        return False
    return old["iterations"] == new["iterations"] and abs(last - first) <= SAME_END * abs(first) + 1e-14


def _margin(ends: Sequence[Row], value: float) -> float:
    """Difference of values that counts as none."""
    margin = SAME_VALUE * abs(value) + ABSOLUTE
    if all(end["status"] == "converged" for end in ends):
        return margin
    numbers = ends[0]["numbers"]
    first = max(
        (numbers[key] for key in ("objective_initial", "energy_initial_audited") if key in numbers),
        default=value,
    )
    return margin + OF_GAIN * abs(first - value)


def _range(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.8g}" if high - low <= SAME_VALUE * abs(low) else f"{low:.8g} to {high:.8g}"
