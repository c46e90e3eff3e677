"""Reports as files for other programs, one program after another: a line's million points are never held at once."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import join_messages
from cellcal.service.csv_writing import write_rows
from cellcal.service.engineering.programs.diff import unified_diff
from cellcal.service.engineering.programs.files import RefusedProgram
from cellcal.service.engineering.programs.report import ProgramsReport
from cellcal.service.engineering.programs.result import PointFinding, ProgramResult

COLUMNS = (
    "program", "point", "line", "kind", "user_frame", "tool", "status", "reason", "shift_mm", "turn_deg",
    "expected_error_mm", "uncorrected_mm", "x_before_mm", "y_before_mm", "z_before_mm", "x_after_mm", "y_after_mm",
    "z_after_mm", "base_x_mm", "base_y_mm", "base_z_mm", "configuration_before", "configuration_after",
)  # fmt: skip
_DECIMALS = 6  # of a millimetre or a degree: finer than any program writes


def point_columns(result: ProgramResult) -> dict[str, Sequence[Any]]:
    """Return the N points of a program as columns of COLUMNS; None where unknown."""
    before, after = result.before.positions, result.after.positions
    count = len(before)
    base = result.base_tip_after[:, :3, 3]
    return dict(
        zip(
            COLUMNS,
            (
                [result.program_name] * count,
                before.names,
                before.lines.tolist(),
                before.kinds,
                before.user_frames,
                before.tools,
                result.status,
                _point_reasons(result),
                _rounded_figures(result.shift_m * 1e3),
                _rounded_figures(np.degrees(result.turn_rad)),
                _rounded_figures(result.expected_error_m * 1e3),
                _rounded_figures(result.uncorrected_m * 1e3),
                *(_rounded_figures(before.frame_tip[:, i, 3] * 1e3) for i in range(3)),
                *(_rounded_figures(after.frame_tip[:, i, 3] * 1e3) for i in range(3)),
                *(_rounded_figures(base[:, i] * 1e3) for i in range(3)),
                before.configurations,
                after.configurations,
            ),
            strict=True,
        )
    )


def _point_reasons(result: ProgramResult) -> Sequence[str]:
    """Return why points are left, and what is found of those that are not."""
    if not result.findings:
        return result.reason
    reasons = list(result.reason)
    for one in result.findings:
        if one.row >= 0:
            reasons[one.row] = join_messages(" ", filter(None, (reasons[one.row], one.text)))
    return reasons


@dataclass(frozen=True, slots=True)
class ReportFormat:
    """The form of a report, program by program, so that programs may be worked on apart."""

    head: bytes
    one: Callable[[str, str, ProgramResult], bytes]  # source, where the new one is, what became of it
    between: bytes
    end: Callable[[ProgramsReport], bytes]


def report_formats(title: str) -> dict[str, ReportFormat]:
    """Return the formats by their names."""
    head = f'{{"format": 1, "title": {json.dumps(title)}, "programs": [\n'.encode()
    return {
        "csv": ReportFormat(_csv_bytes([COLUMNS]), csv_rows, b"", lambda _: b""),
        "json": ReportFormat(head, json_program, b",\n", json_end),
        "diff": ReportFormat(b"", diff_of, b"", lambda _: b""),
    }


def csv_rows(_: str, __: str, result: ProgramResult) -> bytes:
    """Return a row a point."""
    return _csv_bytes(zip(*point_columns(result).values(), strict=True))


def json_program(source: str, written: str, result: ProgramResult) -> bytes:
    """Return a program as an object, its points in it."""
    columns = point_columns(result)
    columns.pop("program")
    names = tuple(columns)
    return _to_json_bytes(
        {
            "program": result.program_name,
            "brand": result.before.brand,
            "source": source,
            "written": written,
            "counts": result.status_counts,
            "warnings": [text for text in result.warnings if not text.startswith("line ")],
            "findings": [finding_object(one) for one in result.findings],
            "remarks": [{"line": r.line, "code": r.code, "text": r.text} for r in result.before.remarks],
            "points": [dict(zip(names, row, strict=True)) for row in zip(*columns.values(), strict=True)],
        }
    )


def finding_object(finding: PointFinding) -> dict[str, object]:
    """Return a finding in millimetres and degrees; None for what the program does not tell."""
    return {
        "line": finding.line,
        "point": finding.point,
        "what": finding.what,
        "angle_deg": round(math.degrees(finding.angle_rad), _DECIMALS),
        "distance_mm": _rounded_or_none(finding.distance_m * 1e3),
        "turn_deg": _rounded_or_none(math.degrees(finding.turn_rad)),
        "text": finding.text,
    }


def _rounded_or_none(figure: float) -> float | None:
    return round(figure, _DECIMALS) if math.isfinite(figure) else None


def json_end(report: ProgramsReport) -> bytes:
    """Return what is known at the end: what was refused, and the sums."""
    rest = _to_json_bytes(
        {"refused": [_refused_to_json(one) for one in report.refused], **report_totals(report)}
    )
    return b"\n], " + rest[1:] + b"\n"


def diff_of(source: str, written: str, result: ProgramResult) -> bytes:
    """Return a unified diff."""
    return unified_diff(result.before.to_bytes(), result.after.to_bytes(), source, written)


def report_totals(report: ProgramsReport) -> dict[str, object]:
    """Return a report's figures as a whole."""
    return {
        "program_count": len(report.entries),
        "point_count": report.point_count,
        "counts": report.status_counts,
        "finding_count": report.finding_count,
        "unread": list(report.unread),
        "largest_shift_mm": _largest_mm(report.column_values("shift_m")),
        "largest_expected_error_mm": _largest_mm(report.column_values("expected_m")),
        "exit_code": int(report.exit_code),
    }


def _refused_to_json(one: RefusedProgram) -> Mapping[str, str]:
    return {"file": one.file, "message": one.message, "remedy": one.remedy}


def _to_json_bytes(found: Mapping[str, Any]) -> bytes:
    return json.dumps(found, allow_nan=False, ensure_ascii=False).encode(errors="replace")


def _rounded_figures(figures: Array) -> list[float | None]:
    """Return rounded figures; None instead of NaN, which is no JSON."""
    rounded = np.round(figures, _DECIMALS) + 0.0
    if np.isfinite(rounded).all():
        return list(rounded.tolist())
    return [value if value == value else None for value in rounded.tolist()]  # noqa: PLR0124  NaN is not itself


def _largest_mm(figures: Array) -> float | None:
    finite = figures[np.isfinite(figures)]
    return round(float(finite.max()) * 1e3, _DECIMALS) if len(finite) else None


def _csv_bytes(rows: Iterable[Iterable[Any]]) -> bytes:
    text = _CsvLines()
    write_rows(text, rows, line_end="\n")
    return "".join(text.parts).encode(errors="replace")


class _CsvLines:
    """The stream to which a csv writer writes."""

    def __init__(self) -> None:
        self.parts: list[str] = []

    def write(self, text: str) -> None:
        """Keep a line."""
        self.parts.append(text)
