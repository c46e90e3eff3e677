"""What a page shows of programs that were made, as files of a job: a summary, pages of points, the archive."""

import itertools
import os
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from pydantic_core import to_json

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.engineering.programs.jobs.files import ALL, ARCHIVE, OUT, PREVIEW
from cellcal.service.engineering.programs.jobs.shapes import (
    Mark,
    PointMade,
    PointsMade,
    PointsPicture,
    Preview,
    ProgramMade,
    RefusedFile,
    Triple,
)
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.report import ProgramEntry, Report, largest
from cellcal.service.engineering.programs.report_html import points_to_draw
from cellcal.service.engineering.programs.report_picture import CIVIDIS, Colouring, Scale
from cellcal.service.engineering.programs.report_texts import Language
from cellcal.service.engineering.programs.report_words import heading, points_off, problems
from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED
from cellcal.service.engineering.programs.verdicts import counted, place_in, verdict_of
from cellcal.service.shown_paths import without_paths

PAGE = 100
_REPORTS = ("report.html", "report.csv", "report.json")
_PER_MM, _PER_DEG = 1e-3, float(np.pi / 180.0)


@dataclass(frozen=True, eq=False)
class Made:
    """What a job came to."""

    report: Report
    cell: Project
    target: Project
    notes: Sequence[str]
    asked: dict[str, Any]
    language: Language


def write_preview(made: Made, folder: Path) -> None:
    """Write everything that a page may ask for."""
    told = parse_json(read_plain_text(folder / "report.json"))
    verdicts = counted(point["reason"] for program in told["programs"] for point in program["points"])
    order = made.report.programs_worst_first()
    by_file = {program["source"]: program for program in told["programs"]}
    points = {e.file: [_point(e, each) for each in by_file[e.file]["points"]] for e in made.report.entries}
    every = [point for entry in made.report.entries for point in points[entry.file]]
    write_pages([every[row] for row in made.report.order().tolist()], folder, ALL)
    for number, entry in enumerate(order):
        write_pages(points[entry.file], folder, str(number))
    (folder / PREVIEW).write_bytes(to_json(_preview(made, order, verdicts)))
    write_archive(folder, made.asked["archive"])


def write_pages(points: Sequence[PointMade], folder: Path, name: str) -> None:
    """Write points in pages of one size; there is always a first."""
    pages = max(1, -(-len(points) // PAGE))
    for page in range(1, pages + 1):
        some = list(points[(page - 1) * PAGE : page * PAGE])
        told = PointsMade(total=len(points), pages=pages, points=some)
        (folder / f"points-{name}-{page}.json").write_bytes(to_json(told))


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


def _preview(made: Made, order: Sequence[ProgramEntry], verdicts: dict[str, int]) -> Preview:
    report, target = made.report, made.target
    arm = target.identified
    notes = [
        *points_off(report, made.language),
        *map(made.language.say, made.notes),
        *map(without_paths, problems(report, made.language)),
    ]
    return Preview(
        title=without_paths(heading(report, made.language)),
        cell=target.name,
        parameters="" if arm is None else f"{target.serial}, {arm.version}, {arm.sha256[:8]}",
        counts={status: report.counts[status] for status in (CHANGED, UNCHANGED, LEFT)},
        verdicts=verdicts,  # type: ignore[arg-type]  # its keys are the verdicts: a test counts them
        collisions_checked=target.shapes is not None,
        largest_shift_m=_known(largest(report.column("shift_m"))),
        largest_expected_m=_known(largest(report.column("expected_m"))),
        largest_uncorrected_m=_known(largest(report.column("uncorrected_m"))),
        programs=[_program(entry) for entry in order],
        refused=[*(RefusedFile(**one) for one in made.asked["refused"]), *_refused(report)],
        notes=notes,
        page_size=PAGE,
        picture=_picture(report, made.language),
    )


def _program(entry: ProgramEntry) -> ProgramMade:
    return ProgramMade(
        program=entry.program,
        file=_name(entry.file),
        brand=entry.brand,
        points=len(entry.points),
        changed=entry.counts[CHANGED],
        unchanged=entry.counts[UNCHANGED],
        left=entry.counts[LEFT],
        largest_shift_m=_known(largest(entry.shift_m)),
        largest_expected_m=_known(largest(entry.expected_m)),
    )


def _refused(report: Report) -> Iterator[RefusedFile]:
    for one in report.refused:
        place = place_in(one.message)
        yield RefusedFile(
            file=_name(one.file),
            line=place.line,
            column=place.column,
            message=without_paths(place.sentence),
            remedy=without_paths(one.remedy),
        )


def _point(entry: ProgramEntry, told: dict[str, Any]) -> PointMade:
    return PointMade(
        program=entry.program,
        point=told["point"],
        line=told["line"],
        kind=told["kind"],
        user_frame=told["user_frame"],
        tool=told["tool"],
        verdict=verdict_of(told["reason"]),  # type: ignore[arg-type]  # one of the words of Verdict
        reason=without_paths(told["reason"]),
        changed=told["status"] == CHANGED,
        shift_m=_si(told["shift_mm"], _PER_MM),
        turn_rad=_si(told["turn_deg"], _PER_DEG),
        expected_m=_si(told["expected_error_mm"], _PER_MM),
        before_m=_triple(told, "before"),
        after_m=_triple(told, "after"),
        configuration_before=told["configuration_before"],
        configuration_after=told["configuration_after"],
    )


def _picture(report: Report, language: Language) -> PointsPicture:
    if not report.points:
        return PointsPicture(in_base=True, points=[], colours=[], edges_m=[], not_drawn=0)
    seen = points_to_draw(report, language)
    shift = report.column("shift_m")[seen.rows]
    scale = Scale.of(Colouring("", shift, CIVIDIS))
    drawn = zip(seen.drawn.place_m.tolist(), shift.tolist(), seen.drawn.left, seen.drawn.labels, strict=True)
    marks = [
        Mark(place_m=(place[0], place[1], place[2]), step=scale.step(figure), left=bool(left), label=label)
        for place, figure, left, label in drawn
    ]
    return PointsPicture(
        in_base=seen.in_base,
        points=marks,
        colours=list(itertools.islice(scale.colours, scale.steps)),
        edges_m=[edge * _PER_MM for edge in scale.edges],
        not_drawn=report.points - len(marks),
    )


def _triple(told: dict[str, Any], when: str) -> Triple | None:
    x, y, z = (told[f"{axis}_{when}_mm"] for axis in "xyz")
    return None if x is None or y is None or z is None else (x * _PER_MM, y * _PER_MM, z * _PER_MM)


def _si(figure: float | None, factor: float) -> float | None:
    return None if figure is None else figure * factor


def _known(figure: float) -> float | None:
    return figure if np.isfinite(figure) else None


def _name(file: str) -> str:
    """Return a source's name below the folder that all came in."""
    parts: Iterable[str] = PurePath(file).parts
    return "/".join(itertools.islice(parts, 1, None)) or file
