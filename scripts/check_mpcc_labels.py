"""Stationarity labels of the MPCC solver against points whose label is known.

    python scripts/check_mpcc_labels.py --few 1124 --many 200

``--few`` points have 1 to 7 biactive pairs, ``--many`` 8 to 24. The label is known by construction or by a
search over all signs and branches, see mpcc_library/labels.py. Right: label and B-stationarity are as known.
Undecided: a search ended at its limit ("at least C", B not decided), and what was said is true. Wrong: else.
Returns 1 if a label is wrong.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence

from mpcc_library.labels import LABELS, Point, dependent, regular, tangled
from rmesh_nlp.mpcc import classify
from rmesh_nlp.mpcc.stationarity import AT_LEAST

FEW, MANY = (1, 7), (8, 24)
B_WORDS = {"True": "yes", "False": "no", "None": "unknown"}
KINDS = (regular, dependent, tangled)


def verdict(point: Point, label: str, b_stationary: bool | None) -> str:
    """``right``, ``undecided`` or ``wrong``."""
    bound = label.removeprefix(AT_LEAST)
    is_known = point.b_stationary is not None and b_stationary is not None
    if (is_known and b_stationary != point.b_stationary) or bound not in LABELS:
        return "wrong"
    if label != bound:
        return "undecided" if LABELS.index(point.label) <= LABELS.index(bound) else "wrong"
    if label != point.label:
        return "wrong"
    return "right" if b_stationary is not None else "undecided"


def main(arguments: Sequence[str] | None = None) -> int:
    """Check, print a table; 1 if a label is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--few", type=int, default=1124, help="points of 1 to 7 biactive pairs")
    parser.add_argument("--many", type=int, default=200, help="points of 8 to 24")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    given = parser.parse_args(arguments)
    words = ("right", "undecided", "wrong")
    print("| biactive pairs | label | B | points | " + " | ".join(words) + " | processor time [s] |")
    print("|:--|:--|:--" + "|--:" * 5 + "|")
    total: Counter[str] = Counter()
    for (least, most), number in ((FEW, given.few), (MANY, given.many)):
        found: dict[tuple[str, str], Counter[str]] = {}
        seconds: Counter[tuple[str, str]] = Counter()
        for seed in range(given.first, given.first + number):
            point = KINDS[seed % len(KINDS)](seed, least, most)
            began = time.process_time()
            said = classify(point.mpcc, point.x)
            key = (point.label, str(point.b_stationary))
            word = verdict(point, said.stationarity, said.b_stationary)
            seconds[key] += time.process_time() - began  # type: ignore[assignment]
            found.setdefault(key, Counter())[word] += 1
            if word != "right":
                known = f"{point.label}, B {point.b_stationary}"
                said_ = f"{said.stationarity}, B {said.b_stationary}"
                print(f"{word}: {point.name}, {point.n_biactive} pairs: {said_} for {known}", file=sys.stderr)
        for key in sorted(found, key=lambda key: (LABELS.index(key[0]), key[1])):
            counts = found[key]
            total += counts
            cells = (f"{least} to {most}", key[0], B_WORDS[key[1]], counts.total(),
                     *(counts[word] for word in words), f"{seconds[key]:.1f}")  # fmt: skip
            print("| " + " | ".join(map(str, cells)) + " |")
    print(", ".join(f"{total[word]} {word}" for word in words))
    return 1 if total["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
