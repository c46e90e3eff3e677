"""What an identification leaves behind: a parameter set of the robot, and a calibrated description."""

import hashlib
from pathlib import Path

from calibration.arm.urdf import bare_urdf
from calibration.documents.plain_files import read_plain_bytes
from calibration.identification.parameters import FRAMES
from service.identification.identify import IdentifyReport
from service.measured.table import MeasurementError
from service.parameters.calibrated_models import nominal_sha256, values_of_identification
from service.parameters.parameter_files import Who
from service.parameters.parameter_sets import ParameterSet, ParameterSets


def save_identification(report: IdentifyReport, measurements: Path, folder: Path, who: Who) -> ParameterSet:
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
        source=f"identification: {measurements.name}, sha256 {digest}",
        # Zero and scale belong to the wire, not to the arm.
        values=values_of_identification(
            (p for p in report.parameters if not p.name.startswith("wire ")),
            report.identification.robust.fit,
        ),
        note=who.note,
    )
    return ParameterSets(folder).save(draft)


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
    state = report.identification.state
    path.write_text(bare_urdf(state.arm, geometric_joints=geometric_joints), encoding="utf-8")
    kinds = {"gravity": "sag", "harmonic": "ripple", "gear": "gear ratios"}
    return sorted({kinds[term.kind] for term in state.terms})


def _refuse_frames(report: IdentifyReport) -> None:
    if report.level == FRAMES:
        raise MeasurementError(
            "no parameter of the arm predicts unseen rows better than its nominal one: there is nothing to save.",
            remedy="Measure more postures and more exactly, or ask for a `--level`.",
        )
