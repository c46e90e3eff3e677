"""A certificate as sections for paper and screen: made from the signed content and from nothing else."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.service.certificates.blocks import (
    Block,
    BulletBlock,
    CertificatePage,
    FactBlock,
    ParagraphBlock,
    Section,
    SignatureFields,
    TableBlock,
    TableCell,
    table_head,
)
from cellcal.service.certificates.certificate_texts import (
    ENGLISH,
    NO_TEMPERATURE,
    WHOLE_RESULT,
    WORDS,
    answers_by_person,
    change_rows,
    controller_rows,
    describe_figure,
    file_stem,
    format_time,
    head_rows,
    join_accepted,
    made_with_rows,
    picture_rows,
    short_facts,
    sign_off_rows,
)
from cellcal.service.certificates.pictures import pictures_of
from cellcal.service.certificates.qr import code_of
from cellcal.service.certificates.reading_sections import reading_sections, rejected_sections
from cellcal.service.certificates.setting_rows import setting_rows
from cellcal.service.certificates.sign_offs import list_unsigned
from cellcal.service.translation import Translations

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


def page_of(
    content: Mapping[str, Any], sha256: str, public_key: str, translations: Translations = ENGLISH
) -> CertificatePage:
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
    figures, points, say = verdict["characteristics"], content["points"], translations.translate
    sections = (
        Section(say("What was examined"), (FactBlock(tuple(head_rows(content, translations))),)),
        *_controller_sections(content, translations),
        *_refusal_sections(content, translations),
        *_figure_sections(figures, translations),
        *_list_sections(
            say("Not verified"), [*verdict.get("not_verified", []), *_unknown_air(content)], translations
        ),
        *_budget_sections(figures, translations),
        *_change_sections(verdict.get("changes", []), translations),
        *_result_sections(say("Evidence" if refused else "Result"), content["result"], translations),
        *_list_sections(say("Remarks"), verdict.get("remarks", []), translations),
        *_drawing_sections(content, translations),
        *rejected_sections(points, translations),
        *_environment_sections(content["environment"], translations),
        Section(say("Traceability"), (ParagraphBlock(say(content["traceability"])),)),
        *_sign_off(content.get("sign_off", []), translations),
        *_photo_sections(content.get("pictures", []), translations),
        *_people_sections(content["people"], list_unsigned(content), translations),
        Section(say("Safety"), (ParagraphBlock(say(content["safety"]), "strong"),)),
        *_setting_sections(content, translations),
        *reading_sections(points, translations),
        _made_with(content, sha256, public_key, translations),
    )
    heading = say("Refusal record" if refused else "Calibration report")
    return CertificatePage(
        locale=translations.locale,
        heading=heading,
        title=say(run["title"]),
        status=say(content["status"]),
        short_status=say("not accredited"),
        word=verdict["word"],
        verdict=say(WORDS[verdict["word"]]),
        rule=_decision_rule(verdict, translations),
        run_id=run["run_id"],
        sha256=sha256,
        footer=(f"{heading}, {say('run')} {run['run_id']}", f"{say('content SHA-256')} {sha256}"),
        ended_utc=run["ended_utc"],
        qr=code_of(file_stem(content), sha256),
        sections=sections,
    )


def _controller_sections(content: Mapping[str, Any], translations: Translations) -> tuple[Section, ...]:
    rows = tuple(controller_rows(content, translations))
    return (
        (Section(translations.translate("The controller when the run began"), (FactBlock(rows),)),)
        if rows
        else ()
    )


def _decision_rule(verdict: Mapping[str, Any], translations: Translations) -> str:
    """Return the verdict's rule in words, and whose limits they are."""
    parts = [_RULES[verdict["word"]]]
    if verdict.get("limits_from"):
        parts.append(make_message("Judged by {verdict}.", verdict=verdict["limits_from"]))
    if any(figure["rule"].startswith("PASS if U ") for figure in verdict["characteristics"]):
        parts.append(_KNOWN_WITHIN)
    if any("x + g <= L" in figure["rule"] for figure in verdict["characteristics"]):
        parts.append(_ISO_14253)
    return translations.join_sentences(map(translations.translate, parts))


def _refusal_sections(content: Mapping[str, Any], translations: Translations) -> tuple[Section, ...]:
    refusal = content.get("refusal")
    if not refusal:
        return ()
    titled_keys = (("Why it was refused", "reason"), ("What to do next", "remedy"))
    return tuple(
        Section(translations.translate(title), (ParagraphBlock(translations.translate(refusal[key])),))
        for title, key in titled_keys
        if refusal[key]
    )


def _figure_sections(
    characteristics: Sequence[Mapping[str, Any]], translations: Translations
) -> tuple[Section, ...]:
    if not characteristics:
        return ()
    rows = []
    for figure in characteristics:
        texts = describe_figure(figure, translations)
        rows.append(
            (
                TableCell(texts.name, texts.rule),
                TableCell(texts.found, number=True),
                TableCell(texts.expanded, texts.coverage, number=True),
                TableCell(texts.limit, number=True),
                TableCell(texts.word, word=figure["decision"] or ""),
            )
        )
    head = (
        TableCell(translations.translate("Figure"), translations.translate("and the rule that judged it")),
        TableCell(translations.translate("Found"), number=True),
        TableCell("U", number=True),
        TableCell(translations.translate("Limit"), number=True),
        TableCell(translations.translate("Decision")),
    )
    caption = "Figures with expanded uncertainty U = k u, about 95 % coverage. Stated: nothing judges it."
    return (
        Section(
            translations.translate("What was decided"),
            (TableBlock(head, tuple(rows), (48, 14, 13, 13, 12), translations.translate(caption)),),
        ),
    )


def _budget_sections(
    characteristics: Sequence[Mapping[str, Any]], translations: Translations
) -> tuple[Section, ...]:
    rows = tuple(
        (TableCell(texts.name), TableCell(name), TableCell(u, number=True), TableCell(source))
        for texts in (describe_figure(figure, translations) for figure in characteristics)
        for name, u, source in texts.budget
    )
    if not rows:
        return ()
    head = table_head(translations, "Figure", "Contribution", "u#", "Known from")
    caption = "Standard uncertainties (k = 1) that make up U."
    return (
        Section(
            translations.translate("Uncertainty budget"),
            (TableBlock(head, rows, (32, 34, 14, 20), translations.translate(caption)),),
        ),
    )


def _change_sections(changes: Iterable[Mapping[str, Any]], translations: Translations) -> tuple[Section, ...]:
    rows = tuple(
        (TableCell(name), TableCell(before, number=True), TableCell(after, number=True))
        for name, before, after in change_rows(changes, translations)
    )
    if not rows:
        return ()
    head = table_head(translations, "Figure", "Before#", "After#")
    return (
        Section(
            translations.translate("Before and after"),
            (TableBlock(head, rows, (50, 25, 25), translations.translate("What this run changed.")),),
        ),
    )


def _result_sections(title: str, result: Any, translations: Translations) -> tuple[Section, ...]:
    if result is None:
        return ()
    facts = tuple(short_facts(result, translations))
    shown: tuple[Block, ...] = (FactBlock(facts),) if facts else ()
    return (Section(title, (*shown, ParagraphBlock(translations.translate(WHOLE_RESULT), "quiet"))),)


def _drawing_sections(content: Mapping[str, Any], translations: Translations) -> tuple[Section, ...]:
    drawn = pictures_of(content, translations)
    return (Section(translations.translate("Drawings"), tuple(drawn)),) if drawn else ()


def _environment_sections(
    air_readings: Sequence[Mapping[str, Any]], translations: Translations
) -> tuple[Section, ...]:
    if not air_readings:
        return (
            Section(
                translations.translate("Environment"),
                (ParagraphBlock(translations.translate(NO_TEMPERATURE)),),
            ),
        )
    head = table_head(translations, "Temperature#", "Pressure#", "Relative humidity#")
    rows = tuple(
        (
            TableCell(translations.format_number(f"{air['temperature_c']:.1f} °C"), number=True),
            TableCell(translations.format_number(f"{air['pressure_pa'] / 100.0:.1f} hPa"), number=True),
            TableCell(f"{air['humidity_percent']:.0f} %", number=True),
        )
        for air in air_readings
    )
    caption = "The air as instruments reported it with their readings, each different state once."
    return (
        Section(
            translations.translate("Environment"),
            (TableBlock(head, rows, (34, 33, 33), translations.translate(caption)),),
        ),
    )


def _unknown_air(content: Mapping[str, Any]) -> list[str]:
    return [] if content["environment"] else [NO_TEMPERATURE]


def _sign_off(sign_offs: Sequence[Mapping[str, Any]], translations: Translations) -> tuple[Section, ...]:
    rows = tuple(
        (TableCell(what, shown), TableCell(who), TableCell(role), TableCell(at))
        for what, who, role, at, shown in sign_off_rows(sign_offs, translations)
    )
    if not rows:
        return ()
    head = table_head(translations, "What", "By", "In the role of", "At (UTC)")
    caption = "As the journal has it: names as entered, roles as they were at that moment."
    return (
        Section(
            translations.translate("Accepted, approved and signed"),
            (TableBlock(head, rows, (46, 20, 16, 18), translations.translate(caption)),),
        ),
    )


def _photo_sections(pictures: Sequence[Mapping[str, Any]], translations: Translations) -> tuple[Section, ...]:
    rows = tuple(
        (TableCell(what, f"SHA-256 {sha256}"), TableCell(who), TableCell(at))
        for what, who, at, sha256 in picture_rows(pictures)
    )
    if not rows:
        return ()
    head = table_head(translations, "Photo", "By", "At (UTC)")
    caption = "Stored beside the journal of the cell; a photo is compared by its SHA-256."
    return (
        Section(
            translations.translate("Photos"),
            (TableBlock(head, rows, (62, 20, 18), translations.translate(caption)),),
        ),
    )


def _people_sections(
    people: Sequence[Mapping[str, str]], to_sign: Iterable[str], translations: Translations
) -> tuple[Section, ...]:
    rows = tuple(
        (
            TableCell(who),
            TableCell(str(len(own)), number=True),
            TableCell(format_time(own[0]["at_utc"])),
            TableCell(format_time(own[-1]["at_utc"])),
            TableCell(join_accepted(own, translations)),
        )
        for who, own in answers_by_person(people)
    )
    head = table_head(translations, "Person", "Answers#", "From (UTC)", "To (UTC)", "Accepted")
    caption = "Who answered the questions of this run."
    tables: tuple[Block, ...] = (
        (TableBlock(head, rows, (22, 10, 20, 20, 28), translations.translate(caption)),) if rows else ()
    )
    lines = [*to_sign, "The measurement was carried out as described here.", "This report was reviewed."]
    places = (
        translations.translate("Name"),
        translations.translate("Date"),
        translations.translate("Signature"),
    )
    fields = (SignatureFields(translations.translate(line), places) for line in lines)
    return (Section(translations.translate("People and signatures"), (*tables, *fields)),)


def _setting_sections(content: Mapping[str, Any], translations: Translations) -> tuple[Section, ...]:
    facts = tuple(setting_rows(content["run"]["procedure"], content["settings"], translations))
    return (Section(translations.translate("Settings"), (FactBlock(facts),)),) if facts else ()


def _made_with(
    content: Mapping[str, Any], sha256: str, public_key: str, translations: Translations
) -> Section:
    run = content["run"]
    rows = [
        row
        for made in made_with_rows(run, translations)
        for row in (("software", made[0]), ("definition", made[1]))
    ]
    rows += [
        ("cell file SHA-256", content["cell"]["config_sha256"]),
        ("raw data SHA-256", content["raw_data_sha256"]),
        ("journal head", run["journal_head_sha256"]),
        ("content SHA-256", sha256),
        ("public key", public_key),
    ]
    notice = make_message(
        "This page is a rendering. What is signed is {file_stem}.json; check it with `cellcal "
        "verify FILE --key PUBKEY`. A check tells that it is unchanged and which key signed it, "
        "not whose key that is.",
        file_stem=file_stem(content),
    )
    named = tuple((translations.translate(name), value) for name, value in rows)
    return Section(
        translations.translate("Made with, and signature"),
        (FactBlock(named), ParagraphBlock(translations.translate(notice))),
    )


def _list_sections(title: str, lines: Iterable[str], translations: Translations) -> tuple[Section, ...]:
    translated = tuple(map(translations.translate, lines))
    return (Section(title, (BulletBlock(translated),)),) if translated else ()
