"""The correlation matrix of an identification: which parameters cannot be told apart."""

from itertools import pairwise

import numpy as np
from matplotlib.figure import FigureBase
from matplotlib.patches import Rectangle

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.identifiability import UncertainEstimate, parameter_correlations
from cellcal.service.engineering.plots.evidence import IdentificationEvidence
from cellcal.service.engineering.plots.style import SIGNED_MAP, title_of

_STRONG = 0.95
_MOST_NAMES = 64  # beyond, ripple is left out
_MOST_LISTED = 16


def correlation_matrix(figure: FigureBase, evidence: IdentificationEvidence) -> None:
    """Draw the matrix of one device's identification."""
    matrix_of(figure, evidence.figure_title, evidence.report.identification.robust.fit)


def matrix_of(figure: FigureBase, title: str, fit: UncertainEstimate) -> None:
    """Draw the matrix with names, frames round the pairs beyond 0.95, and a list of the strongest."""
    roles = [parameter.role for parameter in fit.layout.parameters]
    shown = np.arange(len(roles))
    if len(roles) > _MOST_NAMES:
        shown = np.flatnonzero([role != "harmonic" for role in roles])
    names = [fit.layout.parameters[i].name for i in shown]
    rho = parameter_correlations(fit)[np.ix_(shown, shown)]
    panel, beside = figure.subplots(1, 2, width_ratios=[3.6, 1.0])
    words = "" if len(shown) == len(roles) else ", ripple left out"
    title_of(figure, f"{title}: correlation of {len(shown)} parameters{words}")
    image = panel.imshow(rho, cmap=SIGNED_MAP, vmin=-1, vmax=1, interpolation="nearest")
    size = 7.5 if len(shown) <= 50 else 6.0
    panel.set_xticks(range(len(names)), names, rotation=90, fontsize=size)
    panel.set_yticks(range(len(names)), names, fontsize=size)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    for i, (one, following) in enumerate(pairwise(name.split()[0] for name in names)):
        if one != following:
            panel.axhline(i + 0.5, color="black", lw=0.6)
            panel.axvline(i + 0.5, color="black", lw=0.6)
    pairs = strong_pairs(rho)
    for i, j in pairs:
        for x, y in ((i, j), (j, i)):
            panel.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, ec="black", lw=1.0))
    figure.colorbar(image, ax=panel, label="correlation", shrink=0.5, pad=0.01)
    beside.axis("off")
    beside.text(0, 1, _list_pairs(pairs, names, rho), va="top", fontsize=8, transform=beside.transAxes)


def strong_pairs(rho: Array) -> list[tuple[int, int]]:
    """Return the pairs beyond 0.95, strongest first."""
    first, second = np.nonzero(np.triu(np.abs(rho) > _STRONG, 1))
    order = np.argsort(-np.abs(rho[first, second]), kind="stable")
    return [(int(first[i]), int(second[i])) for i in order]


def _list_pairs(pairs: list[tuple[int, int]], names: list[str], rho: Array) -> str:
    if not pairs:
        return f"No pair beyond {_STRONG:g}."
    lines = [f"Beyond {_STRONG:g} (framed): {len(pairs)} pairs.", "They mean something only together.", ""]
    lines += [f"{rho[i, j]:+.3f}  {names[i]} | {names[j]}" for i, j in pairs[:_MOST_LISTED]]
    if len(pairs) > _MOST_LISTED:
        lines.append(f"… and {len(pairs) - _MOST_LISTED} more")
    return "\n".join(lines)
