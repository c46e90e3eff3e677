"""What refusals, verdicts and devices say has words in every language: a new sentence without them fails here."""

import ast
import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.motion.cell_shapes import PlaneObstacle, SphereObstacle, assumed_shape
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath, check_moves
from cellcal.calibration.motion.position_uncertainty import PositionUncertainty
from cellcal.calibration.points.touch_design import TURNS, ToolTurn
from cellcal.drivers.draw_wire.modbus_registers import load_encoder_map
from cellcal.drivers.errors import DeviceTimeoutError
from cellcal.drivers.wire.tables import code_table
from cellcal.service.translation import Translations
from tests.service.source_sentences import ROOT, SENTENCE, number_holes, read_source
from tests.service.translated_rooms import WHOLE

TRANSLATED = ("de", "es", "zh")
HOLE = re.compile(r"\{\w+\}")
BEGUN = re.compile(r"^(\{\d+\} ?)+(?=[A-Z])")  # other sentences come before this one
FORMER = ROOT / "tests/data/former_refusals.json"  # journals of earlier versions contain these sentences
IN_FILES = ("pendant_programs.py",)  # its sentences stand in program files, in English
PARAMETER_NAMES = {f"J{number} offset" for number in range(1, 10)}  # names, of which results have tables
# The kits side by side, a line each with its figures: shown as it is said, and marked as English.
ENGLISH_ONLY = {
    "The smallest error first:\n{1}\nType a name; nothing is {2}.",
    "What this kit would leave open after a loss:\n{1}\nRecord its places?",
}
# Said to programmers, or the same in every language, or said in pieces that have words.
NOT_FOR_PEOPLE = ENGLISH_ONLY | {
    "touch anew {1}",
    "touch in another attitude {1}",
    '"[^"\\n]*+"',
    "[{1}]",
    "+{1}",
    "{1} mm",
    "{1} needs a return annotation: its result is journalled",
    "U (k = 2)",
    "anew",
    "enough",
    "wrong",
    "operator",
    "{1} {2}",
    "{1} is no fact",
    "%s: the programs of before are not back: %s",  # of a log
    "due",
    "live",
    "length",
    "mirror",
    "position",
    "unit",
    "journal",
    "m",
    "rad",
    "m/s",
    "m/rad",
    "{1}: a start ({2},) and targets (N, {3}) are needed",
    "count",
    "{1} {2} (axes {3})",
    "EMCY-{1}",
    "cellcal {1}, {2}",
    "the last token is the end of a line",
    "register {1} cannot be written here",
    "1",
    "plan the {1} face",  # of x, y and z, each of which has its words
    "Robot Web Services",
    "Joint moves, fastest joint {1} deg/s.",  # stand in a program file, as its warning does
    "Compare the joints before you run it, in T1.",
    'title = "Universal Robots {1}{2}"',  # stand in a model file
    'Its factory calibration is {1}."',
}


@cache
def refusal_texts(locale: str) -> dict[str, str]:
    """Return a language's refusals."""
    found: dict[str, str] = json.loads(
        (ROOT / f"web/src/locales/refusals/{locale}.json").read_text(encoding="utf-8")
    )
    return found


@cache
def translations(locale: str) -> Translations:
    """Return a language's catalogue, as pages have it."""
    return Translations.read_tables(locale, ROOT / "web/src/locales")  # type: ignore[arg-type]


@cache
def translated_sentences(locale: str) -> frozenset[str]:
    """Return the sentences of all catalogues of messages, holes numbered."""
    files = [ROOT / f"web/src/locales/{kind}/{locale}.json" for kind in ("procedures", "settings")]
    others = [key for file in files for key in json.loads(file.read_text(encoding="utf-8"))]
    return frozenset(map(number_holes, (*refusal_texts(locale), *others)))


ARM_TABLES = ("safety_bits.tsv", "robot_modes.tsv")


def of_an_arm(name: str) -> set[str]:
    """Return the sentences of a table as the driver says them: the text with a full stop, and what to do."""
    entries = code_table("cellcal.drivers.universal_robots", name).values()
    entry_texts = [f"{entry.text}. {entry.remedy}" for entry in entries if entry.kind != "ready"]
    return {sentence for words in entry_texts for sentence in SENTENCE.split(words)}


@pytest.mark.parametrize("name", ARM_TABLES)
def test_how_a_universal_robots_arm_stands_has_its_words(name: str) -> None:
    for locale in TRANSLATED:
        assert not of_an_arm(name) - refusal_texts(locale).keys(), locale


CODE_TABLES = (
    ("draw_wire", "emergencies.tsv"),
    ("fanuc.rmi", "refusals.tsv"),
    ("laser_tracker", "statuses.tsv"),
    ("modbus_robot", "reasons.tsv"),
    ("touch_probe", "led_errors.tsv"),
    ("universal_robots", "refusals.tsv"),
    ("wire", "modbus_exceptions.tsv"),
    ("yaskawa", "refusals.tsv"),
    ("modbus_robot", "alarms.tsv"),  # the controller has a text of its own for them
)


def told_by_devices() -> set[str]:
    """Return what codes of devices mean, which stands in a sentence of their driver, and what a person does."""
    tables = [
        (name, code_table(f"cellcal.drivers.{package}", name).values()) for package, name in CODE_TABLES
    ]
    texts = {entry.text for name, entries in tables if name != "alarms.tsv" for entry in entries}
    texts |= set(load_encoder_map().alarms.values())
    # A name with capitals or lines below is the maker's, in every language.
    meanings = {text for text in texts if " " in text or (text.isalpha() and text.islower())}
    remedies = {step for _, entries in tables for entry in entries for step in SENTENCE.split(entry.remedy)}
    return {number_holes(text) for text in meanings | remedies} - {""}


@pytest.mark.parametrize("locale", TRANSLATED)
def test_what_a_code_of_a_device_means_and_asks_for_has_its_words(locale: str) -> None:
    assert not told_by_devices() - translated_sentences(locale)


def _files_of(room: str) -> list[Path]:
    place = ROOT / room
    if not place.is_dir():
        return [place]
    return [file for file in sorted(place.rglob("*.py")) if file.name not in IN_FILES]


@pytest.mark.parametrize("room", WHOLE)
def test_every_refusal_and_rule_has_its_words(room: str) -> None:
    source_sentences = {
        sentence for file in _files_of(room) for sentence in read_source(file).sentences
    } - NOT_FOR_PEOPLE
    assert source_sentences
    for locale in TRANSLATED:
        missing = [
            each
            for each in sorted(source_sentences - translated_sentences(locale))
            if number_holes(BEGUN.sub("", each)) not in translated_sentences(locale)
        ]
        assert not missing, (locale, missing)


def untranslated_prose(file: Path, locale: str) -> list[str]:
    """Return the prose that functions are called with and that stays English, whatever their names are."""
    return [
        each
        for each in sorted(read_source(file).passed - NOT_FOR_PEOPLE - translated_sentences(locale))
        if number_holes(BEGUN.sub("", each)) not in translated_sentences(locale)
        and not _is_translated_step(each, locale)
    ]


def _is_translated_step(sentence: str, locale: str) -> bool:
    """Whether a sentence is the name of a step, which may have a number, with words in this language."""
    name = HOLE.sub("1", sentence)
    return ": " not in name and translations(locale).translate_step(name) != name


@pytest.mark.parametrize("room", WHOLE)
def test_prose_for_a_function_with_any_name_has_its_words(room: str) -> None:
    missing = {
        f"{file.relative_to(ROOT)}: {sentence}"
        for file in _files_of(room)
        for locale in TRANSLATED
        for sentence in untranslated_prose(file, locale)
    }
    assert not missing


def test_a_sentence_is_found_whatever_the_function_that_takes_it_is_called(tmp_path: Path) -> None:
    file = tmp_path / "new_driver.py"
    file.write_text(
        """
raise explain_it(link, "the gearbox is full of water")
found.note(why=name or f"axis {axis} is bent by a collision")
found.note(make_message("the motor of {axis} is too hot", axis=axis) + " and it smells of smoke. Run away now.")
_log.warning("this line is for a log")
read_value("counts_at_zero", "robot[0].kit")
"""
    )
    assert untranslated_prose(file, "de") == [
        "Run away now.",
        "and it smells of smoke.",
        "axis {1} is bent by a collision",
        "the gearbox is full of water",
        "the motor of {1} is too hot",
    ]


@pytest.mark.parametrize("locale", TRANSLATED)
def test_a_translation_has_the_holes_of_its_sentence(locale: str) -> None:
    assert refusal_texts(locale).keys() == refusal_texts("de").keys()
    for english, words in refusal_texts(locale).items():
        assert words.strip(), english
        assert sorted(set(HOLE.findall(words))) == sorted(set(HOLE.findall(english))), (english, words)
        assert len(SENTENCE.split(english)) == 1 or HOLE.search(english), english


def test_every_translation_has_a_source_sentence() -> None:
    rooms = ("calibration", "drivers", "procedures", "service")
    sources = [file for room in rooms for file in (ROOT / room).rglob("*.py")]
    source_sentences = {sentence for file in sources for sentence in read_source(file).sentences}
    source_sentences |= {sentence for name in ARM_TABLES for sentence in of_an_arm(name)}
    source_sentences |= told_by_devices()
    written = "\n".join(literal for file in sources for literal in read_source(file).literals)
    former = set(map(number_holes, json.loads(FORMER.read_text(encoding="utf-8"))))
    assert not former & source_sentences
    unsaid = [
        sentence
        for sentence in set(map(number_holes, refusal_texts("de"))) - source_sentences - former
        if not _stands_in(sentence, written) and sentence not in PARAMETER_NAMES
    ]
    assert not unsaid


@pytest.mark.parametrize("locale", TRANSLATED)
def test_sentences_of_earlier_journals_are_still_translated(locale: str) -> None:
    former = json.loads(FORMER.read_text(encoding="utf-8"))
    assert former
    assert not set(former) - refusal_texts(locale).keys()


def _stands_in(sentence: str, written: str) -> bool:
    """Whether each piece of a sentence between its holes is written somewhere: in a table, or returned."""
    return all(piece.replace("{", "{{") in written or piece in written for piece in HOLE.split(sentence))


def _found_of_bad_moves() -> set[str]:
    """Return what is found of moves that break every limit there is."""
    model = load_model("fanuc_m6ib")
    wire = WirePath((0.9, -0.7, -0.45), (0.06, 0.05, 0.12), 1.2, lowest_fraction=0.6, wrap_rad=0.1)
    things = (
        SphereObstacle("door", (0.8, 0.2, 0.5), 0.4),
        PlaneObstacle("floor", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    )
    shape = assumed_shape(model, things, tip_in_flange_m=(0.0, 0.0, 0.2), wire=wire)
    tight = MotionLimits(
        joint_margin_rad=0.5,
        tip_speed_m_s=1e-6,
        box_low_m=(0.3, -0.2, 0.3),
        box_high_m=(0.5, 0.2, 0.6),
        smallest_singular_value=10.0,
        wire=wire,
        clearances=CollisionCheck.from_model(model, shape),
        position_uncertainty=PositionUncertainty((0.1,) * 6, (0.1,) * 6),
    )
    rng, here = np.random.default_rng(1), np.zeros(6)
    ways = [rng.uniform(model.lower_rad, model.upper_rad, (2, 6)) for _ in range(6)]
    ways += [np.full((1, 6), 20.0), np.full((1, 6), np.nan)]
    starts = [*(here for _ in ways), np.full(6, 20.0)]
    found = [
        check_moves(model, start, way, tight, speed_rad_s=9.0).findings
        for start, way in zip(starts, [*ways, ways[0]], strict=True)
    ]
    return {finding.sentence for findings in found for finding in findings}


def test_findings_of_a_motion_check_are_translated_into_every_language() -> None:
    found = _found_of_bad_moves()
    for check in ("limits", "speed", "box", "singularity", "too", "wrap", "clearance", "finite", "start"):
        assert any(check in sentence for sentence in found), check
    english = re.compile(r"\b(target|limits?|the|and|of|link|flange|tool|tip|wire|clearance|box)\b")
    for locale in TRANSLATED:
        sayings = Translations.read_tables(locale, ROOT / "web/src/locales")
        translated = [
            sayings.translate(
                make_message("the way is not free: {broken_sentence}", broken_sentence=sentence)
            )
            for sentence in found
        ]
        assert not [words for words in translated if english.search(words)], locale


# What is called with the name of an action that may take too long.
TIMED = (
    "answer_deadline",
    "_answer_deadline",
    "timeout_error",
    "_exclusive_use",
    "_read_block",
    "_read_sample",
    "_read",
)


@cache
def _done_in_time() -> frozenset[str]:
    """Return what drivers say they were doing when a device took too long."""
    doing: set[str] = set()
    for file in (ROOT / "drivers").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            words = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
            if called in TIMED:
                doing.update(word for word in words if re.fullmatch(r"[a-z]+ing( [a-z]+)*", word))
    return frozenset(doing)


def _too_long(doing: str) -> str:
    return make_message("{doing} took longer than {seconds} s.", doing=doing, seconds=0.4)


@pytest.mark.parametrize("locale", TRANSLATED)
def test_placeholder_values_are_translated_into_every_language(locale: str) -> None:
    actions = sorted(_done_in_time())
    probe_sentences = [
        str(DeviceTimeoutError("probe", _too_long(doing), remedy="Look at the robot.")) for doing in actions
    ]
    assert len(probe_sentences) > 20
    probe_sentences += [
        make_message("Try '{name}' again?", name="touch the y face 2"),
        make_message(
            "the controller reports: {condition_message}",
            condition_message=join_messages("; ", ("SRVO-062 BZAL", "the robot is not mastered")),
        ),
    ]
    for turn in (ToolTurn(about, 1.0) for about in TURNS):
        probe_sentences.append(
            make_message("Turn the tool {turn} of the flange, or further.", turn=turn.describe_turn())
        )
        probe_sentences.append(
            make_message(
                "From the first touch's attitude, turn the tool {turn} of the flange, about; touch the pin.",
                turn=turn.describe_turn(),
            )
        )
    sayings = Translations.read_tables(locale, ROOT / "web/src/locales")
    english = re.compile(r"\b(the|of|and|between|about|touch|try|is|not|[a-z]+ing)\b")
    assert not [words for words in map(sayings.translate, probe_sentences) if english.search(words)], locale
