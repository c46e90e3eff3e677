"""Axes, scales and marks of the small drawings on certificates, written as SVG."""

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

from cellcal.service.certificates.blocks import PictureBlock

# After M. Okabe, K. Ito, Color Universal Design, 2008.
AFTER, BEFORE, LIMIT, _INK, GRID = "#0072b2", "#6b6b6b", "#c04a00", "#222222", "#d9d9d9"
WIDTH, ROW, LEFT, RIGHT = 560.0, 22.0, 218.0, 22.0
_LETTER = 5.5  # mean width


@dataclass(frozen=True, slots=True)
class Axis:
    """From a value to a place on paper; values outside stand at the edge."""

    low: float
    high: float
    begin: float
    end: float

    def to_position(self, value: float) -> float:
        share = (min(max(value, self.low), self.high) - self.low) / (self.high - self.low)
        return self.begin + share * (self.end - self.begin)

    def round_ticks(self, factor: float = 1.0) -> list[float]:
        """Return values that are round when multiplied by a factor."""
        step = _round_step((self.high - self.low) * factor) / factor
        first = math.ceil(self.low / step - 1e-9)
        return [k * step for k in range(first, math.floor(self.high / step + 1e-9) + 1)]


@dataclass(frozen=True, slots=True)
class FigureScale:
    """A unit in which figures are written with few digits, and where an axis of them ends."""

    unit: str
    factor: float
    top: float
    commas: bool = False  # the decimal mark

    @classmethod
    def for_largest(cls, most: float, unit: str = "m", *, commas: bool = False) -> "FigureScale":
        top = 1.08 * most if most > 1e-9 else 1e-6
        if unit == "rad":
            return cls("deg", math.degrees(1.0), top, commas)
        return cls("mm", 1e3, top, commas) if top >= 2e-4 else cls("µm", 1e6, top, commas)

    def format_value(self, value: float) -> str:
        written = f"{value * self.factor:.6g}"
        return written.replace(".", ",") if self.commas else written


@dataclass(slots=True)
class SvgDrawing:
    """SVG being written."""

    height: float
    parts: list[str] = field(default_factory=list)

    def draw_line(
        self,
        one: tuple[float, float],
        other: tuple[float, float],
        colour: str,
        width: float,
        *,
        dashed: bool = False,
    ) -> None:
        dashes = ' stroke-dasharray="5 3"' if dashed else ""
        ends = f'x1="{one[0]:.1f}" y1="{one[1]:.1f}" x2="{other[0]:.1f}" y2="{other[1]:.1f}"'
        self.parts.append(f'<line {ends} stroke="{colour}" stroke-width="{width}"{dashes}/>')

    def draw_dot(self, at: tuple[float, float], colour: str) -> None:
        self.parts.append(f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="3.4" fill="{colour}"/>')

    def draw_ring(self, at: tuple[float, float], colour: str) -> None:
        self.parts.append(
            f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="3.4" fill="#ffffff" stroke="{colour}" stroke-width="1.5"/>'
        )

    def draw_text(self, at: tuple[float, float], words: str, anchor: str, colour: str = _INK) -> None:
        self.parts.append(
            f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" text-anchor="{anchor}" fill="{colour}">{escape(words)}</text>'
        )

    def draw_key(self, at: tuple[float, float], ring: str, dot: str, colour: str = BEFORE) -> None:
        x, y = at
        self.draw_ring((x, y - 3.5), colour)
        self.draw_text((x + 8.0, y), ring, "start")
        beside = x + 8.0 + max(70.0, _LETTER * text_width(ring) + 20.0)
        self.draw_dot((beside, y - 3.5), AFTER)
        self.draw_text((beside + 8.0, y), dot, "start")

    def to_picture(self, caption: str, alt: str) -> PictureBlock:
        size = f'width="{WIDTH:.0f}" height="{self.height:.0f}" viewBox="0 0 {WIDTH:.0f} {self.height:.0f}"'
        letters = 'font-family="Libertinus Serif, serif" font-size="11"'
        svg = f'<svg xmlns="http://www.w3.org/2000/svg" {size} {letters}>{"".join(self.parts)}</svg>'
        return PictureBlock(svg, alt, caption)


def begin_chart(
    axis: Axis, scale: FigureScale, count: int, what: str, names: Sequence[str] = ()
) -> tuple[SvgDrawing, list[float]]:
    """Begin a drawing with values upwards and points from left to right; return it and the points' places."""
    left_x, right_x = 64.0, WIDTH - RIGHT
    drawing = SvgDrawing(158.0)
    for value in axis.round_ticks(scale.factor):
        drawing.draw_line((left_x, axis.to_position(value)), (right_x, axis.to_position(value)), GRID, 0.8)
        drawing.draw_text((left_x - 6.0, axis.to_position(value) + 3.5), scale.format_value(value), "end")
    drawing.draw_text((8.0, 12.0), f"[{scale.unit}]", "start")
    width = (right_x - left_x) / count
    places = [left_x + width * (k + 0.5) for k in range(count)]
    every = max(1, math.ceil(count / 25))
    for k in range(0, count, every):
        name = names[k] if k < len(names) and len(names[k]) <= 6 else str(k + 1)
        drawing.draw_text((places[k], axis.begin + 18.0), name, "middle")
    drawing.draw_text(((left_x + right_x) / 2, axis.begin + 35.0), what, "middle")
    return drawing, places


def draw_grid(drawing: SvgDrawing, axis: Axis, between: tuple[float, float], scale: FigureScale) -> None:
    """Draw upright lines at round values, with the figures below ``between`` two heights."""
    for value in axis.round_ticks(scale.factor):
        x = axis.to_position(value)
        drawing.draw_line((x, between[0]), (x, between[1]), GRID, 0.8)
        drawing.draw_text((x, between[1] + 15.0), scale.format_value(value), "middle")


def _round_step(span: float) -> float:
    """Return a round distance of ticks that gives three to seven of them."""
    power = 10.0 ** math.floor(math.log10(span / 3.0))
    return max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= span / 3.0) * power


def text_width(words: str) -> int:
    """Return the width of words in letters: a Chinese character is two wide."""
    return sum(2 if unicodedata.east_asian_width(letter) in "WF" else 1 for letter in words)
