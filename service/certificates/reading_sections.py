"""Sections of a certificate about its readings: each one, and those that were not used."""

from collections.abc import Mapping, Sequence
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.service.certificates.blocks import ParagraphBlock, Section, TableBlock, TableCell, table_head
from cellcal.service.certificates.certificate_texts import describe_place, format_time, is_pose
from cellcal.service.quantities import format_quantity
from cellcal.service.translation import Translations

MOST_READINGS = 1000  # rows on paper; the JSON file has all


def rejected_sections(points: Sequence[Mapping[str, Any]], translations: Translations) -> tuple[Section, ...]:
    """Return the section of readings that were not used, each with the reason."""
    unused = [point for point in points if not point["used"]]
    used = len(points) - len(unused)
    title = translations.translate("Readings that were not used")
    number = (
        make_message(
            "{point_count} readings, {used} used; each one is in the JSON file.",
            point_count=len(points),
            used=used,
        )
        if len(points) != 1
        else make_message("1 reading, {used} used; it is in the JSON file.", used=used)
    )
    count_text = ParagraphBlock(translations.translate(number))
    if not unused:
        return (Section(title, (count_text, ParagraphBlock(translations.translate("None was set aside.")))),)
    head = table_head(translations, "Reading", "At (UTC)", "Why it was not used")
    rows = tuple(
        (
            TableCell(translations.translate_step(p["step"])),
            TableCell(format_time(p["at_utc"])),
            TableCell(translations.translate(p["reason"])),
        )
        for p in unused
    )
    table = TableBlock(
        head, rows, (26, 22, 52), translations.translate("Nothing is removed: these stay in the JSON file.")
    )
    return (Section(title, (count_text, table)),)


def reading_sections(points: Sequence[Mapping[str, Any]], translations: Translations) -> tuple[Section, ...]:
    """Return the table of the readings, the first `MOST_READINGS` of them; empty without readings."""
    if not points:
        return ()
    rows = tuple(
        (
            TableCell(str(number), number=True),
            TableCell(translations.translate_step(point["step"])),
            TableCell(format_time(point["at_utc"])),
            TableCell(_describe_reading(point, translations)),
            TableCell(translations.translate("yes" if point["used"] else "no")),
        )
        for number, point in enumerate(points[:MOST_READINGS], 1)
    )
    head = table_head(translations, "No.#", "Reading", "At (UTC)", "Read", "Used")
    omitted = len(points) - len(rows)
    caption = (
        make_message(
            "The first {row_count} readings; {omitted} more are in the JSON file.",
            row_count=len(rows),
            omitted=omitted,
        )
        if omitted
        else "Every reading."
    )
    return (
        Section(
            translations.translate("Readings"),
            (TableBlock(head, rows, (7, 26, 20, 38, 9), translations.translate(caption)),),
        ),
    )


def _describe_reading(point: Mapping[str, Any], translations: Translations) -> str:
    """Return a reading in a line: a length, a place, a pose; whatever else is named and stands in the file."""
    value = point.get("value")
    if "value_sha256" in point:
        return translations.translate(
            make_message("in the journal, SHA-256 {point}…", point=point["value_sha256"][:16])
        )
    if not isinstance(value, dict):
        return translations.translate("in the JSON file" if point["used"] else "nothing")
    lengths = value.get("readings_m")
    if isinstance(lengths, list) and lengths:
        mean = sum(lengths) / len(lengths)
        shown = format_quantity(mean, "m")
        return (
            translations.translate(
                make_message("{shown}, mean of {length_count}", shown=shown, length_count=len(lengths))
            )
            if len(lengths) > 1
            else translations.format_number(shown)
        )
    if is_pose(value.get("base_flange")):
        return translations.translate(
            make_message(
                "flange at {place}", place=describe_place(value["base_flange"]["position_m"], translations)
            )
        )
    place = value.get("position_m")
    if isinstance(place, list) and len(place) == 3:
        return describe_place(place, translations)
    return translations.translate("in the JSON file")
