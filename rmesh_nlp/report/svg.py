"""Line charts as inline SVG: a few kilobytes, sharp in print, legible without scripts or a network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.report.style import look

Array = NDArray[np.float64]

WIDTH, HEIGHT = 480, 284
LEFT, RIGHT, TOP, BOTTOM = 64, 24, 8, 46

DASHES = {"-": "", "--": "7 4", "-.": "8 3 2 3", ":": "2 3"}


@dataclass(frozen=True)
class Line:
    """One curve.

    Attributes
    ----------
    name : str
        Empty for a line that is not drawn, and only widens the axes.
    look : int
        Which of the looks of all figures it has.
    steps : bool
        Whether it is a step function that jumps at its points.
    """

    name: str
    x: Array
    y: Array
    look: int = 0
    steps: bool = False


def line_chart(
    lines: Sequence[Line], title: str, x_label: str, y_label: str, *, log_x: bool = False, log_y: bool = False
) -> str:
    """A ``<figure>``: an ``<svg>`` with axes and curves, its title above and the names of curves below.

    Title and names are text of the page, which breaks lines where they do not fit.
    """
    x_axis = _Axis([line.x for line in lines], log_x, LEFT, WIDTH - RIGHT)
    y_axis = _Axis([line.y for line in lines], log_y, HEIGHT - BOTTOM, TOP)
    parts = [
        f"<figure><figcaption>{escape(title)}</figcaption>"
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}" class="chart">',
    ]
    for value, text in x_axis.ticks():
        at = x_axis.place(value)
        parts.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}" class="grid"/>')
        parts.append(f'<text x="{at:.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{text}</text>')
    for value, text in y_axis.ticks():
        at = y_axis.place(value)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at:.1f}" y2="{at:.1f}" class="grid"/>')
        parts.append(f'<text x="{LEFT - 5}" y="{at + 4:.1f}" text-anchor="end">{text}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 8}" text-anchor="middle">{escape(x_label)}</text>')
    height = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(
        f'<text transform="translate(13 {height}) rotate(-90)" text-anchor="middle">{escape(y_label)}</text>'
    )
    names = []
    for line in (line for line in lines if line.name):
        style = look(line.look)
        pen = f'stroke="{style.color}" stroke-dasharray="{DASHES[style.linestyle]}" class="curve"'
        parts.append(f'<path d="{_path(line, x_axis, y_axis)}" {pen}/>')
        sample = f'<svg viewBox="0 0 26 8" class="sample"><path d="M0 4h26" {pen}/></svg>'
        names.append(f"<li>{sample}{escape(line.name)}</li>")
    return "".join([*parts, f'</svg><ul class="legend">{"".join(names)}</ul></figure>'])


class _Axis:
    def __init__(self, values: Sequence[Array], log: bool, begin: float, end: float) -> None:
        flat = np.concatenate([np.ravel(value) for value in values] or [np.zeros(0)])
        flat = flat[np.isfinite(flat) & ((flat > 0) | (not log))]
        low, high = (float(flat.min()), float(flat.max())) if flat.size else (1.0, 2.0)
        if log:
            low, high = math.log10(low), math.log10(high)
        if high - low < 1e-9 * max(abs(low), 1e-3):
            low, high = low - 0.5, high + 0.5
        self.low, self.high, self.log, self.begin, self.end = low, high, log, begin, end

    def place(self, value: float) -> float:
        if self.log:
            value = math.log10(value) if value > 0 else self.low
        part = (min(max(value, self.low), self.high) - self.low) / (self.high - self.low)
        return self.begin + part * (self.end - self.begin)

    def ticks(self) -> list[tuple[float, str]]:
        if self.log and self.high - self.low >= 1:
            first, last = math.ceil(self.low - 1e-9), math.floor(self.high + 1e-9)
            step = max(1, round((last - first) / 5))
            return [(10.0**k, _power(k)) for k in range(first, last + 1, step)]
        low, high = (10**self.low, 10**self.high) if self.log else (self.low, self.high)
        raw = (high - low) / 4
        decade = 10 ** math.floor(math.log10(raw))
        step = next(m * decade for m in (1, 2, 5, 10) if m * decade >= raw)
        count = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
        return [(k * step, f"{k * step:.6g}") for k in count if k * step > 0 or not self.log]


def _power(k: int) -> str:
    return f"{10.0**k:g}" if -3 <= k <= 4 else f'10<tspan dy="-4" font-size="8">{k}</tspan>'


def _path(line: Line, x_axis: _Axis, y_axis: _Axis) -> str:
    commands: list[str] = []
    before: float | None = None
    for x, y in zip(line.x, line.y, strict=True):
        if not (np.isfinite(x) and np.isfinite(y)):
            before = None
            continue
        px, py = x_axis.place(float(x)), y_axis.place(float(y))
        if before is None:
            commands.append(f"M{px:.1f} {py:.1f}")
        elif line.steps:
            commands.append(f"H{px:.1f}V{py:.1f}")
        else:
            commands.append(f"L{px:.1f} {py:.1f}")
        before = py
    return "".join(commands)
