"""What a page shows of programs that were made, as files of a job: a summary, pages of points, the archive."""

import itertools
import os
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from pydantic_core import to_json, to_jsonable_python

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.message import Message, MessageSource, find_message
from cellcal.calibration.message_table import with_messages
from cellcal.service.engineering.programs.jobs.files import ALL, ARCHIVE, OUT, PREVIEW
from cellcal.service.engineering.programs.jobs.shapes import (
    JobPreview,
    PicturePoint,
    PointPreview,
    PointsPage,
    PointsPicture,
    ProgramPreview,
    RefusedFile,
    Triple,
)
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.report import ProgramEntry, ProgramsReport, largest_finite
from cellcal.service.engineering.programs.report_html import points_to_draw
from cellcal.service.engineering.programs.report_picture import CIVIDIS, Colouring, ColourScale
from cellcal.service.engineering.programs.report_sentences import (
    describe_points_off,
    heading_text,
    list_problems,
)
from cellcal.service.engineering.programs.report_texts import ReportLanguage
from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED
from cellcal.service.engineering.programs.verdicts import count_verdicts, place_in, verdict_of
from cellcal.service.path_redaction import without_paths

PAGE = 100
_REPORTS = ("report.html", "report.csv", "report.json")
_PER_MM, _PER_DEG = 1e-3, float(np.pi / 180.0)


@dataclass(frozen=True, eq=False)
class JobResult:
    """The result of a job."""

    report: ProgramsReport
    cell: Project
    target: Project
    notes: Sequence[str]
    request: dict[str, Any]
    language: ReportLanguage


def write_preview(made: JobResult, folder: Path) -> None:
    """Write everything that a page may ask for."""
    report_json = parse_json(read_plain_text(folder / "report.json"))
    verdicts = count_verdicts(
        point["reason"] for program in report_json["programs"] for point in program["points"]
    )
    order = made.report.programs_worst_first()
    by_file = {program["source"]: program for program in report_json["programs"]}
    points = {
        e.file: [_point_preview(e, each) for each in by_file[e.file]["points"]] for e in made.report.entries
    }
    every = [point for entry in made.report.entries for point in points[entry.file]]
    find = _messages_of(made).get
    write_pages([every[row] for row in made.report.worst_first_rows().tolist()], folder, ALL, find)
    for number, entry in enumerate(order):
        write_pages(points[entry.file], folder, str(number), find)
    preview = to_jsonable_python(_build_preview(made, order, verdicts))
    (folder / PREVIEW).write_bytes(to_json(with_messages(preview)))
    write_archive(folder, made.request["archive"])


def _messages_of(made: JobResult) -> dict[str, Message]:
    """Return the messages among the reasons and warnings of every program, by their text."""
    texts = (text for entry in made.report.entries for text in (*entry.reasons, *entry.warnings))
    return {text[:]: text for text in texts if isinstance(text, Message)}


def write_pages(
    points: Sequence[PointPreview], folder: Path, name: str, find: MessageSource = find_message
) -> None:
    """Write points in pages of one size; there is always a first."""
    pages = max(1, -(-len(points) // PAGE))
    for page in range(1, pages + 1):
        some = list(points[(page - 1) * PAGE : page * PAGE])
        points_page = PointsPage(total=len(points), pages=pages, points=some)
        document = with_messages(to_jsonable_python(points_page), find)
        (folder / f"points-{name}-{page}.json").write_bytes(to_json(document))


def write_archive(folder: Path, inside: str) -> None:
    """Write the new programs and the reports into an archive, below a folder of a name that no source has.

    Programs keep their own names, by which a controller looks for them; below that folder they can replace none.
    """
    out = folder / OUT
    with zipfile.ZipFile(folder / ARCHIVE, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(out.rglob("*")):
            if path.is_file():
                archive.write(path, os.fspath(PurePath(inside, OUT, path.relative_to(out))))
        for name in _REPORTS:
            archive.write(folder / name, os.fspath(PurePath(inside, "report", name)))


def _build_preview(made: JobResult, order: Sequence[ProgramEntry], verdicts: dict[str, int]) -> JobPreview:
    report, target = made.report, made.target
    arm = target.identified
    notes = [
        *describe_points_off(report, made.language),
        *map(made.language.say, made.notes),
        *map(without_paths, list_problems(report, made.language)),
    ]
    return JobPreview(
        title=without_paths(heading_text(report, made.language)),
        cell=target.name,
        parameters="" if arm is None else f"{target.serial}, {arm.version}, {arm.sha256[:8]}",
        counts={status: report.status_counts[status] for status in (CHANGED, UNCHANGED, LEFT)},
        verdicts=verdicts,  # type: ignore[arg-type]  # its keys are the verdicts: a test counts them
        collisions_checked=target.shapes is not None,
        largest_shift_m=_finite_or_none(largest_finite(report.column_values("shift_m"))),
        largest_expected_m=_finite_or_none(largest_finite(report.column_values("expected_m"))),
        largest_uncorrected_m=_finite_or_none(largest_finite(report.column_values("uncorrected_m"))),
        programs=[_program_preview(entry) for entry in order],
        refused=[*(RefusedFile(**one) for one in made.request["refused"]), *_refused_files(report)],
        notes=notes,
        page_size=PAGE,
        picture=_build_picture(report, made.language),
    )


def _program_preview(entry: ProgramEntry) -> ProgramPreview:
    return ProgramPreview(
        program=entry.program,
        file=_relative_name(entry.file),
        brand=entry.brand,
        points=len(entry.points),
        changed=entry.counts[CHANGED],
        unchanged=entry.counts[UNCHANGED],
        left=entry.counts[LEFT],
        largest_shift_m=_finite_or_none(largest_finite(entry.shift_m)),
        largest_expected_m=_finite_or_none(largest_finite(entry.expected_m)),
    )


def _refused_files(report: ProgramsReport) -> Iterator[RefusedFile]:
    for one in report.refused:
        place = place_in(one.message)
        yield RefusedFile(
            file=_relative_name(one.file),
            line=place.line,
            column=place.column,
            message=without_paths(place.sentence),
            remedy=without_paths(one.remedy),
        )


def _point_preview(entry: ProgramEntry, point: dict[str, Any]) -> PointPreview:
    return PointPreview(
        program=entry.program,
        point=point["point"],
        line=point["line"],
        kind=point["kind"],
        user_frame=point["user_frame"],
        tool=point["tool"],
        verdict=verdict_of(point["reason"]),  # type: ignore[arg-type]  # one of the words of Verdict
        reason=without_paths(point["reason"]),
        changed=point["status"] == CHANGED,
        shift_m=_to_si(point["shift_mm"], _PER_MM),
        turn_rad=_to_si(point["turn_deg"], _PER_DEG),
        expected_m=_to_si(point["expected_error_mm"], _PER_MM),
        before_m=_read_triple(point, "before"),
        after_m=_read_triple(point, "after"),
        configuration_before=point["configuration_before"],
        configuration_after=point["configuration_after"],
    )


def _build_picture(report: ProgramsReport, language: ReportLanguage) -> PointsPicture:
    if not report.point_count:
        return PointsPicture(in_base=True, points=[], colours=[], edges_m=[], not_drawn=0)
    picture = points_to_draw(report, language)
    shift = report.column_values("shift_m")[picture.rows]
    scale = ColourScale.for_colouring(Colouring("", shift, CIVIDIS))
    drawn = zip(
        picture.drawn.place_m.tolist(),
        shift.tolist(),
        picture.drawn.is_excluded,
        picture.drawn.labels,
        strict=True,
    )
    marks = [
        PicturePoint(
            place_m=(place[0], place[1], place[2]),
            step=scale.step_of(figure),
            left=bool(excluded),
            label=label,
        )
        for place, figure, excluded, label in drawn
    ]
    return PointsPicture(
        in_base=picture.in_base,
        points=marks,
        colours=list(itertools.islice(scale.colours, scale.step_count)),
        edges_m=[edge * _PER_MM for edge in scale.edges_mm],
        not_drawn=report.point_count - len(marks),
    )


def _read_triple(point: dict[str, Any], when: str) -> Triple | None:
    x, y, z = (point[f"{axis}_{when}_mm"] for axis in "xyz")
    return None if x is None or y is None or z is None else (x * _PER_MM, y * _PER_MM, z * _PER_MM)


def _to_si(figure: float | None, factor: float) -> float | None:
    return None if figure is None else figure * factor


def _finite_or_none(figure: float) -> float | None:
    return figure if np.isfinite(figure) else None


def _relative_name(file: str) -> str:
    """Return a source's name below the folder that all came in."""
    parts: Iterable[str] = PurePath(file).parts
    return "/".join(itertools.islice(parts, 1, None)) or file
