"""Where an identification starts: from nominal, from a stored parameter set, or from an earlier report."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.free_parameters import KnownPlaces, StartingPoint
from cellcal.calibration.identification.observations import DevicePlacement
from cellcal.calibration.identification.parameters import ArmState
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.calibrated_models import calibrated_model, covariance_of
from cellcal.service.engineering.parameters.parameter_set import parse_set
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets

_PLACES = 4  # numbers in a row of a matrix


@dataclass(frozen=True, slots=True)
class StartOptions:
    """The options of where to start, and which parameters may change."""

    start: str = "nominal"  # nominal | previous | a file
    sets: Path | None = None  # folder of parameter sets, for previous
    serial: str = ""
    free: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class IdentificationStart:
    """A starting point with what it is called, and the uncertainties that its values had."""

    point: StartingPoint
    name: str
    sigmas: Mapping[str, float] = field(default_factory=dict)


def read_start(options: StartOptions, nominal: RobotModel, kind: str) -> IdentificationStart:
    """Return the starting point that the options name, for this robot and kind of observation.

    Raises
    ------
    MeasurementError
        It cannot be found or read, or belongs to another robot.
    ParameterSetError
        The stored set is damaged or refers to another nominal model.
    """
    free = tuple(word.strip() for part in options.free for word in part.split(",") if word.strip())
    if options.start == "nominal":
        return IdentificationStart(StartingPoint(free=free), "nominal")
    if options.start == "previous":
        if options.sets is None or not options.serial:
            raise MeasurementError(
                "it is not given which robot's previous parameters to start from.",
                remedy="Give `--save FOLDER` and `--serial`, or `--start FILE`.",
            )
        return _of_set(ParameterSets(options.sets).load_set(options.serial), nominal, free)
    path = Path(options.start)
    text = read_plain_text(path)
    if path.suffix.lower() == ".json":
        return _of_report(path, text, nominal, (kind, free))
    return _of_set(parse_set(text, str(path)), nominal, free)


def _of_set(found: Any, nominal: RobotModel, free: tuple[str, ...]) -> IdentificationStart:
    calibrated_model(nominal, found)  # refuses what belongs to another model
    values = {value.name: value.value for value in found.values}
    sigmas = {v.name: v.standard_uncertainty for v in found.values if v.standard_uncertainty is not None}
    name = f"version {found.version} of robot {found.robot_serial}"
    names = tuple(value.name for value in found.values)
    point = StartingPoint(values, free, names=names, covariance=covariance_of(found))
    return IdentificationStart(point, name, sigmas)


def _of_report(
    path: Path, text: str, nominal: RobotModel, what: tuple[str, tuple[str, ...]]
) -> IdentificationStart:
    kind, free = what
    try:
        document = parse_json(text)
        robot, parameters = document["robot"], document["parameters"]
        values = {item["name"]: float(item["value"]) for item in parameters}
        sigmas = {item["name"]: float(item["sigma"]) for item in parameters}
        # A tool of poses serves for points; a point on the tool does not tell its attitude.
        fits = document["places"]["kind"] in {"point": ("point", "pose")}.get(kind, (kind,))
        places = _read_places(document["places"]) if fits else None
    except (ValueError, KeyError, TypeError, CalibrationError) as broken:
        raise MeasurementError(
            f"{path} is no report of an identification.", remedy="Write it with `cellcal identify --json`."
        ) from broken
    if robot != nominal.name or not np.isfinite([*values.values(), *sigmas.values()]).all():
        raise MeasurementError(
            f"{path} is about a {robot}, or holds numbers that are none.",
            remedy=f"It must be of a {nominal.label}.",
        )
    arm = {name: value for name, value in values.items() if not name.startswith("wire ")}
    return IdentificationStart(StartingPoint(arm, free, places), f"the report {path.name}", sigmas)


def places_document(state: ArmState, kind: str) -> dict[str, object]:
    """Return where devices and target are, as a report holds it and `read_start` reads it."""
    return {
        "kind": kind,
        "flange_tool": state.flange_tool.tolist(),
        "devices": [
            {
                "device_base": device.device_base.tolist(),
                "anchor_in_base_m": device.anchor_in_base_m.tolist(),
                "zero_m": device.zero_m,
                "scale": device.scale,
            }
            for device in state.devices
        ],
    }


def _read_places(document: Mapping[str, Any]) -> KnownPlaces:
    """Read the places of the last mounting: that is where the device stands now."""
    last = document["devices"][-1]
    anchor = np.array(last["anchor_in_base_m"], dtype=float)
    numbers = np.array([last["zero_m"], last["scale"], *anchor], dtype=float)
    if anchor.shape != (3,) or not np.isfinite(numbers).all():
        raise ValueError("no anchor")
    device = DevicePlacement(
        _read_matrix(last["device_base"]), anchor, float(last["zero_m"]), float(last["scale"])
    )
    return KnownPlaces(device, _read_matrix(document["flange_tool"]))


def _read_matrix(rows: Any) -> Array:
    matrix = np.array(rows, dtype=float)
    turn = matrix[:3, :3] if matrix.shape == (_PLACES, _PLACES) else np.zeros((3, 3))
    if not (np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-6)):
        raise ValueError("no rigid transform")
    return matrix
