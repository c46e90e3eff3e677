"""One page of summary: what was measured, the accuracy reached, where, and what is doubtful."""

import numpy as np
from matplotlib.figure import FigureBase

from cellcal.calibration.identification.parameters import LEVEL_NAMES
from cellcal.service.engineering.identification.identify import IdentifyReport
from cellcal.service.engineering.plots.distribution import draw_histogram, draw_shares
from cellcal.service.engineering.plots.evidence import IdentificationEvidence
from cellcal.service.engineering.plots.residuals import held_out_by_row
from cellcal.service.engineering.plots.style import title_of
from cellcal.service.engineering.plots.workspace import draw_maps

_MOST_NOTES = 4
_SAMPLE = 500  # rows, for a median


def draw_overview(figure: FigureBase, evidence: IdentificationEvidence) -> None:
    """Draw the page."""
    report = evidence.report
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.0, 2.1]).flat
    left_part, right_part = lower.subfigures(1, 2, squeeze=False, width_ratios=[1.15, 1.0]).flat
    title_of(upper, f"{evidence.figure_title}: identification from {report.rows} rows")
    rows = upper.subplots()
    held_out_by_row(rows, evidence)
    rows.set_xlabel("data row")
    draw_maps(left_part, evidence)
    panels = right_part.subplot_mosaic([["bins", "shares"], ["words", "words"]], height_ratios=[1.0, 0.8])
    draw_histogram(panels["bins"], evidence)
    draw_shares(panels["shares"], evidence)
    panels["words"].axis("off")
    words = "\n".join([*_summary_lines(report), *_prediction_lines(evidence)])
    panels["words"].text(0.0, 0.95, words, va="top", fontsize=9.5, linespacing=1.4)


def _summary_lines(report: IdentifyReport) -> list[str]:
    found = report.identification
    before, after = report.before, report.held_out
    lines = [
        f"Model: level {report.level}, {LEVEL_NAMES[report.level]}.",
        f"Held out: mean {before.mean_m * 1e3:.3f} to {after.mean_m * 1e3:.3f} mm, "
        f"95 % {before.p95_m * 1e3:.3f} to {after.p95_m * 1e3:.3f} mm,",
        f"  largest {before.max_m * 1e3:.3f} to {after.max_m * 1e3:.3f} mm.",
        f"Residual of the fit (no accuracy): {report.fit.rmse_m * 1e3:.3f} mm RMSE.",
    ]
    if report.check is not None:
        lines.append(f"Check file: mean {report.check.mean_m * 1e3:.3f} mm of {report.check.n} rows.")
    if report.breaks:
        lines.append(f"The device was moved before rows {', '.join(map(str, report.breaks))}.")
    if report.rejected:
        lines.append(f"Rows not used: {len(report.rejected)}, each with its reason in the report.")
    if found.not_identified:
        lines.append(
            f"Parameters that these rows do not tell: {len(found.not_identified)}, each with its cure."
        )
    if found.correlated:
        lines.append(f"Pairs of the arm's parameters that correlate beyond 0.95: {len(found.correlated)}.")
    if report.lints:
        lines.append(f"Notes of the data checks: {len(report.lints)} ({', '.join(_lint_lines(report))}).")
    return lines


def _prediction_lines(evidence: IdentificationEvidence) -> list[str]:
    count = len(evidence.held_out_joints_rad)
    some = np.linspace(0, count - 1, min(count, _SAMPLE)).astype(np.intp)
    here = float(np.median(evidence.sigma_m(evidence.held_out_joints_rad[some])))
    everywhere = float(np.median(evidence.predicted_reach.sigma_m))
    return [
        f"Predicted uncertainty of the target's place (k = 1): {here * 1e3:.3f} mm in postures as measured,",
        f"  {everywhere * 1e3:.3f} mm over the whole reach; what the model lacks is not in it.",
    ]


def _lint_lines(report: IdentifyReport) -> list[str]:
    codes = list(dict.fromkeys(lint.code.replace("_", " ") for lint in report.lints))
    return codes if len(codes) <= _MOST_NOTES else [*codes[:_MOST_NOTES], "…"]
