"""How large the errors are before and after: how many rows of each size, and what share stays below a size."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import FigureBase

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.plots.plotted_residuals import PlottedResiduals
from cellcal.service.engineering.plots.style import AFTER, BEFORE, style_axes, title_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_BINS = 50


def draw_distribution(figure: FigureBase, evidence: PlottedResiduals) -> None:
    """Draw the histogram and the share of rows below each error."""
    left_panel, right_panel = figure.subplots(1, 2)
    title_of(figure, f"{evidence.figure_title}: held-out errors before and after")
    draw_histogram(left_panel, evidence)
    draw_shares(right_panel, evidence)


def draw_histogram(panel: "Axes", evidence: PlottedResiduals) -> None:
    """Draw how many rows have an error of each size."""
    before, after, top = _error_sizes(evidence)
    bins = np.linspace(0.0, top, min(_MOST_BINS, 6 + int(1.2 * np.sqrt(len(after)))))
    for errors, colour, label, fill in (
        (before, BEFORE, f"before: mean {before.mean():.3f} mm", True),
        (after, AFTER, f"level {evidence.model_level}: mean {after.mean():.3f} mm", False),
    ):
        counts = np.histogram(np.minimum(errors, top), bins)[0]
        panel.stairs(counts, bins, fill=fill, color=colour, alpha=0.55 if fill else 1.0, lw=1.8, label=label)
    panel.set_xlabel("error (mm); the last bin holds what is beyond")
    panel.set_ylabel("rows")
    _finish_panel(panel, top)


def draw_shares(panel: "Axes", evidence: PlottedResiduals) -> None:
    """Draw the share of rows below each error, with the 95 % point."""
    before, after, top = _error_sizes(evidence)
    for errors, colour, style, word in (
        (before, BEFORE, "--", "before"),
        (after, AFTER, "-", make_message("level {level}", level=evidence.model_level)),
    ):
        size = float(np.percentile(errors, 95))
        steps = np.linspace(0.0, 1.0, 401)
        panel.plot(np.quantile(errors, steps), steps * 100, style, color=colour, lw=1.8,
                   label=f"{word}: 95 % below {size:.3f} mm")  # fmt: skip
        panel.plot([size], [95], "o", color=colour, ms=5)
    panel.axhline(95, color="black", lw=0.6, ls=":")
    panel.set_xlabel("error (mm)")
    panel.set_ylabel("share of rows at or below (%)")
    panel.set_ylim(0, 101)
    _finish_panel(panel, top)


def _error_sizes(evidence: PlottedResiduals) -> tuple[Array, Array, float]:
    before, after = evidence.before_m * 1e3, evidence.held_out_m * 1e3
    top = max(float(np.percentile(before, 99.5)), float(np.percentile(after, 99.5)), 1e-6)
    return before, after, top


def _finish_panel(panel: "Axes", top: float) -> None:
    panel.set_xlim(0, top)
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, borderaxespad=0.1)
    style_axes(panel)
