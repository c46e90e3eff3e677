"""What an identification leaves behind: a parameter set of the robot, and a calibrated description."""

import hashlib
from pathlib import Path

from cellcal.calibration.arm.model_references import parse_reference
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.identification.parameters import FRAMES
from cellcal.calibration.message import make_message
from cellcal.service.engineering.identification.identify import IdentifyReport
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256, values_of_identification
from cellcal.service.engineering.parameters.parameter_files import SetOrigin
from cellcal.service.engineering.parameters.parameter_set import ParameterSet
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.files import SHARED_FILE, replace_file


def save_identification(
    report: IdentifyReport, measurements: Path, folder: Path, who: SetOrigin
) -> ParameterSet:
    """Save the identified parameters as the robot's newest version.

    Raises
    ------
    MeasurementError
        Nothing about the arm was identified.
    """
    _refuse_frames(report)
    nominal = report.identification.state.nominal
    digest = hashlib.sha256(read_plain_bytes(measurements)).hexdigest()
    draft = ParameterSet(
        robot_serial=who.robot_serial,
        model=nominal.name,
        nominal_sha256=nominal_sha256(nominal),
        made_at=who.made_at,
        made_by=who.made_by,
        source=make_message("identification: {file}, sha256 {sha256}", file=measurements.name, sha256=digest),
        # Zero and scale belong to the wire, not to the arm.
        values=values_of_identification(
            (p for p in report.parameters if not p.name.startswith("wire ")),
            report.identification.robust.fit,
        ),
        note=who.note,
    )
    return ParameterSets(folder).save_draft(draft)


def write_identified_urdf(report: IdentifyReport, path: Path, *, geometric_joints: bool = False) -> list[str]:
    """Write the identified arm as a bare description; return what it cannot hold.

    Raises
    ------
    MeasurementError
        Nothing about the arm was identified.
    CalibrationError
        The arm couples joints, and ``geometric_joints`` was not asked for.
    """
    _refuse_frames(report)
    robot = parse_reference(report.robot)
    if robot.is_file and Path(robot.where).resolve() == path.resolve():
        raise MeasurementError(
            f"{path} is the description of the nominal robot that was identified.",
            remedy="Name another file for the identified one.",
        )
    state = report.identification.state
    replace_file(path, bare_urdf(state.arm_model, geometric_joints=geometric_joints), mode=SHARED_FILE)
    kinds = {"gravity": "sag", "harmonic": "ripple", "gear": "gear ratios"}
    return sorted({kinds[term.kind] for term in state.terms})


def refuse_saving(save: Path | None, urdf: Path | None, axes: Path | None) -> None:
    """Refuse, before any work, to keep an arm whose residual model would be lost.

    Raises
    ------
    MeasurementError
        A parameter set or a description was asked for.
    """
    paths = {"--save": save, "--urdf": urdf, "--project-axes": axes}
    options = [option for option, path in paths.items() if path is not None]
    if options:
        raise MeasurementError(
            f"a residual model cannot be kept by {' and '.join(options)}: parameter sets and descriptions hold the "
            "arm's parameters only, and `program compensate` works with these alone.",
            remedy="Leave out `--residual-model` to keep the arm, or leave out the other to see what it would gain.",
        )


def _refuse_frames(report: IdentifyReport) -> None:
    if report.level == FRAMES:
        raise MeasurementError(
            "no parameter of the arm predicts unseen rows better than its nominal one: there is nothing to save."
            if report.start == "nominal"
            else make_message(
                "no parameter of the arm predicts unseen rows better than {start}: that stays as it is.",
                start=report.start,
            ),
            remedy="Measure more postures and more exactly, or ask for a `--level`.",
        )
