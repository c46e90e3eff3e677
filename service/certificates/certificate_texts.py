"""A certificate's content in words and rounded figures: what the text, the page and the PDF say alike."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.service.certificates.result_names import RESULT_NAMES
from cellcal.service.quantities import format_quantity
from cellcal.service.translation import Translations

ENGLISH = Translations("en", {})  # as it is signed
WORDS = {
    "pass": "PASS",
    "fail": "FAIL",
    "undecided": "UNDECIDED - measure more",
    "refused": "REFUSED - nothing is claimed",
    None: "-",
}
NO_TEMPERATURE = "No temperature was recorded: nothing is corrected for it."
NOT_REPORTED = "not verified, this robot does not tell it"
_CONTROL_MODES = ("remote control", "local control")  # others are names on a switch
_LEVELS = {
    "observe": "a person with the pendant",
    "program": "a program that a person ran on the pendant",
    "commanded": "this software",
}
# The longer ending first: a speed is no length of time.
_UNITS_BY_ENDING = (("_rad_s", "rad/s"), ("_m_s", "m/s"), ("_rad", "rad"), ("_m", "m"))
WHOLE_RESULT = "The whole result is in the JSON file of the same name."


@dataclass(frozen=True, slots=True)
class FigureTexts:
    """One characteristic in words; empty where there is nothing to say."""

    name: str
    word: str  # PASS, FAIL, UNDECIDED, stated
    found: str
    expanded: str  # U
    coverage: str  # k of U
    limit: str
    rule: str
    budget: tuple[tuple[str, str, str], ...]  # contribution, u, source

    @property
    def result_line(self) -> str:
        """Found, U and limit on one line."""
        expanded = f"{self.expanded} ({self.coverage})" if self.expanded else ""
        parts = (("found ", self.found), ("U = ", expanded), ("limit ", self.limit))
        return "; ".join(before + text for before, text in parts if text)


def describe_figure(figure: Mapping[str, Any], translations: Translations = ENGLISH) -> FigureTexts:
    """Return a characteristic as people read it; a judged uncertainty is itself what was found."""
    unit, expanded, limit = figure["unit"], figure["expanded_uncertainty"], figure["limit"]
    bare = limit is None and (unit, figure["value"]) == ("1", 1.0)  # a fact, no figure
    shown = not bare and not figure["value"] == expanded > 0.0
    if is_yes_or_no(figure):
        found, limit_text = translations.translate("yes" if figure["value"] else "no"), ""
    else:
        found = _format_quantity(figure["value"], unit, translations) if shown else ""
        limit_text = "" if limit is None else _format_quantity(limit, unit, translations)
    return FigureTexts(
        name=translations.translate(figure["name"]),
        word=translations.translate("stated" if figure["decision"] is None else figure["decision"].upper()),
        found=found,
        expanded=_format_quantity(expanded, unit, translations) if expanded else "",
        coverage=translations.format_number(f"k = {figure['coverage']:.2f}") if expanded else "",
        limit=limit_text,
        rule=translations.translate(figure["rule"]),
        budget=tuple(
            (
                translations.translate(part["name"]),
                _format_quantity(part["standard_uncertainty"], unit, translations),
                translations.translate(part["source"]),
            )
            for part in figure["budget"]
        ),
    )


def is_yes_or_no(figure: Mapping[str, Any]) -> bool:
    """Return whether a judged figure is a condition that holds (1) or not (0), with 1 as its limit."""
    is_judged = figure["decision"] is not None
    return is_judged and (figure["unit"], figure["limit"]) == ("1", 1.0) and figure["value"] in (0.0, 1.0)


def head_rows(content: Mapping[str, Any], translations: Translations = ENGLISH) -> list[tuple[str, str]]:
    """Return what was calibrated, with what, and when."""
    run, devices = content["run"], content["devices"]
    version = translations.translate(make_message("version {run}", run=run["procedure_version"]))
    rows = [
        ("procedure", f"{translations.translate(run['title'])} ({run['procedure']}, {version})"),
        ("robot", _describe_identity(devices[0]["identity"], translations)),
        *((device["role"], _describe_identity(device["identity"], translations)) for device in devices[1:]),
        ("cell", content["cell"]["name"]),
        (
            "encoder epoch",
            translations.translate(
                make_message("{content} at the start", content=content["encoder_epoch_at_start"])
            ),
        ),
        ("run", run["run_id"]),
        ("from, to (UTC)", f"{format_time(run['started_utc'])}, {format_time(run['ended_utc'])}"),
    ]
    return [(translations.translate(name), value) for name, value in rows]


def controller_rows(
    content: Mapping[str, Any], translations: Translations = ENGLISH
) -> list[tuple[str, str]]:
    """Return what was selected on the controller when the run began, and who moved the robot.

    Nothing for certificates from before this was part of what is signed.
    """
    controller = content.get("controller_at_start")
    if controller is None:
        return []
    frames = controller["active_frames"] or {}
    payload, mode = frames.get("payload_kg"), controller["controller_mode"]
    rows = (
        ("active tool", _describe_tool(frames, translations)),
        ("user frame", _user_frame(frames.get("user_frame_number"), translations)),
        ("payload", "" if payload is None else translations.format_number(f"{payload:.3f} kg")),
        ("controller mode", translations.translate(mode) if mode in _CONTROL_MODES else mode),
    )
    moved = translations.translate(_LEVELS.get(controller["motion_level"], "not recorded"))
    shown = [
        (translations.translate(name), value or translations.translate(NOT_REPORTED)) for name, value in rows
    ]
    return [*shown, (translations.translate("moved by"), moved)]


def _describe_tool(frames: Mapping[str, Any], translations: Translations) -> str:
    number, pose = frames.get("tool_number"), frames.get("flange_tool")
    parts = (
        "" if number is None else translations.translate(make_message("number {number}", number=number)),
        describe_pose(pose, translations) if pose else "",
    )
    return ": ".join(part for part in parts if part)


def _user_frame(number: int | None, translations: Translations) -> str:
    if number is None:
        return ""
    return (
        translations.translate(make_message("number {number}", number=number))
        if number
        else translations.translate("number 0, the base itself")
    )


def change_rows(
    changes: Iterable[Mapping[str, Any]], translations: Translations = ENGLISH
) -> list[tuple[str, str, str]]:
    """Return name, before and after of what changed."""

    def format_value(value: float | None, unit: str) -> str:
        return (
            translations.translate("not read")
            if value is None
            else _format_quantity(value, unit, translations)
        )

    return [
        (
            translations.translate(change["name"]),
            format_value(change["before"], change["unit"]),
            format_value(change["after"], change["unit"]),
        )
        for change in changes
    ]


def short_facts(result: Any, translations: Translations = ENGLISH) -> Iterator[tuple[str, str]]:
    """Return what of a result, or of settings, fits on a line: single values and poses."""
    for key, value in result.items() if isinstance(result, dict) else ():
        if is_pose(value):
            yield _display_name(key, translations), describe_pose(value, translations)
        elif isinstance(value, bool | int | float | str) and value != "":
            yield _display_name(key, translations), _describe_scalar(key, value, translations)
        elif isinstance(value, dict):
            yield from short_facts({k: v for k, v in value.items() if is_pose(v)}, translations)


def describe_pose(pose: Mapping[str, Any], translations: Translations = ENGLISH) -> str:
    """Return a pose in millimetres, with its quaternion."""
    q = _list_numbers([f"{v:+.7f}" for v in pose["quaternion"]], translations)
    place = describe_place(pose["position_m"], translations)
    return f"{place}; {translations.translate('quaternion')} w x y z {q}"


def describe_place(position_m: Sequence[float], translations: Translations = ENGLISH) -> str:
    """Return a place in millimetres."""
    named = [f"{axis} {1e3 * v:.3f}" for axis, v in zip("xyz", position_m, strict=True)]
    return f"{_list_numbers(named, translations)} mm"


def _list_numbers(numbers: Sequence[str], translations: Translations) -> str:
    """Return numbers side by side: where a comma is their decimal mark it does not stand between them, too."""
    return ("; " if translations.commas else ", ").join(map(translations.format_number, numbers))


def is_pose(value: Any) -> bool:
    """Tell a pose from other objects."""
    return isinstance(value, dict) and {"position_m", "quaternion"} <= value.keys()


def answers_by_person(
    people: Sequence[Mapping[str, str]],
) -> Iterator[tuple[str, Sequence[Mapping[str, str]]]]:
    """Return every person once, with all that he or she answered."""
    for who in dict.fromkeys(answer["who"] for answer in people):
        yield who, [answer for answer in people if answer["who"] == who]


def join_accepted(answers: Iterable[Mapping[str, str]], translations: Translations = ENGLISH) -> str:
    """Return what a person accepted, separated by commas."""
    steps = (answer["step"] for answer in answers)
    return ", ".join(
        translations.translate_step(step).removeprefix("accept ")
        for step in steps
        if step.startswith("accept")
    )


def sign_off_rows(
    sign_offs: Iterable[Mapping[str, Any]], translations: Translations = ENGLISH
) -> list[tuple[str, str, str, str, str]]:
    """Return what was accepted, approved or signed: what, by whom, in which role, when; and a hash."""
    return [
        (
            f"{translations.translate(one['did'])}: {_what(one['what'], translations)}",
            one["who"],
            translations.translate(
                " and ".join(person["role"] for person in one["people"]) or "role not recorded"
            ),
            format_time(one["at_utc"]),
            translations.translate(
                make_message("SHA-256 of what was shown {one}…", one=one["what_sha256"][:16])
            )
            if one["what_sha256"]
            else "",
        )
        for one in sign_offs
    ]


def _what(what: str, words: Translations) -> str:
    """Return a step's name, or a sentence, in the language of the certificate."""
    return words.translate(what) if what.endswith(".") else words.translate_step(what)


def picture_rows(pictures: Iterable[Mapping[str, Any]]) -> list[tuple[str, str, str, str]]:
    """Return what photos show, by whom they were taken, when, and their whole hash."""
    return [
        (
            f"{one['what']} ({one['media_type'].removeprefix('image/').upper()})",
            one["who"],
            format_time(one["at_utc"]),
            one["sha256"],
        )
        for one in pictures
    ]


def made_with_rows(run: Mapping[str, Any], translations: Translations = ENGLISH) -> list[tuple[str, str]]:
    """Return software, solver and definition, once for every software that had a part in the run."""
    return [
        (
            f"cellcal {made.get('software', '?')}, "
            f"{made.get('solver') or translations.translate('solver not recorded')}",
            made.get("definition_sha256") or translations.translate("not recorded"),
        )
        for made in run["made_with"]
    ]


def format_time(wall_utc: str) -> str:
    """Return date and time to the second."""
    return wall_utc[:19].replace("T", " ")


def file_stem(content: Mapping[str, Any]) -> str:
    """Return the name of a run's files; a refused run may be resumed and end well, so its record has another."""
    run_id = str(content["run"]["run_id"])
    return f"{run_id}-refused" if "refusal" in content else run_id


def _format_quantity(value: float, unit: str, translations: Translations) -> str:
    shown = format_quantity(value, unit)
    return (
        translations.translate(shown) if unit == "turn" else translations.format_number(shown)
    )  # other units are written alike everywhere


def _describe_scalar(key: str, value: bool | int | float | str, translations: Translations) -> str:
    if isinstance(value, bool):
        return translations.translate("yes" if value else "no")
    if isinstance(value, float):
        unit = next((unit for end, unit in _UNITS_BY_ENDING if key.endswith(end)), "")
        return translations.format_number(format_quantity(value, unit) if unit else f"{value:.6g}")
    text = str(value)
    return translations.translate(text) if translations.is_translated(text) else text


def _display_name(key: str, translations: Translations) -> str:
    if key in RESULT_NAMES:
        return translations.translate(RESULT_NAMES[key])
    for ending, _ in _UNITS_BY_ENDING:
        key = key.removesuffix(ending)
    return key.replace("_", " ")


def _describe_identity(identity: Mapping[str, str], translations: Translations) -> str:
    serial = translations.translate(make_message("serial {identity}", identity=identity["serial"]))
    return f"{identity['vendor']} {identity['model']}, {serial}, {identity['firmware']}"
