"""Pictures of an identification: errors by row, by joint and as a histogram, before and after."""

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from service.identify import IdentifyReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colours that the colour-blind tell apart; shapes differ too.
_BEFORE, _AFTER, _NOTE = "#9a9a9a", "#0b62a4", "#c8381e"
_HASH_SALT = "cellcal"  # the same report draws the same file
_BINS = 60


def draw_identification(report: IdentifyReport, folder: Path) -> list[Path]:
    """Draw errors by row, by joint and their histogram; return the files written (PNG and SVG each)."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "errors_by_row": by_row(report),
        "errors_by_joint": by_joint(report),
        "errors": histogram(report),
    }
    written = []
    with mpl.rc_context({"svg.hashsalt": _HASH_SALT, "svg.fonttype": "none"}):
        for name, figure in figures.items():
            for suffix in ("png", "svg"):
                path = folder / f"{name}.{suffix}"
                figure.savefig(path, dpi=120, metadata={"Date": None} if suffix == "svg" else None)
                written.append(path)
    return written


def by_row(report: IdentifyReport) -> Figure:
    """Draw held-out errors in the order of measuring, with breaks and rejected rows."""
    figure, axes = _figure("Held-out errors in the order of measuring", report)
    axes.plot(report.held_out_rows, report.before_m * 1e3, "x", color=_BEFORE, ms=3, label="before")
    axes.plot(report.held_out_rows, report.held_out_m * 1e3, ".", color=_AFTER, ms=4, label=_after(report))
    rejected = [item.row for item in report.rejected]
    shown = np.isin(report.held_out_rows, rejected)
    if shown.any():
        axes.plot(
            report.held_out_rows[shown],
            report.held_out_m[shown] * 1e3,
            "o",
            mfc="none",
            color=_NOTE,
            label="rejected",
        )
    for i, row in enumerate(report.breaks):
        axes.axvline(row - 0.5, color=_NOTE, lw=1, ls="--", label="device moved" if i == 0 else None)
    axes.set_xlabel("data row")
    axes.set_ylabel("error (mm)")
    _finish(axes)
    return figure


def by_joint(report: IdentifyReport) -> Figure:
    """Draw held-out errors over each joint's angle: a wave or a slope is a model that lacks something."""
    joints = _joints_of(report)
    names = report.identification.state.nominal.joint_names
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    figure.suptitle(f"{report.robot}: held-out errors over each joint's angle")
    grid = figure.subplots(2, (len(names) + 1) // 2, sharey=True, squeeze=False)
    for axes, name, angle in zip(grid.flat, names, np.rad2deg(joints.T), strict=False):
        axes.plot(angle, report.before_m * 1e3, "x", color=_BEFORE, ms=2.5, label="before")
        axes.plot(angle, report.held_out_m * 1e3, ".", color=_AFTER, ms=3, label=_after(report))
        axes.set_xlabel(f"{name} (deg)")
        axes.grid(alpha=0.3)
        axes.set_ylim(bottom=0)
    for axes in grid.flat[len(names) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel("error (mm)")
    grid[0, 0].legend(loc="upper left", fontsize=8)
    return figure


def histogram(report: IdentifyReport) -> Figure:
    """Draw how errors are distributed before and after, on rows that were not fitted."""
    figure, axes = _figure("Distribution of held-out errors", report)
    top = (
        max(float(np.percentile(report.before_m, 99.5)), float(np.percentile(report.held_out_m, 99.5))) * 1e3
    )
    bins = np.linspace(0.0, max(top, 1e-6), _BINS)
    before = np.histogram(np.clip(report.before_m * 1e3, 0, top), bins)[0]
    after = np.histogram(np.clip(report.held_out_m * 1e3, 0, top), bins)[0]
    label = f"before: mean {report.before.mean_m * 1e3:.3f} mm"
    axes.stairs(before, bins, fill=True, color=_BEFORE, alpha=0.6, label=label)
    label = f"{_after(report)}: mean {report.held_out.mean_m * 1e3:.3f} mm"
    axes.stairs(after, bins, color=_AFTER, lw=1.8, label=label)
    axes.set_xlabel("error (mm); the last bin holds everything beyond")
    axes.set_ylabel("rows")
    _finish(axes)
    return figure


def _figure(title: str, report: IdentifyReport) -> tuple[Figure, "Axes"]:
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.set_title(f"{report.robot}: {title}")
    return figure, axes


def _finish(axes: "Axes") -> None:
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize=9)


def _after(report: IdentifyReport) -> str:
    return f"level {report.level}"


def _joints_of(report: IdentifyReport) -> np.ndarray:
    position = {int(row): i for i, row in enumerate(report.measurements.rows)}
    at = [position[int(row)] for row in report.held_out_rows]
    return report.measurements.observations.joints_rad[at]
