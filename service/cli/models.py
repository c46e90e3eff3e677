"""``cellcal models``: the robots that ship, found by words; one robot with all that is known of it."""

from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from cellcal.service.cli.model_argument import ModelArgument

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.console import Console

    from cellcal.calibration.arm.kinematics import DhTable, RobotModel
    from cellcal.calibration.arm.robot_models.catalogue_index import CatalogueEntry


def models(
    *words: ModelArgument,
    maker: str = "",
    every: Annotated[bool, Parameter(name="--all", negative=())] = False,
    as_json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Find robots that ship, by words in any spelling, or show one with its source and what to doubt.

    Wherever a command or a file takes a robot, it takes one of these names, a model file (`arm.toml`), or a
    description with every xacro expanded: 'arm.urdf?base=LINK&tip=LINK' (in quotes).

    Parameters
    ----------
    words
        Parts of a name: kr210, irb 120, crx, panda, scara, 7 axis. The whole name, or a file, shows that robot.
    maker
        Only robots of this maker.
    every
        Also robots whose numbers do not ship, with the reason.
    as_json
        Print one JSON object on standard output.
    """
    from rich.console import Console

    from cellcal.calibration.arm.robot_models import known_names
    from cellcal.calibration.arm.robot_models.catalogue_index import find_robots, is_called
    from cellcal.calibration.arm.robot_models.other_kinds import other_kind
    from cellcal.calibration.errors import CalibrationError
    from cellcal.service.cli.printing import print_json

    text = " ".join(words)
    if len(words) == 1 and (words[0] in known_names() or _is_reference(words[0])):
        return _show_one(words[0], as_json)
    found = [entry for entry in find_robots(text, maker) if every or entry.usable]
    nearly = bool(text) and bool(found) and not is_called(found[0], text)
    other = other_kind(text)
    if other is not None and (nearly or not found):
        raise CalibrationError(f"{text} {other.reason}", remedy=other.remedy, code="usage")
    if not found:
        _refuse(text, maker)
    if as_json:
        print_json({"models": [_as_row(entry) for entry in found], "nearly": nearly})
    else:
        if other is not None:
            Console(emoji=False, highlight=False).print(f"{text} {other.reason} {other.remedy}", markup=False)
        if nearly:
            Console(emoji=False, highlight=False).print(
                f"No robot is called {text!r}; these names are near to it."
            )
        _print_list(Console(emoji=False, highlight=False), found)
    return 0


def _is_reference(word: str) -> bool:
    """Return whether a word names a file, or says more than a name; makers write / and . into names."""
    if not any(mark in word for mark in "?@./\\"):
        return False
    from cellcal.calibration.arm.model_references import parse_reference

    return any(mark in word for mark in "?@") or parse_reference(word).is_file


def _refuse(text: str, maker: str) -> None:
    from cellcal.calibration.arm.robot_models.catalogue_index import (
        catalogue_entries,
        find_robots,
        least_unlike,
    )
    from cellcal.calibration.errors import CalibrationError

    withheld = find_robots(text, maker)
    if withheld:
        names = ", ".join(entry.name for entry in withheld[:3])
        raise CalibrationError(
            f"the catalogue knows {names}, and does not ship the numbers: {withheld[0].withheld}",
            remedy="Write a model file of your own, or read the maker's description (URDF).",
            code="usage",
        )
    makers = ", ".join(sorted({entry.maker for entry in catalogue_entries() if entry.usable}))
    of_maker = f" of a maker {maker!r}" if maker else ""
    near = least_unlike(text) if text and not maker else []
    nearest = f"The nearest names: {', '.join(near)}. " if near else ""
    raise CalibrationError(
        f"no robot{of_maker} fits {text!r}." if text else f"no robot{of_maker} ships.",
        remedy=f"{nearest}Makers: {makers}. A model file (.toml) or a description (.urdf?tip=LINK) does as well.",
        code="usage",
    )


def _print_list(console: "Console", found: "Sequence[CatalogueEntry]") -> None:
    from cellcal.service.cli.printing import PlainTable

    withheld = any(not entry.usable for entry in found)
    table = PlainTable("model", "robot", "axes", "doubts", *(("not shipped because",) if withheld else ()))
    for entry in found:
        doubts = str(entry.doubts) if entry.doubts else ""
        table.add_row(
            entry.name, entry.title, str(entry.axes), doubts, *((entry.withheld,) if withheld else ())
        )
    console.print(table)
    shown = [entry for entry in found if entry.usable]
    makers = len({entry.maker for entry in shown})
    console.print(f"Robots: {len(shown)}, makers: {makers}.")


def _as_row(entry: "CatalogueEntry") -> dict[str, object]:
    row = {"name": entry.name, "title": entry.title, "maker": entry.maker, "family": entry.family}
    row |= {"kind": entry.kind, "licence": entry.licence}
    return {**row, "axes": entry.axes, "doubts": entry.doubts, "withheld": entry.withheld or None}


def _show_one(reference: str, as_json: bool) -> int:
    from rich.console import Console

    from cellcal.calibration.arm.kinematics import load_model
    from cellcal.service.cli.printing import print_json

    model, origin = load_model(reference), _origin(reference)
    if as_json:
        print_json({"models": [_as_object(model, origin)]})
        return 0
    console = Console(emoji=False, highlight=False)
    _print_joints(console, model)
    for limit in model.combined_limits:
        low, high = (_degrees(end) for end in (limit.lower_rad, limit.upper_rad))
        console.print(f"{limit.name} stays between {low:g} and {high:g} deg.")
    _print_origin(console, origin)
    return 0


def _origin(reference: str) -> "Mapping[str, Any]":
    """Return what the catalogue tells of a robot beside its numbers; of a file, nothing."""
    from cellcal.calibration.arm.model_references import parse_reference
    from cellcal.calibration.arm.robot_models.catalogue_index import catalogue_robot, usable_names

    name = parse_reference(reference).where
    return catalogue_robot(name) if name in usable_names() else {}


def _print_joints(console: "Console", model: "RobotModel") -> None:
    from cellcal.service.cli.printing import PlainTable

    shown = _as_object(model, {})
    headings = ("theta (deg)", "d (mm)", "a (mm)", "alpha (deg)", "beta (deg)") if shown["dh"] else ("type",)
    table = PlainTable("row", *headings, "limits (deg)", title=model.title)
    if model.sliding is not None:
        table.columns[-1].header = "limits (deg, mm)"
    for i, joint in enumerate(shown["joints"]):
        cells = [joint["type"]]
        if shown["dh"]:
            row = shown["dh"][i]
            cells = [f"{row[key]:.4f}" for key in ("theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")]
        low, high = joint["limits"]
        table.add_row(f"J{i + 1}", *cells, f"{low:g} … {high:g}")
    console.print(table)


def _print_origin(console: "Console", origin: "Mapping[str, Any]") -> None:
    from rich.text import Text

    if not origin:
        return
    source, frames = origin["source"], [*origin.get("bases", {}), *origin.get("tips", {})]
    lines = [f"Maker: {origin['maker']}. Kind: {origin['kind']}. Flange: {origin['tip']} of the source."]
    if frames:
        lines.append(f"Further frames (?base=, ?tip=): {', '.join(frames)}.")
    at = f"{source['repo']} {source['commit'][:12]}"
    lines.append(f"Source: {at}, {source['path']}; licence {source['licence']}.")
    lines += [f"Doubt: {doubt}" for doubt in origin["doubts"]]
    for line in lines:
        console.print(Text(line))


def _as_object(model: "RobotModel", origin: "Mapping[str, Any]") -> dict[str, Any]:
    dh = [] if model.dh is None else [_row(model, model.dh, i) for i in range(model.axis_count)]
    found: dict[str, Any] = {"name": model.name, "title": model.title, "axes": model.axis_count, "dh": dh}
    found["joints"] = [_joint(model, i) for i in range(model.axis_count)]
    found["joint_coupling"] = model.joint_coupling.tolist()
    found["combined_limits"] = [
        {
            "weights": list(limit.weights),
            "limits_deg": [_degrees(limit.lower_rad), _degrees(limit.upper_rad)],
        }
        for limit in model.combined_limits
    ]
    keys = ("maker", "family", "kind", "source", "doubts", "tip", "bases", "tips", "reach_mm")
    return found | {key: origin[key] for key in keys if key in origin}


def _joint(model: "RobotModel", i: int) -> dict[str, Any]:
    """Return one joint in degrees, or millimetres where it slides."""
    slides = model.sliding is not None and bool(model.sliding[i])
    unit = 1e3 if slides else _degrees(1.0)
    ends = [float(model.lower_rad[i]) * unit, float(model.upper_rad[i]) * unit]
    speed = float(model.max_speed_rad_s[i]) * unit
    named = {"name": model.joint_names[i], "type": model.kinds[i], "unit": "mm" if slides else "deg"}
    return {**named, "limits": ends, "speed_per_s": speed}


def _row(model: "RobotModel", dh: "DhTable", i: int) -> dict[str, Any]:
    return {
        "theta_deg": _degrees(dh.theta_rad[i]),
        "d_mm": float(dh.d_m[i]) * 1e3,
        "a_mm": float(dh.a_m[i]) * 1e3,
        "alpha_deg": _degrees(dh.alpha_rad[i]),
        "beta_deg": _degrees(dh.beta_rad[i]),
        "limits_deg": [_degrees(model.lower_rad[i]), _degrees(model.upper_rad[i])],
    }


def _degrees(angle_rad: float) -> float:
    """Return degrees without the digits that a turn through radians adds."""
    from math import degrees

    return round(degrees(angle_rad), 9)
