"""A recovery without a draw-wire: places of the record's kit, found again by hand, tell the lost turns.

A person moves the arm, one axis at a time and at creep speed; this procedure asks, reads and judges, by the same
gate as with the wire.
"""

from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.counts import MasteringRecord, PlaceCapture, RecoveryKit, provisional_turns
from cellcal.calibration.mastering.place_recovery import places_to_fit, recover_from_places, verify_at_places
from cellcal.calibration.mastering.turn_recovery import TurnRecovery
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts, Instruction
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.motors import Motors
from cellcal.procedures.questions import ask_acceptance
from cellcal.procedures.recovery.recovery_result import (
    RecoveryEffort,
    RecoveryResult,
    correction_instruction,
    is_controller_right,
    refused_result,
    restored_result,
)
from cellcal.procedures.recovery.recovery_spec import (
    MasteringRecoverySpec,
    refuse_other_gears,
    refuse_unknown_axes,
)
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.steps.mastering import check_same_epoch, read_motors_alone
from cellcal.procedures.steps.place import PlaceKind, visit_place
from cellcal.procedures.steps.write import check_still_in_force, restore_mastering, write_mastering

SAME_JOINT_RAD = 1e-4
OLD_RECORD = (
    "The record is older than the robot's last mastering: take a new one. Nothing is to be recovered."
)


@dataclass
class _PlaceVisits:
    """The visits so far; rebuilt from the findings on every entry."""

    run: Run
    spec: MasteringRecoverySpec
    record: MasteringRecord
    kit: RecoveryKit
    nests: list[PlaceCapture] = field(default_factory=list)
    captures: list[PlaceCapture] = field(default_factory=list)
    checks: list[PlaceCapture] = field(default_factory=list)
    again: int = 0
    set_aside: list[str] = field(default_factory=list)

    async def visit_again(self, number: int, step: str) -> PlaceCapture:
        recorded_place = next(place for place in self.kit.places if place.place == number)
        what: tuple[PlaceKind, int, str] = (_kind_of(recorded_place), number, step)
        sigmas = (recorded_place.sigma_m, recorded_place.sigma_rad)
        return await self.run.step(step, visit_place, what, *sigmas, self.spec.tolerance_counts)

    def refused_error(self, recovery: TurnRecovery, reason: str, remedy: str, code: str) -> RefusalError:
        evidence = refused_result(self.record, recovery, self.make_effort(), reason)
        return RefusalError(
            make_message("nothing was written: {reason}", reason=reason),
            remedy=remedy,
            code=code,
            evidence=evidence,
        )

    def make_effort(self) -> RecoveryEffort:
        return RecoveryEffort(
            len(self.captures) + self.again, len(self.checks), self.again, 0.0, tuple(self.set_aside)
        )


async def recover_by_places(
    run: Run, spec: MasteringRecoverySpec, record: MasteringRecord, last_counts: Counts
) -> RecoveryResult:
    """Visit the places that tell most, judge, check at the others, write, and look at one again.

    Raises
    ------
    RefusalError
        The record has no kit; the gate does not hold; the places do not confirm it.
    """
    kit = record.kit
    if kit is None:
        raise RefusalError(
            "the record holds no recovery kit: no touched points, no keyed seat, no targets",
            code="procedure.no_kit",
            remedy="Recover with the draw-wire; then take a new record with a kit.",
        )
    motors = await run.step("read the motors alone", read_motors_alone)
    refuse_other_gears(record, motors.drive)
    refuse_unknown_axes(spec, len(motors.counts))
    await run.ensure("the encoders kept their position", check_same_epoch, motors.epoch)
    visits = _PlaceVisits(run, spec, record, kit)
    fitted = await run.solve("choose the places", places_to_fit, record)
    guess = provisional_turns(record.drive, last_counts, motors.counts)
    recovery = await _visit_until_decided(visits, fitted, guess)
    if is_controller_right(record, recovery, motors.mastering):
        reason = "the places agree with the mastering that the controller holds, and not with the record"
        raise visits.refused_error(recovery, reason, OLD_RECORD, "procedure.wrong_record")
    recovery = await _check_places(visits, fitted, recovery)
    await run.step("accept the correction", ask_acceptance, *_recovery_question(visits.record, recovery))
    written = await run.write("write the mastering", write_mastering, recovery.counts_at_zero)
    await run.ensure("the written mastering is in force", check_still_in_force, recovery.counts_at_zero)
    await _verify_place(visits, recovery, motors)
    return restored_result(record, recovery, visits.make_effort(), written, motors.epoch)


def judge_places(
    record: MasteringRecord,
    visited: tuple[PlaceCapture, ...],
    guess: tuple[int, ...],
    known_new: tuple[int, ...],
) -> TurnRecovery:
    """Find the lost turns from places visited again, or say what is missing."""
    if record.kit is None:
        raise CalibrationError("the record holds no recovery kit")
    return recover_from_places(record, record.kit, visited, provisional_turns=guess, replaced_axes=known_new)


def confirm_places(
    record: MasteringRecord, recovery: TurnRecovery, checks: tuple[PlaceCapture, ...]
) -> TurnRecovery:
    """Judge a recovery at places that were not fitted."""
    if record.kit is None:
        raise CalibrationError("the record holds no recovery kit")
    return verify_at_places(record, record.kit, recovery, checks)


async def _visit_until_decided(
    visits: _PlaceVisits, fitted: tuple[int, ...], guess: tuple[int, ...]
) -> TurnRecovery:
    run, spec = visits.run, visits.spec
    for number in _nest_numbers(visits.kit):
        visits.nests.append(await visits.visit_again(number, f"nest {number + 1}"))
    for k, number in enumerate(fitted, 1):
        visits.captures.append(await visits.visit_again(number, f"place {k}"))
    known_new = tuple(axis - 1 for axis in spec.exchanged_axes)
    while True:
        name = f"judge the places {visits.again + 1}"
        recovery = await run.solve(
            name, judge_places, visits.record, (*visits.nests, *visits.captures), guess, known_new
        )
        if recovery.accepted:
            return recovery
        suspect = recovery.suspect_capture
        if suspect is None or visits.again >= spec.visits_again:
            remedy = "Look at tip, places and instrument: nothing may have moved. Else use the draw-wire."
            code = "procedure.geometry_changed" if recovery.mode == "geometry" else "procedure.undecided"
            raise visits.refused_error(recovery, recovery.reason, remedy, code)
        visits.again += 1
        doubtful = visits.captures[suspect]
        visits.set_aside.append(doubtful.label)
        visits.captures[suspect] = await visits.visit_again(doubtful.place, f"place again {visits.again}")


async def _check_places(
    visits: _PlaceVisits, fitted: tuple[int, ...], recovery: TurnRecovery
) -> TurnRecovery:
    """Visit the places that were not fitted: a wrong turn of any motor would show there."""
    rest = [place.place for place in visits.kit.places if place.kind != "nest" and place.place not in fitted]
    for k, number in enumerate(rest, 1):
        visits.checks.append(await visits.visit_again(number, f"check place {k}"))
    if not rest:
        remedy = "Take a new record with at least two places more than are fitted; until then use the marks."
        raise visits.refused_error(
            recovery, "no place is left for checking", remedy, "procedure.not_confirmed"
        )
    checks = (*visits.nests, *visits.checks)
    verified = await visits.run.solve(
        "confirm at the places", confirm_places, visits.record, recovery, checks
    )
    if not verified.accepted:
        remedy = "Look at tip and places, then start the recovery again."
        raise visits.refused_error(verified, verified.reason, remedy, "procedure.not_confirmed")
    return verified


async def _verify_place(visits: _PlaceVisits, recovery: TurnRecovery, motors: Motors) -> None:
    """Visit one place with the written mastering: the controller must show the joints that the record has there."""
    run, last = visits.run, visits.checks[-1]
    again = await visits.visit_again(last.place, "final place")
    shown = await run.step("read the motors after writing", read_motors_alone)
    final = await run.solve(
        "confirm the written mastering", confirm_places, visits.record, recovery, (*visits.nests, again)
    )
    drive, zero = visits.record.drive, recovery.counts_at_zero
    apart = abs(drive.to_joints(np.array(shown.counts), np.array(zero)) - np.array(shown.joints_rad)).max()
    agrees = all(check.passed for check in final.gate if check.name == "verification")
    if not agrees or apart > SAME_JOINT_RAD:
        await run.write("put the old mastering back", restore_mastering, motors.mastering)
        reason = "with the new mastering the place is not where it was; the old data were put back"
        remedy = "The robot is not mastered, as before. Start the recovery again."
        raise visits.refused_error(final, reason, remedy, "procedure.not_confirmed")


def _recovery_question(record: MasteringRecord, recovery: TurnRecovery) -> tuple[Instruction, str]:
    return correction_instruction(recovery, record), sha256_of(list(recovery.counts_at_zero))


def _nest_numbers(kit: RecoveryKit) -> tuple[int, ...]:
    return tuple(place.place for place in kit.places if place.kind == "nest")


def _kind_of(place: PlaceCapture) -> PlaceKind:
    kinds: dict[str, PlaceKind] = {"point": "point", "seat": "seat", "target": "target", "nest": "nest"}
    return kinds[place.kind]
