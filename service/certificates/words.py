"""A certificate's content in words and rounded figures: what the text, the page and the PDF say alike."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cellcal.service.quantities import quantity
from cellcal.service.translation import Sayings

ENGLISH = Sayings("en", {})  # as it is signed
WORDS = {
    "pass": "PASS",
    "fail": "FAIL",
    "undecided": "UNDECIDED - measure more",
    "refused": "REFUSED - nothing is claimed",
    None: "-",
}
NO_TEMPERATURE = "No temperature was recorded: nothing is corrected for it."
NOT_TOLD = "not verified, this robot does not tell it"
_SAID_MODES = ("remote control", "local control")  # others are names on a switch
_LEVELS = {
    "observe": "a person with the pendant (observe)",
    "program": "a program that a person ran on the pendant (program)",
    "commanded": "this software (commanded)",
}
WHOLE_RESULT = "The whole result is in the JSON file of the same name."


@dataclass(frozen=True, slots=True)
class Figure:
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
    def told(self) -> str:
        """Found, U and limit on one line."""
        expanded = f"{self.expanded} ({self.coverage})" if self.expanded else ""
        parts = (("found ", self.found), ("U = ", expanded), ("limit ", self.limit))
        return "; ".join(before + text for before, text in parts if text)


def figure_in_words(figure: Mapping[str, Any], words: Sayings = ENGLISH) -> Figure:
    """Return a characteristic as people read it; a judged uncertainty is itself what was found."""
    unit, expanded, limit = figure["unit"], figure["expanded_uncertainty"], figure["limit"]
    bare = limit is None and (unit, figure["value"]) == ("1", 1.0)  # a fact, no figure
    shown = not bare and not figure["value"] == expanded > 0.0
    return Figure(
        name=words.say(figure["name"]),
        word=words.say("stated" if figure["decision"] is None else figure["decision"].upper()),
        found=_said(figure["value"], unit, words) if shown else "",
        expanded=_said(expanded, unit, words) if expanded else "",
        coverage=f"k = {figure['coverage']:.2f}" if expanded else "",
        limit="" if limit is None else _said(limit, unit, words),
        rule=words.say(figure["rule"]),
        budget=tuple(
            (
                words.say(part["name"]),
                _said(part["standard_uncertainty"], unit, words),
                words.say(part["source"]),
            )
            for part in figure["budget"]
        ),
    )


def head_rows(content: Mapping[str, Any], words: Sayings = ENGLISH) -> list[tuple[str, str]]:
    """Return what was calibrated, with what, and when."""
    run, devices = content["run"], content["devices"]
    version = words.say(f"version {run['procedure_version']}")
    rows = [
        ("procedure", f"{words.say(run['title'])} ({run['procedure']}, {version})"),
        ("robot", _who_is(devices[0]["identity"], words)),
        *((device["role"], _who_is(device["identity"], words)) for device in devices[1:]),
        ("cell", content["cell"]["name"]),
        ("encoder epoch", words.say(f"{content['encoder_epoch_at_start']} at the start")),
        ("run", run["run_id"]),
        ("from, to (UTC)", f"{at_time(run['started_utc'])}, {at_time(run['ended_utc'])}"),
    ]
    return [(words.say(name), value) for name, value in rows]


def controller_rows(content: Mapping[str, Any], words: Sayings = ENGLISH) -> list[tuple[str, str]]:
    """Return what was selected on the controller when the run began, and who moved the robot.

    Nothing for certificates from before this was part of what is signed.
    """
    told = content.get("controller_at_start")
    if told is None:
        return []
    frames = told["active_frames"] or {}
    payload, mode = frames.get("payload_kg"), told["controller_mode"]
    rows = (
        ("active tool", _tool(frames, words)),
        ("user frame", _user_frame(frames.get("user_frame_number"), words)),
        ("payload", "" if payload is None else f"{payload:.3f} kg"),
        ("controller mode", words.say(mode) if mode in _SAID_MODES else mode),
    )
    moved = words.say(_LEVELS.get(told["motion_level"], "not recorded"))
    shown = [(words.say(name), value or words.say(NOT_TOLD)) for name, value in rows]
    return [*shown, (words.say("moved by"), moved)]


def _tool(frames: Mapping[str, Any], words: Sayings) -> str:
    number, pose = frames.get("tool_number"), frames.get("flange_tool")
    parts = (
        "" if number is None else words.say(f"number {number}"),
        pose_in_words(pose, words) if pose else "",
    )
    return ": ".join(part for part in parts if part)


def _user_frame(number: int | None, words: Sayings) -> str:
    if number is None:
        return ""
    return words.say(f"number {number}") if number else words.say("number 0, the base itself")


def change_rows(changes: Iterable[Mapping[str, Any]], words: Sayings = ENGLISH) -> list[tuple[str, str, str]]:
    """Return name, before and after of what changed."""

    def shown(value: float | None, unit: str) -> str:
        return words.say("not read") if value is None else _said(value, unit, words)

    return [
        (
            words.say(change["name"]),
            shown(change["before"], change["unit"]),
            shown(change["after"], change["unit"]),
        )
        for change in changes
    ]


def short_facts(result: Any, words: Sayings = ENGLISH) -> Iterator[tuple[str, str]]:
    """Return what of a result, or of settings, fits on a line: single values and poses."""
    for key, value in result.items() if isinstance(result, dict) else ():
        if is_pose(value):
            yield _name(key), pose_in_words(value, words)
        elif isinstance(value, bool | int | float | str) and value != "":
            yield _name(key), _scalar(key, value, words)
        elif isinstance(value, dict):
            yield from short_facts({k: v for k, v in value.items() if is_pose(v)}, words)


def pose_in_words(pose: Mapping[str, Any], words: Sayings = ENGLISH) -> str:
    """Return a pose in millimetres, with its quaternion."""
    q = ", ".join(f"{v:+.7f}" for v in pose["quaternion"])
    return f"{place_in_words(pose['position_m'])}; {words.say('quaternion')} w x y z {q}"


def place_in_words(position_m: Sequence[float]) -> str:
    """Return a place in millimetres."""
    x, y, z = (f"{1e3 * v:.3f}" for v in position_m)
    return f"x {x}, y {y}, z {z} mm"


def is_pose(value: Any) -> bool:
    """Tell a pose from other objects."""
    return isinstance(value, dict) and {"position_m", "quaternion"} <= value.keys()


def answers_by_person(
    people: Sequence[Mapping[str, str]],
) -> Iterator[tuple[str, Sequence[Mapping[str, str]]]]:
    """Return every person once, with all that he or she answered."""
    for who in dict.fromkeys(answer["who"] for answer in people):
        yield who, [answer for answer in people if answer["who"] == who]


def accepted_by(answers: Iterable[Mapping[str, str]], words: Sayings = ENGLISH) -> str:
    """Return what a person accepted, separated by commas."""
    steps = (answer["step"] for answer in answers)
    return ", ".join(words.step(step).removeprefix("accept ") for step in steps if step.startswith("accept"))


def sign_off_rows(
    given: Iterable[Mapping[str, Any]], words: Sayings = ENGLISH
) -> list[tuple[str, str, str, str, str]]:
    """Return what was accepted, approved or signed: what, by whom, in which role, when; and a hash."""
    return [
        (
            f"{words.say(one['did'])}: {words.step(one['what'])}",
            one["who"],
            words.say(" and ".join(person["role"] for person in one["people"]) or "role not recorded"),
            at_time(one["at_utc"]),
            words.say(f"SHA-256 of what was shown {one['what_sha256'][:16]}…") if one["what_sha256"] else "",
        )
        for one in given
    ]


def picture_rows(pictures: Iterable[Mapping[str, Any]]) -> list[tuple[str, str, str, str]]:
    """Return what photos show, by whom they were taken, when, and their whole hash."""
    return [
        (
            f"{one['what']} ({one['media_type'].removeprefix('image/').upper()})",
            one["who"],
            at_time(one["at_utc"]),
            one["sha256"],
        )
        for one in pictures
    ]


def made_with_rows(run: Mapping[str, Any], words: Sayings = ENGLISH) -> list[tuple[str, str]]:
    """Return software, solver and definition, once for every software that had a part in the run."""
    return [
        (
            f"cellcal {made.get('software', '?')}, {made.get('solver') or words.say('solver not recorded')}",
            made.get("definition_sha256") or words.say("not recorded"),
        )
        for made in run["made_with"]
    ]


def at_time(wall_utc: str) -> str:
    """Return date and time to the second."""
    return wall_utc[:19].replace("T", " ")


def file_stem(content: Mapping[str, Any]) -> str:
    """Return the name of a run's files; a refused run may be resumed and end well, so its record has another."""
    run_id = str(content["run"]["run_id"])
    return f"{run_id}-refused" if "refusal" in content else run_id


def _said(value: float, unit: str, words: Sayings) -> str:
    shown = quantity(value, unit)
    return words.say(shown) if unit == "turn" else shown  # other units are written alike everywhere


def _scalar(key: str, value: bool | int | float | str, words: Sayings) -> str:
    if isinstance(value, bool):
        return words.say("yes" if value else "no")
    if isinstance(value, float):
        unit = next((unit for unit in ("rad", "m") if key.endswith(f"_{unit}")), "")
        return quantity(value, unit) if unit else f"{value:.6g}"
    return str(value)


def _name(key: str) -> str:
    for unit in ("_rad", "_m"):
        key = key.removesuffix(unit)
    speed = " [rad/s]" if key.endswith("_rad_s") else ""
    return key.removesuffix("_rad_s").replace("_", " ") + speed


def _who_is(identity: Mapping[str, str], words: Sayings) -> str:
    serial = words.say(f"serial {identity['serial']}")
    return f"{identity['vendor']} {identity['model']}, {serial}, {identity['firmware']}"
