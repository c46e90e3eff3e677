"""Residuals in the order of measuring and over each joint: a step is a device that moved, a wave a missing term."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import FigureBase
from matplotlib.ticker import MaxNLocator

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.service.engineering.plots.evidence import thin_rows
from cellcal.service.engineering.plots.plotted_residuals import PlottedResiduals
from cellcal.service.engineering.plots.style import AFTER, BEFORE, QUIET, WARNING, style_axes, title_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHOWN = 99.5  # percentile that a panel holds; what is beyond is drawn at its edge
_BINS = 24
_FEWEST_IN_BIN = 4
_RAREST = 200  # a step of the angle with less than this part of the rows has no course
_FEW = 200  # rows, whose marks may be large
_DENSE = 1500  # dots: an SVG holds them as one picture


def draw_by_row(figure: FigureBase, evidence: PlottedResiduals) -> None:
    """Draw held-out errors in the order of measuring, and below, the fit's residuals channel by channel."""
    names = evidence.channel_names
    panels = figure.subplots(1 + len(names), 1, sharex=True, height_ratios=[2.2, *[1.0] * len(names)])
    title_of(figure, f"{evidence.figure_title}: errors in the order of measuring")
    held_out_by_row(panels[0], evidence)
    for group, scale, unit in ((slice(0, 3), 1e3, "mm"), (slice(3, 6), 180.0 / np.pi, "deg")):
        residuals = evidence.fit_residuals[group] * scale
        limit = _panel_top(*np.abs(residuals)) if len(residuals) else 0.0
        for name, panel, residual in zip(names[group], panels[1:][group], residuals, strict=True):
            _draw_channel(panel, evidence, residual, limit)
            panel.set_ylabel(f"{name} ({unit})")
    where = "" if len(names) == 1 else ", in the device's frame"
    panels[1].set_title(f"Residuals of the fit, measured minus computed{where}", loc="left")
    panels[-1].set_xlabel("data row")


def held_out_by_row(panel: "Axes", evidence: PlottedResiduals) -> None:
    """Draw the size of the held-out errors before and after, with breaks and rejected rows."""
    if not len(evidence.held_out_m):
        panel.set_title("No row was held out: the series is too short", loc="left")
        return
    rows = thin_rows(evidence.held_out_m)
    at = evidence.held_out_rows[rows]
    before, after = evidence.before_m[rows] * 1e3, evidence.held_out_m[rows] * 1e3
    top = _panel_top(evidence.before_m * 1e3, evidence.held_out_m * 1e3)
    fast = len(rows) > _DENSE
    size = 3.0 if len(rows) > _FEW else 6.0
    panel.plot(at, before, "x", color=QUIET, ms=size, label="before", rasterized=fast)
    panel.plot(
        at,
        after,
        ".",
        color=AFTER,
        ms=size + 0.5,
        label=make_message("level {level}", level=evidence.model_level),
        rasterized=fast,
    )
    beyond = after > top
    if beyond.any():
        where = np.full(int(beyond.sum()), top)
        panel.plot(at[beyond], where, "^", color=AFTER, ms=6, clip_on=False, label="beyond the panel")
    out = np.isin(at, evidence.rejected_rows)
    if out.any():
        heights = np.minimum(after[out], top)
        panel.plot(
            at[out], heights, "o", mfc="none", color=WARNING, clip_on=False, label="rejected by the fit"
        )
    _mark_breaks(panel, evidence, label=True)
    panel.set_ylim(0, top)
    panel.margins(x=0.01)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.set_ylabel("held-out error (mm)")
    panel.set_title("Size of the error of rows that the fit has not seen", loc="left")
    _draw_legend(panel)
    style_axes(panel)


def draw_by_joint(figure: FigureBase, evidence: PlottedResiduals) -> None:
    """Draw residuals of the fit over each joint's position, with the course of their medians, before and after."""
    signed = evidence.signed_mm
    axes = evidence.joints_rad.shape[1]
    wire = len(signed) == 1
    across = (axes + 1) // 2 if wire else axes
    grid = figure.subplots(2 if wire else len(signed), across, sharey=True, squeeze=False)
    title_of(figure, f"{evidence.figure_title}: residuals of the fit over each joint's angle")
    factors, units = evidence.joint_units
    angles = evidence.joints_rad * factors
    for k, (name, (before, after)) in enumerate(signed.items()):
        for joint in range(axes):
            panel = grid.flat[joint] if wire else grid[k, joint]
            _over_joint(panel, angles[:, joint], before, after)
            if wire or k == len(signed) - 1:
                panel.set_xlabel(f"J{joint + 1} ({units[joint]})")
        for panel in grid[:, 0] if wire else grid[k, :1]:
            panel.set_ylabel(f"{name} (mm)")
    for panel in grid.flat[axes:] if wire else ():
        panel.set_visible(False)
    reach = max(float(np.percentile(np.abs(pair), 99)) for both in signed.values() for pair in both)
    grid[0, 0].set_ylim(-1.1 * max(reach, 1e-6), 1.1 * max(reach, 1e-6))
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower right", ncols=4, frameon=False)


def _over_joint(panel: "Axes", angle: Array, before: Array, after: Array) -> None:
    shown = thin_rows(np.abs(after))
    fast = len(shown) > _DENSE // 3
    panel.axhline(0, color="black", lw=0.7)
    panel.plot(angle[shown], after[shown], ".", color=AFTER, ms=2, alpha=0.25, rasterized=fast, label="row")
    centres, median, low, high = _binned_course(angle, before)
    panel.plot(centres, median, "x--", color=BEFORE, lw=1.4, ms=3.5, label="median before")
    centres, median, low, high = _binned_course(angle, after)
    panel.fill_between(centres, low, high, color=AFTER, alpha=0.2, lw=0, label="middle half after")
    panel.plot(centres, median, ".-", color=AFTER, lw=2.0, ms=5, label="median after")
    style_axes(panel)


def _binned_course(angle: Array, residual: Array) -> tuple[Array, Array, Array, Array]:
    """Return centres, median and quartiles of the residual in steps of the angle; a gap where there are no rows."""
    first, last = np.percentile(angle, (1, 99))
    steps = max(min(_BINS, len(angle) // _FEWEST_IN_BIN), 1)
    index = np.clip(((angle - first) / max(last - first, 1e-9) * steps).astype(np.intp), 0, steps - 1)
    found = np.full((4, steps), np.nan)
    for i in range(steps):
        own = index == i
        if own.sum() >= max(_FEWEST_IN_BIN, len(angle) // _RAREST):
            found[:, i] = np.median(angle[own]), *np.quantile(residual[own], (0.5, 0.25, 0.75))
    return found[0], found[1], found[2], found[3]


def _draw_channel(panel: "Axes", evidence: PlottedResiduals, residual: Array, limit: float) -> None:
    rows = thin_rows(np.abs(residual))
    at, values = evidence.fitted_rows[rows], residual[rows]
    fast = len(rows) > _DENSE
    panel.axhline(0, color="black", lw=0.7)
    panel.plot(at, np.clip(values, -limit, limit), ".", color=AFTER, ms=2.5, rasterized=fast)
    out = np.isin(rows, evidence.rejected_positions)
    if out.any():
        panel.plot(
            at[out], np.clip(values[out], -limit, limit), "o", mfc="none", color=WARNING, clip_on=False
        )
    _mark_breaks(panel, evidence, label=False)
    panel.set_ylim(-limit, limit)
    style_axes(panel)


def _mark_breaks(panel: "Axes", evidence: PlottedResiduals, *, label: bool) -> None:
    for i, row in enumerate(evidence.mounting_breaks):
        panel.axvline(
            row - 0.5, color=WARNING, lw=1, ls="--", label="device moved" if label and i == 0 else None
        )


def _panel_top(*errors: Array) -> float:
    """Return where a panel ends: a few outliers must not compress all others."""
    largest = max(float(each.max()) for each in errors)
    usual = max(float(np.percentile(each, _SHOWN)) for each in errors)
    return 1.05 * max(largest if largest < 2 * usual else usual, 1e-6)


def _draw_legend(panel: "Axes") -> None:
    panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, frameon=False, borderaxespad=0.1)
