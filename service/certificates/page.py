"""A certificate as sections for paper and screen: made from the signed content and from nothing else."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from cellcal.service.certificates.blocks import (
    Block,
    Bullets,
    Cell,
    Facts,
    Fields,
    Page,
    Paragraph,
    Section,
    Table,
)
from cellcal.service.certificates.pictures import pictures_of
from cellcal.service.certificates.qr import code_of
from cellcal.service.certificates.sign_offs import unsigned
from cellcal.service.certificates.words import (
    ENGLISH,
    NO_TEMPERATURE,
    WHOLE_RESULT,
    WORDS,
    accepted_by,
    answers_by_person,
    at_time,
    change_rows,
    controller_rows,
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
from cellcal.service.quantities import quantity
from cellcal.service.translation import Sayings

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


def page_of(content: Mapping[str, Any], sha256: str, public_key: str, words: Sayings = ENGLISH) -> Page:
    """Return the page of a certificate or of a refusal record.

    Parameters
    ----------
    content : mapping
        What was signed: ``content`` of the JSON document.
    sha256, public_key : str
        Hash of the content and the key that signed it, in hexadecimal.
    words : Sayings
        The reader's language. Names and what people typed stay as they are, numbers as in the signed file.
    """
    run, verdict, refused = content["run"], content["verdict"], "refusal" in content
    figures, points, say = verdict["characteristics"], content["points"], words.say
    sections = (
        Section(say("What was examined"), (Facts(tuple(head_rows(content, words))),)),
        *_controller(content, words),
        *_refusal(content, words),
        *_figures(figures, words),
        *_listed(say("Not verified"), [*verdict.get("not_verified", []), *_unknown_air(content)], words),
        *_budget(figures, words),
        *_changes(verdict.get("changes", []), words),
        *_result(say("Evidence" if refused else "Result"), content["result"], words),
        *_listed(say("Remarks"), verdict.get("remarks", []), words),
        *_drawings(content, words),
        *_rejected(points, words),
        *_environment(content["environment"], words),
        Section(say("Traceability"), (Paragraph(say(content["traceability"])),)),
        *_sign_off(content.get("sign_off", []), words),
        *_photos(content.get("pictures", []), words),
        *_people(content["people"], unsigned(content), words),
        Section(say("Safety"), (Paragraph(say(content["safety"]), "strong"),)),
        *_settings(content["settings"], words),
        *_readings(points, words),
        _made_with(content, sha256, public_key, words),
    )
    heading = say("Refusal record" if refused else "Calibration report")
    return Page(
        locale=words.locale,
        heading=heading,
        title=say(run["title"]),
        status=say(content["status"]),
        short_status=say("not accredited"),
        word=verdict["word"],
        verdict=say(WORDS[verdict["word"]]),
        rule=_rule(verdict, words),
        run_id=run["run_id"],
        sha256=sha256,
        footer=(f"{heading}, {say('run')} {run['run_id']}", f"{say('content SHA-256')} {sha256}"),
        ended_utc=run["ended_utc"],
        qr=code_of(file_stem(content), sha256),
        sections=sections,
    )


def _controller(content: Mapping[str, Any], words: Sayings) -> tuple[Section, ...]:
    rows = tuple(controller_rows(content, words))
    return (Section(words.say("The controller when the run began"), (Facts(rows),)),) if rows else ()


def _rule(verdict: Mapping[str, Any], words: Sayings) -> str:
    """Return the verdict's rule in words, and whose limits they are."""
    parts = [_RULES[verdict["word"]]]
    if verdict.get("limits_from"):
        parts.append(f"Judged by {verdict['limits_from']}.")
    if any(figure["rule"].startswith("PASS if U ") for figure in verdict["characteristics"]):
        parts.append(_KNOWN_WITHIN)
    if any("x + g <= L" in figure["rule"] for figure in verdict["characteristics"]):
        parts.append(_ISO_14253)
    return words.join(map(words.say, parts))


def _refusal(content: Mapping[str, Any], words: Sayings) -> tuple[Section, ...]:
    refusal = content.get("refusal")
    if not refusal:
        return ()
    told = (("Why it was refused", "reason"), ("What to do next", "remedy"))
    return tuple(
        Section(words.say(title), (Paragraph(words.say(refusal[key])),))
        for title, key in told
        if refusal[key]
    )


def _figures(characteristics: Sequence[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    if not characteristics:
        return ()
    rows = []
    for figure in characteristics:
        told = figure_in_words(figure, words)
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
        Cell(words.say("Figure"), words.say("and the rule that judged it")),
        Cell(words.say("Found"), number=True),
        Cell("U", number=True),
        Cell(words.say("Limit"), number=True),
        Cell(words.say("Decision")),
    )
    caption = "Figures with expanded uncertainty U = k u, about 95 % coverage. Stated: nothing judges it."
    return (
        Section(
            words.say("What was decided"),
            (Table(head, tuple(rows), (48, 14, 13, 13, 12), words.say(caption)),),
        ),
    )


def _budget(characteristics: Sequence[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(told.name), Cell(name), Cell(u, number=True), Cell(source))
        for told in (figure_in_words(figure, words) for figure in characteristics)
        for name, u, source in told.budget
    )
    if not rows:
        return ()
    head = _head(words, "Figure", "Contribution", "u#", "Known from")
    caption = "Standard uncertainties (k = 1) that make up U."
    return (
        Section(words.say("Uncertainty budget"), (Table(head, rows, (32, 34, 14, 20), words.say(caption)),)),
    )


def _changes(changes: Iterable[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(name), Cell(before, number=True), Cell(after, number=True))
        for name, before, after in change_rows(changes, words)
    )
    if not rows:
        return ()
    head = _head(words, "Figure", "Before#", "After#")
    return (
        Section(
            words.say("Before and after"),
            (Table(head, rows, (50, 25, 25), words.say("What this run changed.")),),
        ),
    )


def _result(title: str, result: Any, words: Sayings) -> tuple[Section, ...]:
    if result is None:
        return ()
    facts = tuple(short_facts(result, words))
    shown: tuple[Block, ...] = (Facts(facts),) if facts else ()
    return (Section(title, (*shown, Paragraph(words.say(WHOLE_RESULT), "quiet"))),)


def _drawings(content: Mapping[str, Any], words: Sayings) -> tuple[Section, ...]:
    drawn = pictures_of(content, words)
    return (Section(words.say("Drawings"), tuple(drawn)),) if drawn else ()


def _rejected(points: Sequence[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    unused = [point for point in points if not point["used"]]
    used = len(points) - len(unused)
    title = words.say("Readings that were not used")
    number = (
        f"{len(points)} readings, {used} used; each one is in the JSON file."
        if len(points) != 1
        else f"1 reading, {used} used; it is in the JSON file."
    )
    said = Paragraph(words.say(number))
    if not unused:
        return (Section(title, (said, Paragraph(words.say("None was set aside.")))),)
    head = _head(words, "Reading", "At (UTC)", "Why it was not used")
    rows = tuple(
        (Cell(words.step(p["step"])), Cell(at_time(p["at_utc"])), Cell(words.say(p["reason"])))
        for p in unused
    )
    table = Table(head, rows, (26, 22, 52), words.say("Nothing is removed: these stay in the JSON file."))
    return (Section(title, (said, table)),)


def _environment(airs: Sequence[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    if not airs:
        return (Section(words.say("Environment"), (Paragraph(words.say(NO_TEMPERATURE)),)),)
    head = _head(words, "Temperature#", "Pressure#", "Relative humidity#")
    rows = tuple(
        (
            Cell(f"{air['temperature_c']:.1f} °C", number=True),
            Cell(f"{air['pressure_pa'] / 100.0:.1f} hPa", number=True),
            Cell(f"{air['humidity_percent']:.0f} %", number=True),
        )
        for air in airs
    )
    caption = "The air as instruments reported it with their readings, each different state once."
    return (Section(words.say("Environment"), (Table(head, rows, (34, 33, 33), words.say(caption)),)),)


def _unknown_air(content: Mapping[str, Any]) -> list[str]:
    return [] if content["environment"] else [NO_TEMPERATURE]


def _sign_off(given: Sequence[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(what, shown), Cell(who), Cell(role), Cell(at))
        for what, who, role, at, shown in sign_off_rows(given, words)
    )
    if not rows:
        return ()
    head = _head(words, "What", "By", "In the role of", "At (UTC)")
    caption = "As the journal has it: names as entered, roles as they were at that moment."
    return (
        Section(
            words.say("Accepted, approved and signed"),
            (Table(head, rows, (46, 20, 16, 18), words.say(caption)),),
        ),
    )


def _photos(pictures: Sequence[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    rows = tuple(
        (Cell(what, f"SHA-256 {sha256}"), Cell(who), Cell(at))
        for what, who, at, sha256 in picture_rows(pictures)
    )
    if not rows:
        return ()
    head = _head(words, "Photo", "By", "At (UTC)")
    caption = "Kept beside the journal of the cell; whoever has a photo compares its SHA-256."
    return (Section(words.say("Photos"), (Table(head, rows, (62, 20, 18), words.say(caption)),)),)


def _people(
    people: Sequence[Mapping[str, str]], to_sign: Iterable[str], words: Sayings
) -> tuple[Section, ...]:
    rows = tuple(
        (
            Cell(who),
            Cell(str(len(own)), number=True),
            Cell(at_time(own[0]["at_utc"])),
            Cell(at_time(own[-1]["at_utc"])),
            Cell(accepted_by(own, words)),
        )
        for who, own in answers_by_person(people)
    )
    head = _head(words, "Person", "Answers#", "From (UTC)", "To (UTC)", "Accepted")
    caption = "Who answered the questions of this run."
    told: tuple[Block, ...] = (Table(head, rows, (22, 10, 20, 20, 28), words.say(caption)),) if rows else ()
    lines = [*to_sign, "The measurement was carried out as described here.", "This report was reviewed."]
    places = words.say("Name"), words.say("Date"), words.say("Signature")
    fields = (Fields(words.say(line), places) for line in lines)
    return (Section(words.say("People and signatures"), (*told, *fields)),)


def _settings(settings: Any, words: Sayings) -> tuple[Section, ...]:
    facts = tuple(short_facts(settings, words))
    return (Section(words.say("Settings"), (Facts(facts),)),) if facts else ()


def _readings(points: Sequence[Mapping[str, Any]], words: Sayings) -> tuple[Section, ...]:
    if not points:
        return ()
    rows = tuple(
        (
            Cell(str(number), number=True),
            Cell(words.step(point["step"])),
            Cell(at_time(point["at_utc"])),
            Cell(_what_was_read(point, words)),
            Cell(words.say("yes" if point["used"] else "no")),
        )
        for number, point in enumerate(points[:MOST_READINGS], 1)
    )
    head = _head(words, "No.#", "Reading", "At (UTC)", "Read", "Used")
    left = len(points) - len(rows)
    caption = (
        f"The first {len(rows)} readings; {left} more are in the JSON file." if left else "Every reading."
    )
    return (Section(words.say("Readings"), (Table(head, rows, (7, 26, 20, 38, 9), words.say(caption)),)),)


def _what_was_read(point: Mapping[str, Any], words: Sayings) -> str:
    """Return a reading in a line: a length, a place, a pose; whatever else is named and stands in the file."""
    value = point.get("value")
    if "value_sha256" in point:
        return words.say(f"in the journal, SHA-256 {point['value_sha256'][:16]}…")
    if not isinstance(value, dict):
        return words.say("in the JSON file" if point["used"] else "nothing")
    lengths = value.get("readings_m")
    if isinstance(lengths, list) and lengths:
        mean = sum(lengths) / len(lengths)
        shown = quantity(mean, "m")
        return words.say(f"{shown}, mean of {len(lengths)}") if len(lengths) > 1 else shown
    if is_pose(value.get("base_flange")):
        return words.say(f"flange at {place_in_words(value['base_flange']['position_m'])}")
    place = value.get("position_m")
    if isinstance(place, list) and len(place) == 3:
        return place_in_words(place)
    return words.say("in the JSON file")


def _made_with(content: Mapping[str, Any], sha256: str, public_key: str, words: Sayings) -> Section:
    run = content["run"]
    rows = [
        row for made in made_with_rows(run, words) for row in (("software", made[0]), ("definition", made[1]))
    ]
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
    named = tuple((words.say(name), value) for name, value in rows)
    return Section(words.say("Made with, and signature"), (Facts(named), Paragraph(words.say(said))))


def _head(words: Sayings, *names: str) -> tuple[Cell, ...]:
    """Return a table's head; "#" behind a name means a column of numbers."""
    return tuple(Cell(words.say(name.removesuffix("#")), number=name.endswith("#")) for name in names)


def _listed(title: str, lines: Iterable[str], words: Sayings) -> tuple[Section, ...]:
    told = tuple(map(words.say, lines))
    return (Section(title, (Bullets(told),)),) if told else ()
