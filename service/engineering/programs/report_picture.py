"""Pictures of a program's points, seen from above and from the side, as SVG without a script or a font of its own."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.service.engineering.programs.report_texts import ReportLanguage

# Stops of matplotlib's cividis and viridis: read alike by the colour-blind. The light end is cut off for white pages.
CIVIDIS = ("#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#d9c45c")
VIRIDIS = ("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#8fd544", "#bddf26")
MOST_DRAWN = 3000
_FINEST_MM = 1e-3
_MANY, _SMALLER = 400, 0.65  # more marks than this would be one blot
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP, _RIGHT = 460, 360, 54, 44, 26, 14
_ABOVE, _SIDE = (0, 1), (0, 2)  # the axes across and up


@dataclass(frozen=True, eq=False)
class DrawnPoints:
    """N points of a picture."""

    place_m: Array  # (N, 3)
    is_excluded: NDArray[np.bool_]  # (N,)
    labels: Sequence[str]  # said under the mouse


@dataclass(frozen=True, eq=False)
class Colouring:
    """The meaning of the colours."""

    title: str
    figure_m: Array  # (N,)
    colours: tuple[str, ...]


def two_views(points: DrawnPoints, colouring: Colouring, about: str, language: ReportLanguage) -> str:
    """Return both views and their legend as HTML; ``about`` says in whose frame the places are."""
    scale, texts = ColourScale.for_colouring(colouring), language.texts
    fills = [scale.colour_of(figure) for figure in colouring.figure_m.tolist()]
    views = "".join(
        _SideView(title, *axes, about, language).render_points(points, fills, colouring.title)
        for title, axes in ((texts.from_above, _ABOVE), (texts.from_the_side, _SIDE))
    )
    return (
        f"<figure><figcaption>{escape(colouring.title)}</figcaption>"
        f'<div class="views">{views}</div>{_render_legend(scale, language)}</figure>'
    )


@dataclass(frozen=True, slots=True)
class ColourScale:
    """Equal steps from the least to the largest figure, in millimetres."""

    low: float
    high: float
    colours: tuple[str, ...]

    @classmethod
    def for_colouring(cls, colouring: Colouring) -> "ColourScale":
        """Return the scale of what is drawn; no step is finer than the legend's digits."""
        finite_mm = colouring.figure_m[np.isfinite(colouring.figure_m)] * 1e3
        low, high = (float(finite_mm.min()), float(finite_mm.max())) if len(finite_mm) else (0.0, 0.0)
        steps = max(1, min(len(colouring.colours), round((high - low) / _FINEST_MM)))
        chosen = np.linspace(0, len(colouring.colours) - 1, steps).round().astype(int)
        return cls(low, high, tuple(colouring.colours[i] for i in chosen.tolist()))

    @property
    def step_count(self) -> int:
        """Return how many colours there are: one where all figures are alike."""
        return len(self.colours)

    @property
    def edges_mm(self) -> list[float]:
        """Return the borders of the colours in millimetres, one more than there are colours."""
        width = (self.high - self.low) / self.step_count
        return [self.low + i * width for i in range(self.step_count + 1)]

    def step_of(self, figure_m: float) -> int:
        """Return the number of a figure's colour, -1 where it is not known."""
        if not math.isfinite(figure_m):
            return -1
        share = (figure_m * 1e3 - self.low) / (self.high - self.low) if self.step_count > 1 else 0.0
        return min(int(share * self.step_count), self.step_count - 1)

    def colour_of(self, figure_m: float) -> str:
        """Return a figure's colour, empty where it is not known."""
        step = self.step_of(figure_m)
        return "" if step < 0 else self.colours[step]


def _render_legend(scale: ColourScale, language: ReportLanguage) -> str:
    width, edges, texts = (scale.high - scale.low) / scale.step_count, scale.edges_mm, language.texts
    digits = max(0, min(3, 1 - math.floor(math.log10(width)))) if width > 0 else 3
    if scale.step_count == 1:
        pairs = [language.number(f"{scale.high:.3f}") + " mm"]
    else:
        shown = [language.number(f"{edge:.{digits}f}") for edge in edges]
        pairs = [texts.step.format(low, high) for low, high in itertools.pairwise(shown)]
        pairs[-1] += " mm"
    swatches = "".join(
        f'<span><i style="background:{colour}"></i>{pair}</span>'
        for colour, pair in zip(scale.colours, pairs, strict=False)
    )
    cross = (
        '<svg width="12" height="12" aria-hidden="true">'
        '<path class="left" stroke-width="2.2" d="M2 2 10 10M2 10 10 2"/></svg>'
    )
    ring = (
        '<svg width="12" height="12" aria-hidden="true"><circle class="unknown" cx="6" cy="6" r="4"/></svg>'
    )
    return (
        f'<p class="legend">{swatches}<span>{ring} {escape(texts.not_known)}</span>'
        f"<span>{cross} {escape(texts.excluded_label)}</span></p>"
    )


@dataclass(frozen=True, slots=True)
class _SideView:
    """One side of the points, with its axes."""

    title: str
    across: int
    up: int
    about: str
    language: ReportLanguage

    def render_points(self, points: DrawnPoints, fills: Sequence[str], what: str) -> str:
        box = _PlotBox.enclosing_box(points.place_m[:, self.across] * 1e3, points.place_m[:, self.up] * 1e3)
        size = _SMALLER if len(points.labels) > _MANY else 1.0
        marks = "".join(
            _render_mark(
                box.to_pixels(place[self.across] * 1e3, place[self.up] * 1e3), excluded, fill, label, size
            )
            for place, excluded, fill, label in zip(
                points.place_m.tolist(), points.is_excluded.tolist(), fills, points.labels, strict=True
            )
        )
        texts = self.language.texts
        across = texts.axis_of.format(axis="xyz"[self.across], about=self.about)
        return (
            f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(what)}, {escape(self.title)}">'
            f'<text class="view" x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="16" text-anchor="middle">'
            f"{escape(self.title)}</text>{box.render_axes(across, texts.axis.format('xyz'[self.up]))}{marks}</svg>"
        )


def _render_mark(at: tuple[float, float], is_excluded: bool, colour: str, label: str, size: float) -> str:
    (x, y), tooltip, arm = at, f"<title>{escape(label)}</title>", 4 * size
    if is_excluded:
        far = 2 * arm
        cross = f"M{x - arm:.1f} {y - arm:.1f}l{far:.1f} {far:.1f}m0 {-far:.1f}l{-far:.1f} {far:.1f}"
        return f'<path class="left" stroke-width="{2.2 * size:.2g}" d="{cross}">{tooltip}</path>'
    style = f'fill="{colour}"' if colour else 'class="unknown"'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{3.4 * size:.2g}" {style}>{tooltip}</circle>'


@dataclass(frozen=True, slots=True)
class _PlotBox:
    """A part of a plane in millimetres, at one scale both ways, and where it is drawn."""

    across_mm: float  # of its middle
    up_mm: float
    per_mm: float  # drawn units

    @classmethod
    def enclosing_box(cls, across_mm: Array, up_mm: Array) -> "_PlotBox":
        middle = [float(side.min() + side.max()) / 2 for side in (across_mm, up_mm)]
        spans = [max(float(np.ptp(side)), 1.0) * 1.1 for side in (across_mm, up_mm)]
        room = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
        return cls(middle[0], middle[1], min(room[0] / spans[0], room[1] / spans[1]))

    def to_pixels(self, across_mm: float, up_mm: float) -> tuple[float, float]:
        x = (_LEFT + _WIDTH - _RIGHT) / 2 + (across_mm - self.across_mm) * self.per_mm
        y = (_TOP + _HEIGHT - _BOTTOM) / 2 - (up_mm - self.up_mm) * self.per_mm
        return x, y

    def render_axes(self, across: str, up: str) -> str:
        floor, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
        parts = [
            f'<rect class="frame" x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{floor - _TOP}"/>'
        ]
        for value in _round_ticks(self.across_mm, (right - _LEFT) / self.per_mm):
            x = self.to_pixels(value, self.up_mm)[0]
            parts.append(f'<path class="grid" d="M{x:.1f} {_TOP}V{floor}"/>')
            parts.append(f'<text x="{x:.1f}" y="{floor + 14}" text-anchor="middle">{value:g}</text>')
        for value in _round_ticks(self.up_mm, (floor - _TOP) / self.per_mm):
            y = self.to_pixels(self.across_mm, value)[1]
            parts.append(f'<path class="grid" d="M{_LEFT} {y:.1f}H{right}"/>')
            parts.append(f'<text x="{_LEFT - 5}" y="{y + 3.5:.1f}" text-anchor="end">{value:g}</text>')
        parts.append(
            f'<text x="{(_LEFT + right) / 2}" y="{_HEIGHT - 10}" text-anchor="middle">'
            f"{escape(across)}</text>"
            f'<text x="{_LEFT - 5}" y="{_TOP - 8}" text-anchor="end">{escape(up)}</text>'
        )
        return "".join(parts)


def _round_ticks(middle: float, span: float) -> list[float]:
    """Return round values inside a span, about five."""
    rough = span / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * k for k in (1, 2, 5, 10) if power * k >= rough)
    first = math.ceil((middle - span / 2) / step)
    last = math.floor((middle + span / 2) / step)
    return [round(i * step, 9) + 0.0 for i in range(first, last + 1)]
