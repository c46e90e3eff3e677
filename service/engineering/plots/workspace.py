"""Where in its reach the arm was measured, how far off it was there, and how well it will be known elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import FigureBase

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import LengthObservations
from cellcal.service.engineering.plots.evidence import IdentificationEvidence, thin_rows
from cellcal.service.engineering.plots.style import DOUBT_MAP, ERROR_MAP, style_axes, title_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CELLS = 24  # along the longer side of a view
_DENSE = 1500
_FEW = 150  # rows: dots rather than cells


@dataclass(frozen=True, eq=False)
class _PlaneView:
    """One look at the cell: what lies across and up [m], of the reach and of the measured places."""

    words: tuple[str, str, str]  # title, across, up
    reach: tuple[Array, Array]
    measured: tuple[Array, Array]

    def axis_limits(self) -> tuple[float, float, float, float]:
        """Return left, right, bottom, top: of the whole reach, so that a small box of measurements looks small."""
        low_high = []
        for reach, measured in zip(self.reach, self.measured, strict=True):
            both = np.concatenate([reach, measured])
            margin = 0.03 * float(np.ptp(both)) + 1e-3
            low_high += [float(both.min()) - margin, float(both.max()) + margin]
        lowest_across, highest_across, lowest_up, highest_up = low_high
        return lowest_across, highest_across, lowest_up, highest_up

    def hexagon_counts(self) -> tuple[int, int]:
        """Return how many hexagons across and up make them regular."""
        lowest_across, highest_across, lowest_up, highest_up = self.axis_limits()
        size = max(highest_across - lowest_across, highest_up - lowest_up) / _CELLS
        return max(round((highest_across - lowest_across) / size), 1), max(
            round((highest_up - lowest_up) / size / np.sqrt(3)), 1
        )


def error_map(figure: FigureBase, evidence: IdentificationEvidence) -> None:
    """Draw the maps with a title."""
    title_of(figure, f"{evidence.figure_title}: error and predicted uncertainty over the workspace")
    draw_maps(figure, evidence)


def draw_maps(figure: FigureBase, evidence: IdentificationEvidence) -> None:
    """Draw held-out errors where they were measured, and predicted uncertainty over the reach; side and top."""
    widths = [view.axis_limits()[1] - view.axis_limits()[0] for view in _plane_views(evidence)]
    grid = figure.subplots(2, 2, width_ratios=widths)
    draw_measured(grid[0], evidence)
    draw_predicted(grid[1], evidence)


def draw_measured(panels: "Sequence[Axes] | Array", evidence: IdentificationEvidence) -> None:
    """Draw the held-out error where the target was: the mean of a cell, or each row if there are few."""
    errors = evidence.report.held_out_m * 1e3
    few = len(errors) <= _FEW
    drawn: list[PathCollection | PolyCollection] = []
    for panel, view in zip(panels, _plane_views(evidence), strict=True):
        if few:
            drawn.append(panel.scatter(*view.measured, c=errors, s=18, cmap=ERROR_MAP, lw=0))
        else:
            cells, extent = view.hexagon_counts(), view.axis_limits()
            drawn.append(
                panel.hexbin(*view.measured, C=errors, gridsize=cells, extent=extent, cmap=ERROR_MAP, lw=0.1)
            )
        _frame_panel(panel, view)
    shown = np.concatenate([np.asarray(each.get_array()) for each in drawn])
    norm = Normalize(0.0, max(float(np.percentile(shown, 98)), 1e-6))
    for each in drawn:
        each.set_norm(norm)
    words = "held-out error (mm)" if few else "held-out error,\nmean of a cell (mm)"
    _draw_colour_bar(panels, ScalarMappable(norm, ERROR_MAP), words, extend="max")


def draw_predicted(panels: "Sequence[Axes] | Array", evidence: IdentificationEvidence) -> None:
    """Draw the predicted uncertainty of the target's place in cells of the reach, the measured places as dots."""
    sigma = evidence.predicted_reach.sigma_m * 1e3
    low, high = np.percentile(sigma, (2, 98))
    norm = Normalize(float(low), max(float(high), float(low) + 1e-9))
    some = thin_rows(np.zeros(len(evidence.held_out_places_m)))
    for panel, view in zip(panels, _plane_views(evidence), strict=True):
        panel.hexbin(
            *view.reach, C=sigma,
            gridsize=view.hexagon_counts(), extent=view.axis_limits(), reduce_C_function=np.median,
            cmap=DOUBT_MAP, norm=norm, lw=0.1,
        )  # fmt: skip
        x, y = (values[some] for values in view.measured)
        fast = len(some) > _DENSE
        panel.plot(x, y, ".", color="white", ms=4.5, mew=0, rasterized=fast)
        panel.plot(x, y, ".", color="black", ms=2.2, mew=0, rasterized=fast)
        _frame_panel(panel, view)
    frame = " in a user frame" if isinstance(evidence.fitted_observations, LengthObservations) else ""
    words = f"predicted uncertainty{frame},\nmedian of all attitudes (mm, k = 1); dots: rows"
    _draw_colour_bar(panels, ScalarMappable(norm, DOUBT_MAP), words, extend="both")


def _plane_views(evidence: IdentificationEvidence) -> tuple[_PlaneView, _PlaneView]:
    (x, y, z), (seen_x, seen_y, seen_z) = evidence.predicted_reach.places_m.T, evidence.held_out_places_m.T
    side = ("from the side", "distance from J1's axis (m)", "height z (m)")
    above = ("from above", "x (m)", "y (m)")
    return (
        _PlaneView(side, (np.hypot(x, y), z), (np.hypot(seen_x, seen_y), seen_z)),
        _PlaneView(above, (x, y), (seen_x, seen_y)),
    )


def _frame_panel(panel: "Axes", view: _PlaneView) -> None:
    lowest_across, highest_across, lowest_up, highest_up = view.axis_limits()
    panel.set_xlim(lowest_across, highest_across)
    panel.set_ylim(lowest_up, highest_up)
    panel.set_aspect("equal")
    panel.plot(0, 0, "+", color="black", ms=9, clip_on=False)
    title, across, up = view.words
    panel.set_title(title, loc="left")
    panel.set_xlabel(across)
    panel.set_ylabel(up)
    style_axes(panel)


def _draw_colour_bar(
    panels: "Sequence[Axes] | Array", shown: ScalarMappable, label: str, *, extend: str
) -> None:
    panels[0].figure.colorbar(shown, ax=list(panels), label=label, extend=extend, shrink=0.85)
