"""The pictures of a cell: one page over all series, residuals of each, and what can hardly be told apart."""

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cellcal.calibration.arm.joint_kinds import shown_units
from cellcal.calibration.cells.system import series_residuals
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import PoseObservations, Rows
from cellcal.calibration.identification.parameters import LEVEL_NAMES
from cellcal.service.engineering.identification.cell_identify import IdentifiedCellReport
from cellcal.service.engineering.plots.correlations import matrix_of
from cellcal.service.engineering.plots.distribution import draw_distribution, draw_histogram
from cellcal.service.engineering.plots.residuals import draw_by_joint, draw_by_row, held_out_by_row
from cellcal.service.engineering.plots.style import figure_style, new_figure, title_of, write_figures


@dataclass(frozen=True, eq=False)
class SeriesEvidence:
    """One series of a cell, as its pictures want it; rows are lines of the file."""

    report: IdentifiedCellReport
    number: int

    @property
    def figure_title(self) -> str:
        """The name of the series, and what it is."""
        series = self.report.series[self.number]
        return f"{series.name} ({series.kind}, {series.device} sees {series.target})"

    @property
    def model_level(self) -> int:
        """Of the model."""
        return self.report.level

    @property
    def joints_rad(self) -> Array:
        """Of all rows (N, n)."""
        return self.report.measurements.cell.series[self.number].observations.joints_rad

    @property
    def joint_units(self) -> tuple[Array, tuple[str, ...]]:
        """The factors with which joints are shown (n,), and the units."""
        cell = self.report.measurements.cell
        name = self.report.series[self.number].target
        tool = next((target.tool for target in cell.targets if target.name == name), name)
        owner = next(each.robot for each in cell.tools if each.name == tool)
        return shown_units(next(robot.model for robot in cell.robots if robot.name == owner))

    @property
    def channel_names(self) -> tuple[str, ...]:
        """The names of the residuals' channels, in the device's frame."""
        observations = self.report.measurements.cell.series[self.number].observations
        turns = ("turn x", "turn y", "turn z") if isinstance(observations, PoseObservations) else ()
        return (observations.kind,) if observations.channels == 1 else ("x", "y", "z", *turns)

    @cached_property
    def fit_residuals(self) -> Array:
        """Measured minus fitted (channels, N) [m, rad]."""
        return self._compute_residuals(before=False)

    @cached_property
    def signed_mm(self) -> dict[str, tuple[Array, Array]]:
        """Residuals of places before and after [mm], along the axes of the device."""
        pair = self._compute_residuals(before=True) * 1e3, self.fit_residuals * 1e3
        return {name: (pair[0][i], pair[1][i]) for i, name in enumerate(self.channel_names[:3])}

    def _compute_residuals(self, *, before: bool) -> Array:
        found = self.report.identification
        state, problem = found.robust.fit.state, found.robust.problem
        if before:
            state, problem = found.before, problem.with_terms_of(found.before)
        rows = replace(problem.series[self.number], whitener=None)
        plain: Array = series_residuals(rows, state) / rows.observations.inverse_sigmas(np.arange(len(rows)))
        return plain

    @property
    def fitted_rows(self) -> Rows:
        """Lines of all rows (N,)."""
        return self.report.measurements.lines[self.report.series[self.number].name]

    @property
    def rejected_positions(self) -> Rows:
        """Positions among them."""
        return self.report.identification.series[self.number].rejected

    @property
    def rejected_rows(self) -> list[int]:
        """Lines that were not fitted."""
        return [int(line) for line in self.fitted_rows[self.rejected_positions]]

    @property
    def held_out_rows(self) -> Rows:
        """Lines that were held out (H,)."""
        lines: Rows = self.fitted_rows[self.report.identification.series[self.number].held_out]
        return lines

    @property
    def held_out_m(self) -> Array:
        """Their errors (H,)."""
        return self.report.identification.series[self.number].held_out_m

    @property
    def before_m(self) -> Array:
        """Their errors by arms as they were known (H,)."""
        return self.report.identification.series[self.number].before_m

    @property
    def mounting_breaks(self) -> tuple[int, ...]:
        """A cell's layout says which device was moved; none are looked for."""
        return ()


def draw_cell(report: IdentifiedCellReport, folder: Path) -> list[Path]:
    """Draw the page and every figure; return the files written, PNG and SVG each."""
    return write_figures(draw_cell_figures(report), folder)


def draw_cell_figures(report: IdentifiedCellReport) -> dict[str, Figure]:
    """Return the figures by the names of their files."""
    every = [SeriesEvidence(report, number) for number in range(len(report.series))]
    figures = {}
    with figure_style():
        figures["overview"] = _draw_overview(report, every)
        for evidence, series in zip(every, report.series, strict=True):
            name, channels = (
                re.sub(r"[^0-9A-Za-z]+", "_", series.name).strip("_"),
                len(evidence.channel_names),
            )
            figures[f"residuals_by_row_{name}"] = new_figure(11.0, 3.2 + 1.3 * channels)
            draw_by_row(figures[f"residuals_by_row_{name}"], evidence)
            figures[f"residuals_by_joint_{name}"] = new_figure(
                *((10.0, 6.0) if channels == 1 else (13.0, 6.6))
            )
            draw_by_joint(figures[f"residuals_by_joint_{name}"], evidence)
            if series.held_out.n:
                figures[f"distribution_{name}"] = new_figure(10.0, 4.0)
                draw_distribution(figures[f"distribution_{name}"], evidence)
        fit = report.identification.robust.fit
        side = min(max(4.5, 0.15 * len(fit.layout) + 2.0), 11.0)
        figures["correlations"] = new_figure(side * 1.4 + 0.5, side)
        matrix_of(figures["correlations"], "cell", fit)
    return figures


def _draw_overview(report: IdentifiedCellReport, every: list[SeriesEvidence]) -> Figure:
    """Draw held-out errors of every series, by row and by size."""
    figure = new_figure(13.0, 1.0 + 2.3 * len(every))
    panels = figure.subplots(len(every), 2, width_ratios=[2.6, 1.0], squeeze=False)
    title_of(figure, f"A cell in one fit: level {report.level}, {LEVEL_NAMES[report.level]}")
    for (left_panel, right_panel), evidence in zip(panels, every, strict=True):
        held_out_by_row(left_panel, evidence)
        left_panel.set_title(evidence.figure_title, loc="left")
        if len(evidence.held_out_m):
            draw_histogram(right_panel, evidence)
            right_panel.set_xlabel("error (mm)")
        else:
            left_panel.set_title(f"{evidence.figure_title}: too short to hold rows out", loc="left")
            left_panel.set_axis_off()
            right_panel.set_axis_off()
    panels[-1, 0].set_xlabel("line of the file")
    return figure
