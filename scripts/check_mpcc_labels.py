"""Stationarity labels of the MPCC solver against points whose label is known.

    python scripts/check_mpcc_labels.py --few 1124 --many 200

``--few`` points have 1 to 7 biactive pairs, ``--many`` 8 to 24. The label is known by construction or by a
search over all signs and branches, see mpcc_library/labels.py. Right: label and B-stationarity are as known.
Undecided: a search ended at its limit ("at least C", B not decided), and what was said is true. Wrong: else.
Returns 1 if a label is wrong.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import pandas as pd

from mpcc_library.labels import LABELS, Point, dependent, regular, tangled
from rmesh_nlp.mpcc import classify
from rmesh_nlp.mpcc.stationarity import AT_LEAST
from rows import command_line, markdown, timed

PAIRS = {"few": (1, 7), "many": (8, 24)}
B_WORDS = {True: "yes", False: "no", None: "unknown"}
WORDS = ["right", "undecided", "wrong"]
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
    parser = command_line(__doc__)
    parser.add_argument("--few", type=int, default=1124, help="points of 1 to 7 biactive pairs")
    parser.add_argument("--many", type=int, default=200, help="points of 8 to 24")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    options = parser.parse_args(arguments)
    rows = []
    for name, (least, most) in PAIRS.items():
        for seed in range(options.first, options.first + getattr(options, name)):
            point = KINDS[seed % len(KINDS)](seed, least, most)
            end, seconds = timed(classify, point.mpcc, point.x)
            word = verdict(point, end.stationarity, end.b_stationary)
            key = f"{least} to {most}", point.label, B_WORDS[point.b_stationary]
            rows.append((*key, 1, *(int(word == each) for each in WORDS), seconds))
            if word != "right":
                ending = f"{end.stationarity}, B {end.b_stationary}"
                print(f"{word}: {point}: {ending}", file=sys.stderr)
    columns = ["biactive pairs", "label", "B"]
    frame = pd.DataFrame(rows, columns=[*columns, "points", *WORDS, "processor time [s]"])
    frame["label"] = pd.Categorical(frame.label, LABELS)
    print(markdown(frame.groupby(columns, observed=True).sum().reset_index()))
    print(", ".join(f"{frame[word].sum()} {word}" for word in WORDS))
    return 1 if frame.wrong.any() else 0


if __name__ == "__main__":
    sys.exit(main())
