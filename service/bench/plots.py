"""Results of a benchmark as files: one JSON document, and a plot of each topic as PNG and SVG."""

import json
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from service.bench.results import Topic


def write_results(document: dict[str, Any], topics: tuple[Topic, ...], folder: Path) -> list[Path]:
    """Write everything into a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    text = folder / "bench.json"
    text.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return [text, *(path for topic in topics for path in _draw(topic, folder))]


def _draw(topic: Topic, folder: Path) -> list[Path]:
    cases = list(dict.fromkeys(result.case for result in topic.results))
    figure = Figure(figsize=(7.5, 1.2 + 1.6 * len(cases)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(cases), 1, squeeze=False)[:, 0]
    for panel, case in zip(axes, cases, strict=True):
        results = sorted((r for r in topic.results if r.case == case), key=lambda r: r.rate)
        names = [result.contestant for result in results]
        colours = ["tab:blue" if name == "cellcal" else "tab:grey" for name in names]
        bars = panel.barh(names, [result.rate for result in results], color=colours)
        labels = [f"{r.rate:,.0f}/s, {r.error:.2g} {r.error_unit}" for r in results]
        panel.bar_label(bars, labels=labels, padding=3, fontsize=8)
        panel.set_xscale("log")
        panel.margins(x=0.6)
        panel.set_title(f"{topic.name}, {case}", fontsize=9)
    axes[-1].set_xlabel("poses or rows a second, one thread, one run")
    paths = [folder / f"bench_{topic.name}.{kind}" for kind in ("png", "svg")]
    for path in paths:
        figure.savefig(path, dpi=130, metadata={"Date": None} if path.suffix == ".svg" else None)
    return paths
