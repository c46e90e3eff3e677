"""How pictures look and are written: colours that the colour-blind tell apart, PNG and SVG, the same every time."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# After M. Okabe, K. Ito, Color Universal Design, 2008; shapes differ too.
BEFORE, AFTER, WARNING, QUIET = "#8c8c8c", "#0072b2", "#d55e00", "#c9c9c9"
ERROR_MAP, DOUBT_MAP, SIGNED_MAP = "cividis", "viridis", "RdBu_r"
_HASH_SALT = "cellcal"  # the same figures make the same files
_DPI = 130


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def style_axes(axes: "Axes") -> None:
    """Leave a light grid and the axes that are read."""
    axes.grid(alpha=0.25, lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def title_of(figure: FigureBase, text: str) -> None:
    """Write a title at the left, where reading begins."""
    figure.suptitle(text, x=0.01, ha="left", fontsize=11, weight="bold")


def write_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write every figure as PNG and SVG and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context({"svg.hashsalt": _HASH_SALT, "svg.fonttype": "none"}):
        for name, figure in figures.items():
            for suffix in ("png", "svg"):
                path = folder / f"{name}.{suffix}"
                figure.savefig(path, dpi=_DPI, metadata={"Date": None} if suffix == "svg" else None)
                written.append(path)
    return written


@contextmanager
def figure_style() -> Iterator[None]:
    """Draw with our sizes of letters."""
    with mpl.rc_context(
        {"font.size": 9.0, "axes.titlesize": 9.5, "axes.labelsize": 9.0, "legend.fontsize": 8.0}
    ):
        yield
