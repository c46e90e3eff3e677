"""The pictures of an identification, written as files: one page to begin with, and each figure for itself."""

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure, FigureBase

from cellcal.service.engineering.identification.identify import IdentifyReport
from cellcal.service.engineering.plots.correlations import correlation_matrix
from cellcal.service.engineering.plots.distribution import draw_distribution
from cellcal.service.engineering.plots.evidence import IdentificationEvidence
from cellcal.service.engineering.plots.overview import draw_overview
from cellcal.service.engineering.plots.residuals import draw_by_joint, draw_by_row
from cellcal.service.engineering.plots.style import figure_style, new_figure, write_figures
from cellcal.service.engineering.plots.workspace import error_map

_Draw = Callable[[FigureBase, IdentificationEvidence], None]


def draw_identification(report: IdentifyReport, folder: Path) -> list[Path]:
    """Draw the page and every figure; return the files written, PNG and SVG each."""
    return write_figures(draw_figures(report), folder)


def draw_figures(report: IdentifyReport) -> dict[str, Figure]:
    """Return the figures by the names of their files."""
    evidence = IdentificationEvidence(report)
    channels, one = len(evidence.channel_names), len(evidence.channel_names) == 1
    unknowns = len(report.identification.robust.fit.layout)
    drawings: dict[str, tuple[tuple[float, float], _Draw]] = {
        "overview": ((14.0, 9.6), draw_overview),
        "residuals_by_row": ((11.0, 3.2 + 1.3 * channels), draw_by_row),
        "residuals_by_joint": ((10.0, 6.0) if one else (13.0, 6.6), draw_by_joint),
        "workspace": ((11.0, 8.6), error_map),
        "correlations": (_square_page(unknowns), correlation_matrix),
        "distribution": ((10.0, 4.0), draw_distribution),
    }
    figures = {}
    with figure_style():
        for name, (size, draw) in drawings.items():
            figures[name] = new_figure(*size)
            draw(figures[name], evidence)
    return figures


def _square_page(unknowns: int) -> tuple[float, float]:
    """Return a page on which every name can be read."""
    side = min(max(4.5, 0.15 * unknowns + 2.0), 10.0)
    return side * 1.4 + 0.5, side
