"""Results of a benchmark as files: one JSON document, and a plot of each topic as PNG and SVG."""

import json
from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from cellcal.service.engineering.bench.results import BenchResult, BenchTopic
from cellcal.service.engineering.plots.style import (
    AFTER,
    BEFORE,
    figure_style,
    new_figure,
    style_axes,
    title_of,
    write_figures,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BAR_INCHES = 0.27
_TITLE_LETTERS = 105
_FEWFOLD = 20.0  # figures nearer together than this are compared by their lengths


def write_results(document: Mapping[str, object], topics: tuple[BenchTopic, ...], folder: Path) -> list[Path]:
    """Write everything into a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    text = folder / "bench.json"
    text.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with figure_style():
        figures = {f"bench_{topic.name}": draw_topic(topic) for topic in topics if topic.results}
    return [text, *write_figures(figures, folder)]


def draw_topic(topic: BenchTopic) -> Figure:
    """Draw time beside figure of merit, one row of panels a case, fastest on top."""
    cases = list(dict.fromkeys(result.case for result in topic.results))
    by_case = [
        sorted((r for r in topic.results if r.case == case), key=lambda r: r.poses_per_s) for case in cases
    ]
    heights = [len(results) * _BAR_INCHES + 0.5 for results in by_case]
    title = wrap(f"{topic.name}: {topic.question}", _TITLE_LETTERS)
    figure = new_figure(11.0, sum(heights) + 1.0 + 0.2 * len(title))
    title_of(figure, "\n".join(title))
    grid = figure.subplots(len(cases), 2, squeeze=False, sharex="col", height_ratios=heights)
    for panels, case, results in zip(grid, cases, by_case, strict=True):
        _draw_bars(panels[0], results, [each.seconds / each.count * 1e6 for each in results])
        _draw_bars(panels[1], results, [each.error for each in results])
        panels[0].set_title(case, loc="left")
        panels[1].tick_params(labelleft=False)
    grid[-1, 0].set_xscale("log")
    grid[-1, 0].set_xlabel("microseconds of processor time a row or pose, one thread (log)")
    wide = _value_ratio([each.error for each in topic.results]) > _FEWFOLD
    grid[-1, 1].set_xscale("log" if wide else "linear")
    grid[-1, 1].xaxis.set_tick_params(which="both", rotation=0 if wide else 30)
    grid[-1, 1].set_xlabel(topic.results[0].error_unit + (" (log)" if wide else ""))
    return figure


def _value_ratio(values: list[float]) -> float:
    sensible = [value for value in values if 0 < value < float("inf")]
    return max(sensible) / min(sensible) if sensible else 1.0


def _draw_bars(panel: "Axes", results: list[BenchResult], values: list[float]) -> None:
    names = [each.contestant for each in results]
    shown = np.array(values)
    sensible = np.isfinite(shown) & (shown > 0)
    colours = [AFTER if "cellcal" in name else BEFORE for name in names]
    bars = panel.barh(names, np.where(sensible, shown, np.nan), color=colours, height=0.7)
    labels = [
        (f"{value:,.0f}" if value >= 1000 else f"{value:.3g}") if good else "none"
        for value, good in zip(values, sensible, strict=True)
    ]
    panel.bar_label(bars, labels=labels, padding=3, fontsize=8)
    panel.margins(x=0.2)
    style_axes(panel)
    panel.grid(visible=False, axis="y")
