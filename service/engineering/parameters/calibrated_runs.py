"""From a kept robot calibration to a version of the robot's parameter set, for `cellcal parameters keep`."""

from dataclasses import replace

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.calibrated_arm import CalibratedArm
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256, values_of_identification
from cellcal.service.engineering.parameters.parameter_files import SetOrigin
from cellcal.service.engineering.parameters.parameter_set import (
    ParameterSet,
    ParameterSetError,
    ParameterValue,
)
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore


def save_calibration(
    config: CellConfig, robot: str | None, sets: ParameterSets, who: str, made_at: str
) -> ParameterSet:
    """Save what the robot's newest calibration found as its next version.

    Raises
    ------
    ParameterSetError
        No calibration of this robot was kept, or the newest is saved already.
    """
    serial = config.robot_named(robot).serial
    with open_journal(config) as journal:
        arm = RunStore(journal).calibrated_arm(serial)
    if arm is None:
        raise ParameterSetError(
            make_message("no calibration of robot {serial} was kept.", serial=serial),
            remedy="Run `cellcal run robot_calibration` first.",
            code="usage",
        )
    draft = draft_of(arm, SetOrigin(serial, who, made_at))
    if serial in sets.robot_serials() and sets.load_set(serial).source == draft.source:
        raise ParameterSetError(
            make_message(
                "the newest calibration of robot {serial} is version {version} already.",
                serial=serial,
                version=sets.load_set(serial).version,
            ),
            code="usage",
        )
    return sets.save_draft(draft)


def draft_of(arm: CalibratedArm, who: SetOrigin) -> ParameterSet:
    """Return a kept calibration as a parameter set that has no version yet."""
    nominal = load_model(arm.model)
    return ParameterSet(
        robot_serial=who.robot_serial,
        model=arm.model,
        nominal_sha256=nominal_sha256(nominal),
        made_at=who.made_at,
        made_by=who.made_by,
        source=make_message(
            "robot_calibration with {device}, sha256 {sha256}", device=arm.device, sha256=arm.sha256
        ),
        values=_with_correlations(values_of_identification(arm.parameters), arm.correlations),
        note="for the mastering that the robot had then" if arm.counts_at_zero else "",
    )


def _with_correlations(
    values: tuple[ParameterValue, ...], correlations: tuple[tuple[float, ...], ...]
) -> tuple[ParameterValue, ...]:
    """Return values with their correlations, without which the uncertainty of a point cannot be computed."""
    if not correlations:
        return values
    return tuple(replace(value, correlations=rho) for value, rho in zip(values, correlations, strict=True))
