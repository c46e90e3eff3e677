"""A report as one page: figures, pictures, tables. No script, no font, nothing from another host."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.service.engineering.programs.report import (
    PointLine,
    ProgramEntry,
    ProgramsReport,
    largest_finite,
)
from cellcal.service.engineering.programs.report_picture import (
    CIVIDIS,
    MOST_DRAWN,
    VIRIDIS,
    Colouring,
    DrawnPoints,
    two_views,
)
from cellcal.service.engineering.programs.report_sentences import (
    SCREEN,
    accuracy_text,
    heading_text,
    list_problems,
    refusal_text,
    verdict_text,
)
from cellcal.service.engineering.programs.report_texts import ReportLanguage, count_with_noun

Rows = NDArray[np.intp]

_MOST_ROWS = 500
_STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --quiet: #5c5c5c; --page: #ffffff; --line: #d4d4d4;
  --left: #d55e00; --band: #f4f4f4; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e8e8; --quiet: #a8a8a8; --page: #16181b;
  --line: #43474c; --left: #ff9d57; --band: #dfe3e6; } }
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--page);
  max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
.verdict { font-size: 1.1rem; font-weight: 600; } .bad, td.bad { color: var(--left); }
.quiet { color: var(--quiet); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; font-size: .9rem; }
caption { text-align: left; color: var(--quiet); padding-bottom: .3rem; }
th, td { text-align: left; padding: .25rem .6rem .25rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; overflow-wrap: anywhere; min-width: 6rem; }
th { vertical-align: bottom; } th.n, td.n { text-align: right; overflow-wrap: normal; min-width: 0; }
td.n { white-space: nowrap; }
figure { margin: 1rem 0 1.5rem; } figcaption { font-weight: 600; margin-bottom: .3rem; }
.views { display: flex; flex-wrap: wrap; gap: .5rem; } .views svg { flex: 1 1 26rem; min-width: 0;
  max-width: 100%; height: auto; }
svg text { fill: var(--quiet); font: 11px system-ui, sans-serif; } svg text.view { fill: var(--ink); }
svg .frame { fill: var(--band); stroke: var(--line); } svg .grid { stroke: #c6c9cc; fill: none; }
svg circle { stroke: #1b1b1b; stroke-width: .5; stroke-opacity: .55; }
svg .left { stroke: #d55e00; fill: none; }
svg .unknown { fill: none; stroke: #7d7d7d; stroke-width: 1.4; stroke-opacity: 1; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem 1rem; font-size: .85rem; margin: .3rem 0 0; }
.legend span { display: inline-flex; align-items: center; gap: .35rem; white-space: nowrap; }
.legend i { width: .9rem; height: .9rem; border: 1px solid var(--line); }
"""


def as_html(report: ProgramsReport, language: ReportLanguage = SCREEN) -> str:
    """Return the page."""
    worst, texts = report.worst_first(_MOST_ROWS), language.texts
    title = escape(heading_text(report, language))
    refused = [refusal_text(one, language) for one in report.refused]
    parts = [
        f"<h1>{title}</h1>",
        f'<p class="verdict{" bad" if report.exit_code else ""}">{escape(verdict_text(report, language))}</p>',
        f"<p>{escape(accuracy_text(report, language))}</p>",
        _render_list(texts.refused_title, refused),
        _render_list(texts.notes_title, list_problems(report, language)),
        _render_pictures(report, language),
        _render_programs(report.programs_worst_first(), language) if report.entries else "",
        _render_points(worst, report.point_count, language) if worst else "",
    ]
    return (
        f'<!doctype html>\n<html lang="{language.locale}"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head>\n"
        f"<body>{''.join(parts)}</body></html>\n"
    )


def _render_pictures(report: ProgramsReport, language: ReportLanguage) -> str:
    if not report.point_count:
        return ""
    texts = language.texts
    picture = points_to_draw(report, language)
    shown = picture.rows
    if not len(shown):
        return f'<p class="quiet">{escape(texts.no_picture)}</p>'
    about = texts.in_base if picture.in_base else texts.in_frames
    pictures = [
        two_views(
            picture.drawn, Colouring(title, report.column_values(name)[shown], colours), about, language
        )
        for title, name, colours in (
            (texts.moved_title, "shift_m", CIVIDIS),
            (texts.expected_title, "expected_m", VIRIDIS),
        )
        if np.isfinite(report.column_values(name)).any()
    ]
    notes = [texts.under_mouse]
    if report.point_count > picture.placed_count:
        notes.insert(0, count_with_noun(report.point_count - picture.placed_count, texts.not_drawn))
    if len(shown) < picture.placed_count:
        notes.insert(0, texts.some_drawn.format(shown=len(shown), total=report.point_count))
    about_it = f'<p class="quiet">{escape(language.join(notes))}</p>'
    return f"<h2>{escape(texts.picture_title)}</h2>{''.join(pictures)}{about_it}"


@dataclass(frozen=True, eq=False)
class PictureSelection:
    """The points of a picture: their rows in the report, the worst last and so on top."""

    rows: Rows
    drawn: DrawnPoints
    in_base: bool  # else each in its own user frame
    placed_count: int  # the number of points whose place is known


def points_to_draw(report: ProgramsReport, language: ReportLanguage = SCREEN) -> PictureSelection:
    """Return the points of a report's picture, in the robot's base where that is known."""
    base = _rows_of_places(report, "base_place_m")
    in_base = bool(np.isfinite(base).all(axis=1).any())
    place = base if in_base else _rows_of_places(report, "frame_place_m")
    placed = np.flatnonzero(np.isfinite(place).all(axis=1))
    shown = _choose_rows(report, placed)
    drawn = DrawnPoints(
        place[shown], report.column_values("left")[shown].astype(bool), _point_labels(report, shown, language)
    )
    return PictureSelection(shown, drawn, in_base, len(placed))


def _rows_of_places(report: ProgramsReport, name: str) -> Array:
    return np.concatenate([getattr(entry, name) for entry in report.entries]).astype(float)


def _choose_rows(report: ProgramsReport, placed: Rows) -> Rows:
    """Return rows to draw: the worst and a share of the others, the worst last and so on top."""
    ordered = report.worst_first_rows()
    ordered = ordered[np.isin(ordered, placed)]
    if len(ordered) <= MOST_DRAWN:
        return ordered[::-1]
    worst, others = ordered[: MOST_DRAWN // 2], ordered[MOST_DRAWN // 2 :]
    share = others[np.linspace(0, len(others) - 1, MOST_DRAWN // 2).astype(int)]
    return np.concatenate([worst, share])[::-1]


def _point_labels(report: ProgramsReport, rows: Rows, language: ReportLanguage) -> list[str]:
    starts = np.cumsum([0, *(len(entry.points) for entry in report.entries)])
    entries = np.searchsorted(starts, rows, side="right") - 1
    return [
        _point_label(report.entries[at], int(row - starts[at]), language)
        for at, row in zip(entries, rows, strict=True)
    ]


def _point_label(entry: ProgramEntry, i: int, language: ReportLanguage) -> str:
    point, texts = f"{entry.program} {entry.points[i]}", language.texts
    if entry.left[i]:
        return texts.label_left.format(point=point, reason=language.say(entry.reasons[i]))
    shift, expected = (_format_mm(figure, language) for figure in (entry.shift_m[i], entry.expected_m[i]))
    return texts.label_moved.format(point=point, shift=shift, expected=expected)


def _render_list(title: str, lines: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<h2>{escape(title)}</h2><ul>{items}</ul>" if items else ""


def _render_programs(entries: Sequence[ProgramEntry], language: ReportLanguage) -> str:
    rows = [
        (
            (entry.program, ""),
            (entry.file, ""),
            (str(len(entry.points)), "n"),
            (str(entry.counts["changed"]), "n"),
            (str(entry.counts["unchanged"]), "n"),
            (str(entry.counts["left"]), "n bad" if entry.counts["left"] else "n"),
            (_format_mm(largest_finite(entry.shift_m), language), "n"),
            (_format_mm(largest_finite(entry.expected_m), language), "n"),
        )
        for entry in entries[:_MOST_ROWS]
    ]
    texts = language.texts
    caption = _how_many(len(rows), len(entries), texts.worst_programs, texts.worst_first)
    return f"<h2>{escape(texts.programs_title)}</h2>" + _render_table(texts.program_heads, rows, caption)


def _render_points(points: Sequence[PointLine], total: int, language: ReportLanguage) -> str:
    rows = [
        (
            (point.program, ""),
            (point.point, ""),
            (str(point.line), "n"),
            (_format_mm(point.shift_m, language), "n"),
            (_format_deg(point.turn_rad, language), "n"),
            (_format_mm(point.expected_m, language), "n"),
            (_format_mm(point.uncorrected_m, language), "n"),
            (language.say(point.reason), "bad" if point.is_excluded else ""),
        )
        for point in points
    ]
    texts = language.texts
    caption = _how_many(len(rows), total, texts.worst_points, texts.worst_first)
    return f"<h2>{escape(texts.points_title)}</h2>" + _render_table(texts.point_heads, rows, caption)


def _how_many(shown: int, total: int, some: str, everything: str) -> str:
    return everything if shown == total else some.format(shown=shown, total=total)


def _render_table(heads: Sequence[str], rows: Sequence[Sequence[tuple[str, str]]], caption: str) -> str:
    head = "".join(
        f'<th scope="col"{" class=n" if name.endswith("#") else ""}>{escape(name.rstrip("#"))}</th>'
        for name in heads
    )
    body = "".join(
        "<tr>" + "".join(f'<td class="{kind}">{escape(text)}</td>' for text, kind in row) + "</tr>\n"
        for row in rows
    )
    return (
        f'<div class="scroll"><table><caption>{escape(caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table></div>"
    )


def _format_mm(value_m: float, language: ReportLanguage) -> str:
    return language.number(f"{value_m * 1e3:.3f}") if math.isfinite(value_m) else "-"


def _format_deg(value_rad: float, language: ReportLanguage) -> str:
    return language.number(f"{math.degrees(value_rad):.4f}") if math.isfinite(value_rad) else "-"
