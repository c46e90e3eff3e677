"""A certificate as sections for paper and screen: made from the signed content and from nothing else."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from service.certificates.blocks import Block, Bullets, Cell, Facts, Fields, Page, Paragraph, Section, Table
from service.certificates.pictures import pictures_of
from service.certificates.qr import code_of
from service.certificates.sign_offs import unsigned
from service.certificates.words import (
    NO_TEMPERATURE,
    WHOLE_RESULT,
    WORDS,
    accepted_by,
    answers_by_person,
    at_time,
    change_rows,
    figure_in_words,
    file_stem,
    head_rows,
    is_pose,
    made_with_rows,
    picture_rows,
    place_in_words,
    short_facts,
    sign_off_rows,
)
from service.quantities import quantity

MOST_READINGS = 1000  # rows on paper; the JSON file has all
_RULES = {
    "pass": "Every figure that was judged keeps its limit and every check held. Where a measured value was compared "
    "with a limit, its uncertainty counted against it.",
    "fail": "At least one figure is beyond its limit, or a check did not hold. Where a measured value was compared "
    "with a limit, its uncertainty counted in its favour.",
    "undecided": "It is proved neither that every figure keeps its limit nor that one does not: measure more.",
    "refused": "The procedure refused to give a result. Nothing is claimed of this run.",
}
_ISO_14253 = (
    "Rule for measured figures, after ISO 14253-1: PASS if x + g <= L, FAIL if x - g > L, else UNDECIDED; x is the "
    "magnitude found, L the limit, g the guard band that stands with each figure."
)
_KNOWN_WITHIN = "Rule for what must be known well enough: PASS if U <= L, else UNDECIDED."


def page_of(content: Mapping[str, Any], sha256: str, public_key: str) -> Page:
    """Return the page of a certificate or of a refusal record.

    Parameters
    ----------
    content : mapping
        What was signed: ``content`` of the JSON document.
    sha256, public_key : str
        Hash of the content and the key that signed it, in hexadecimal.
    """
    run, verdict, refused = content["run"], content["verdict"], "refusal" in content
    stem = file_stem(content)
    sections = (
        Section("What was examined", (Facts(tuple(head_rows(content))),)),
        *_refusal(content),
        *_figures(verdict["characteristics"]),
        *_listed("Not verified", [*verdict.get("not_verified", []), *_unknown_air(content)]),
        *_budget(verdict["characteristics"]),
        *_changes(verdict.get("changes", [])),
        *_result("Evidence" if refused else "Result", content["result"]),
        *_listed("Remarks", verdict.get("remarks", [])),
        *_drawings(content),
        *_rejected(content["points"]),
        *_environment(content["environment"]),
        Section("Traceability", (Paragraph(content["traceability"]),)),
        *_sign_off(content.get("sign_off", [])),
        *_photos(content.get("pictures", [])),
        *_people(content["people"], unsigned(content)),
        Section("Safety", (Paragraph(content["safety"], "strong"),)),
        *_settings(content["settings"]),
        *_readings(content["points"]),
        _made_with(content, sha256, public_key),
    )
    return Page(
        heading="Refusal record" if refused else "Calibration report",
        title=run["title"],
        status=content["status"],
        word=verdict["word"],
        verdict=WORDS[verdict["word"]],
        rule=_rule(verdict),
        run_id=run["run_id"],
        sha256=sha256,
        ended_utc=run["ended_utc"],
        qr=code_of(stem, sha256),
        sections=sections,
    )


def _rule(verdict: Mapping[str, Any]) -> str:
    """Return the verdict's rule in words, and whose limits they are."""
    parts = [_RULES[verdict["word"]]]
    if verdict.get("limits_from"):
        parts.append(f"Judged by {verdict['limits_from']}.")
    if any(figure["rule"].startswith("PASS if U ") for figure in verdict["characteristics"]):
        parts.append(_KNOWN_WITHIN)
    if any("x + g <= L" in figure["rule"] for figure in verdict["characteristics"]):
        parts.append(_ISO_14253)
    return " ".join(parts)


def _refusal(content: Mapping[str, Any]) -> tuple[Section, ...]:
    refusal = content.get("refusal")
    if not refusal:
        return ()
    told = (("Why it was refused", "reason"), ("What to do next", "remedy"))
    return tuple(Section(title, (Paragraph(refusal[key]),)) for title, key in told if refusal[key])


def _figures(characteristics: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
    if not characteristics:
        return ()
    rows = []
    for figure in characteristics:
        told = figure_in_words(figure)
        rows.append(
            (
                Cell(told.name, told.rule),
                Cell(told.found, number=True),
                Cell(told.expanded, told.coverage, number=True),
                Cell(told.limit, number=True),
                Cell(told.word, word=figure["decision"] or ""),
            )
        )
    head = (
        Cell("Figure", "and the rule that judged it"),
        Cell("Found", number=True),
        Cell("U", number=True),
        Cell("Limit", number=True),
        Cell("Decision"),
    )
    caption = "Figures with expanded uncertainty U = k u, about 95 % coverage. Stated: nothing judges it."
    return (Section("What was decided", (Table(head, tuple(rows), (48, 14, 13, 13, 12), caption),)),)


def _budget(characteristics: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(told.name), Cell(name), Cell(u, number=True), Cell(source))
        for told in map(figure_in_words, characteristics)
        for name, u, source in told.budget
    )
    if not rows:
        return ()
    head = (Cell("Figure"), Cell("Contribution"), Cell("u", number=True), Cell("Known from"))
    caption = "Standard uncertainties (k = 1) that make up U."
    return (Section("Uncertainty budget", (Table(head, rows, (32, 34, 14, 20), caption),)),)


def _changes(changes: Iterable[Mapping[str, Any]]) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(name), Cell(before, number=True), Cell(after, number=True))
        for name, before, after in change_rows(changes)
    )
    if not rows:
        return ()
    head = (Cell("Figure"), Cell("Before", number=True), Cell("After", number=True))
    return (Section("Before and after", (Table(head, rows, (50, 25, 25), "What this run changed."),)),)


def _result(title: str, result: Any) -> tuple[Section, ...]:
    if result is None:
        return ()
    facts = tuple(short_facts(result))
    shown: tuple[Block, ...] = (Facts(facts),) if facts else ()
    return (Section(title, (*shown, Paragraph(WHOLE_RESULT, "quiet"))),)


def _drawings(content: Mapping[str, Any]) -> tuple[Section, ...]:
    drawn = pictures_of(content)
    return (Section("Drawings", tuple(drawn)),) if drawn else ()


def _rejected(points: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
    unused = [point for point in points if not point["used"]]
    used = len(points) - len(unused)
    number = f"{len(points)} readings" if len(points) != 1 else "1 reading"
    said = Paragraph(f"{number}, {used} used; each one is in the JSON file.")
    if not unused:
        return (Section("Readings that were not used", (said, Paragraph("None was set aside."))),)
    head = (Cell("Reading"), Cell("At (UTC)"), Cell("Why it was not used"))
    rows = tuple((Cell(p["step"]), Cell(at_time(p["at_utc"])), Cell(p["reason"])) for p in unused)
    table = Table(head, rows, (26, 22, 52), "Nothing is removed: these stay in the JSON file.")
    return (Section("Readings that were not used", (said, table)),)


def _environment(airs: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
    if not airs:
        return (Section("Environment", (Paragraph(NO_TEMPERATURE),)),)
    head = (
        Cell("Temperature", number=True),
        Cell("Pressure", number=True),
        Cell("Relative humidity", number=True),
    )
    rows = tuple(
        (
            Cell(f"{air['temperature_c']:.1f} °C", number=True),
            Cell(f"{air['pressure_pa'] / 100.0:.1f} hPa", number=True),
            Cell(f"{air['humidity_percent']:.0f} %", number=True),
        )
        for air in airs
    )
    caption = "The air as instruments reported it with their readings, each different state once."
    return (Section("Environment", (Table(head, rows, (34, 33, 33), caption),)),)


def _unknown_air(content: Mapping[str, Any]) -> list[str]:
    return [] if content["environment"] else [NO_TEMPERATURE]


def _sign_off(given: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(what, shown), Cell(who), Cell(role), Cell(at))
        for what, who, role, at, shown in sign_off_rows(given)
    )
    if not rows:
        return ()
    head = (Cell("What"), Cell("By"), Cell("In the role of"), Cell("At (UTC)"))
    caption = "As the journal has it: names as entered, roles as they were at that moment."
    return (Section("Accepted, approved and signed", (Table(head, rows, (46, 20, 16, 18), caption),)),)


def _photos(pictures: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(what, f"SHA-256 {sha256}"), Cell(who), Cell(at))
        for what, who, at, sha256 in picture_rows(pictures)
    )
    if not rows:
        return ()
    head = (Cell("Photo"), Cell("By"), Cell("At (UTC)"))
    caption = "Kept beside the journal of the cell; whoever has a photo compares its SHA-256."
    return (Section("Photos", (Table(head, rows, (62, 20, 18), caption),)),)


def _people(people: Sequence[Mapping[str, str]], to_sign: Iterable[str]) -> tuple[Section, ...]:
    rows = tuple(
        (
            Cell(who),
            Cell(str(len(own)), number=True),
            Cell(at_time(own[0]["at_utc"])),
            Cell(at_time(own[-1]["at_utc"])),
            Cell(accepted_by(own)),
        )
        for who, own in answers_by_person(people)
    )
    head = (
        Cell("Person"),
        Cell("Answers", number=True),
        Cell("From (UTC)"),
        Cell("To (UTC)"),
        Cell("Accepted"),
    )
    caption = "Who answered the questions of this run."
    told: tuple[Block, ...] = (Table(head, rows, (22, 10, 20, 20, 28), caption),) if rows else ()
    fields = [*to_sign, "The measurement was carried out as described here.", "This report was reviewed."]
    return (Section("People and signatures", (*told, *map(Fields, fields))),)


def _settings(settings: Any) -> tuple[Section, ...]:
    facts = tuple(short_facts(settings))
    return (Section("Settings", (Facts(facts),)),) if facts else ()


def _readings(points: Sequence[Mapping[str, Any]]) -> tuple[Section, ...]:
    if not points:
        return ()
    rows = tuple(
        (
            Cell(str(number), number=True),
            Cell(point["step"]),
            Cell(at_time(point["at_utc"])),
            Cell(_what_was_read(point)),
            Cell("yes" if point["used"] else "no"),
        )
        for number, point in enumerate(points[:MOST_READINGS], 1)
    )
    head = (Cell("No.", number=True), Cell("Reading"), Cell("At (UTC)"), Cell("Read"), Cell("Used"))
    left = len(points) - len(rows)
    caption = (
        f"The first {len(rows)} readings; {left} more are in the JSON file." if left else "Every reading."
    )
    return (Section("Readings", (Table(head, rows, (7, 26, 20, 38, 9), caption),)),)


def _what_was_read(point: Mapping[str, Any]) -> str:
    """Return a reading in a line: a length, a place, a pose; whatever else is named and stands in the file."""
    value = point.get("value")
    if "value_sha256" in point:
        return f"in the journal, SHA-256 {point['value_sha256'][:16]}…"
    if not isinstance(value, dict):
        return "in the JSON file" if point["used"] else "nothing"
    lengths = value.get("readings_m")
    if isinstance(lengths, list) and lengths:
        mean = sum(lengths) / len(lengths)
        return f"{quantity(mean, 'm')}, mean of {len(lengths)}" if len(lengths) > 1 else quantity(mean, "m")
    if is_pose(value.get("base_flange")):
        return f"flange at {place_in_words(value['base_flange']['position_m'])}"
    place = value.get("position_m")
    return place_in_words(place) if isinstance(place, list) and len(place) == 3 else "in the JSON file"


def _made_with(content: Mapping[str, Any], sha256: str, public_key: str) -> Section:
    run = content["run"]
    rows = [row for made in made_with_rows(run) for row in (("software", made[0]), ("definition", made[1]))]
    rows += [
        ("cell file SHA-256", content["cell"]["config_sha256"]),
        ("raw data SHA-256", content["raw_data_sha256"]),
        ("journal head", run["journal_head_sha256"]),
        ("content SHA-256", sha256),
        ("public key", public_key),
    ]
    said = (
        f"This page is a rendering. What is signed is {file_stem(content)}.json; check it with `cellcal verify FILE "
        "--key PUBKEY`. A check tells that it is unchanged and which key signed it, not whose key that is."
    )
    return Section("Made with, and signature", (Facts(tuple(rows)), Paragraph(said)))


def _listed(title: str, lines: Iterable[str]) -> tuple[Section, ...]:
    told = tuple(lines)
    return (Section(title, (Bullets(told),)),) if told else ()
