"""Measurements that fit no known way: whether a joint moved that the robot's description has as fixed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cellcal.calibration.arm.model_references import ModelReference, parse_reference
from cellcal.calibration.arm.shown_names import shown_name
from cellcal.calibration.arm.urdf_fixed_joints import FreedJoint, freed_joints
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitError
from cellcal.calibration.identification.misfit_fit import fit_quickly, motion_of
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.measurements import ReadOptions, read_measurements

_MOST_ROWS = 80
_FITS, _FITS_M = 0.004, 2e-3  # of the motion: a nominal arm with its mastering fitted leaves less
_LESS_LIKELY = (("column",), ("model",))  # than a joint of the description: a column's track, another robot
_MOVES = {"revolute": "turns", "prismatic": "slides"}


@contextmanager
def naming_fixed_joints(path: Path, robot: str, read: ReadOptions) -> Iterator[None]:
    """Let a refusal of rows that fit no known way name the joint that must move for them to fit.

    Parameters
    ----------
    path : Path
        The measurements.
    robot : str
        The reference of the robot; only descriptions have fixed joints.
    read : ReadOptions
        How the measurements are read.
    """
    try:
        yield
    except MisfitError as refused:
        raise _name_fixed_joint(refused, path, robot, read) from refused


def _name_fixed_joint(refused: MisfitError, path: Path, robot: str, read: ReadOptions) -> MisfitError:
    """Return the refusal; as it was where it names a likelier cause, or where no fixed joint explains the rows."""
    reference = parse_reference(robot)
    is_known = any(cause.kinds not in _LESS_LIKELY for cause in refused.causes)
    if is_known or not reference.is_description:
        return refused
    for freed, left_m in _fitting_joints(path, reference, read):
        says = f"joint {freed.joint} {_MOVES[freed.kind]}, which the description has as fixed"
        cure = f"Write joint {freed.joint} as {freed.kind} with its limits, and see that its column is in the file."
        return MisfitError(
            make_message(
                "the measurements fit {model_name} only if {says}: {left_mm:.2f} mm remain.",
                model_name=shown_name(robot),
                says=says,
                left_mm=left_m * 1000.0,
            ),
            remedy=make_message("{remedy} Nothing was stored.", remedy=cure),
            causes=(MisfitCause(("fixed",), says, cure, left_m),),
        )
    return refused


def _fitting_joints(
    path: Path, reference: ModelReference, read: ReadOptions
) -> list[tuple[FreedJoint, float]]:
    """Return the fixed joints with which the rows fit, and what is then left [m], the best first."""
    found = []
    text = read_plain_text(Path(reference.where))
    for freed in freed_joints(text, base_link=reference.base, tip_link=reference.tip):
        try:
            observations = read_measurements(path, freed.model, read).observations
        except CellError:  # the file has no column for it
            continue
        some = observations.select_rows(spread_rows(len(observations), _MOST_ROWS))
        left_m = fit_quickly(freed.model, some).score_m
        if left_m <= max(_FITS * motion_of(freed.model, some), _FITS_M):
            found.append((freed, left_m))
    return sorted(found, key=lambda each: each[1])
