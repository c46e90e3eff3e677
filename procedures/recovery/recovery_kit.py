"""The recovery kit of a mastering record: places that tell lost turns again where there is no draw-wire."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import MasteringRecord, PlaceCapture, RecoveryKit
from cellcal.calibration.mastering.kit_design import KitPrediction, predict_kit_recovery
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.procedure_definition import Phase
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.setting_texts import TOLERANCE_COUNTS, describe_setting
from cellcal.procedures.steps.place import PlaceKind, visit_place

GOOD_PROBABILITY = 0.9999
GOOD_SIGMAS = 6.0  # at which the places kept for checking must show any wrong turn
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class KitSpec:
    """Places to record beside the lengths, so that a recovery needs no draw-wire."""

    kind: Annotated[
        Literal["point", "seat", "target"],
        describe_setting(
            "Kind of places",
            "What the arm comes back to after a loss.",
            "tool",
            choices={
                "point": "points touched with a pointer",
                "seat": "a seat the flange is set on",
                "target": "targets of an instrument",
            },
        ),
    ]
    tip_in_flange_m: Annotated[
        Triple,
        describe_setting(
            "Tip or target, seen from the flange",
            "Where the touching tip or the target is from the flange; it must be the same after a loss.",
            "tool",
            unit="m",
            drawing="tip",
        ),
    ]
    places: Annotated[
        int,
        Field(ge=1, le=40),
        describe_setting(
            "Number of places",
            "How many points or targets are recorded; three of them are for checking.",
            "effort",
            unit="1",
        ),
    ] = 9
    check_points: Annotated[
        int,
        Field(ge=2, le=10),
        describe_setting(
            "Points touched beside a seat",
            "So many points beside the seat check that it was not moved.",
            "effort",
            unit="1",
        ),
    ] = 2
    nests: Annotated[
        int,
        Field(ge=3, le=20),
        describe_setting(
            "Fixed targets in the hall",
            "Targets by which an instrument finds its place when it stands elsewhere.",
            "effort",
            unit="1",
        ),
    ] = 4
    sigma_m: Annotated[
        float,
        Field(gt=0, le=0.005),
        describe_setting(
            "Spread of one place",
            "How much a touch, seat or target scatters in one axis (standard deviation).",
            "doubt",
            unit="m",
        ),
    ] = 2e-4
    sigma_rad: Annotated[
        float,
        Field(gt=0, le=0.01),
        describe_setting(
            "Spread of a seat's angle",
            "How much the flange turns between two sittings (standard deviation).",
            "doubt",
            unit="rad",
        ),
    ] = 3.5e-4
    tolerance_counts: Annotated[int, Field(ge=0), TOLERANCE_COUNTS] = 50
    sigma_tip_m: Annotated[
        float,
        Field(gt=0, le=0.02),
        describe_setting(
            "How well the tip is known",
            "Standard deviation of the tip's place from the flange in one axis.",
            "doubt",
            unit="m",
        ),
    ] = 0.001


@dataclass(frozen=True, slots=True)
class KitProspect:
    """The predicted result of visiting the best places of the kit again, and checking at the others."""

    success_probability: float
    sigma_turns: tuple[float, ...]
    places: int
    outlook: KitPrediction | None = None  # None in results older than it

    @property
    def is_strong(self) -> bool:
        """Whether a recovery would be decided and confirmed by these places."""
        return self.outlook is not None and is_strong(self.outlook)


def is_strong(kit_prediction: KitPrediction) -> bool:
    """Return whether places tell all motors, let a mistake be noticed, and would show any wrong turn when checked."""
    return (
        kit_prediction.success_probability >= GOOD_PROBABILITY
        and kit_prediction.check_sigmas >= GOOD_SIGMAS
        and kit_prediction.is_checkable
    )


async def recorded_kit(run: Run, spec: KitSpec | None) -> RecoveryKit | None:
    """Have every point of the kit visited; their coordinates are not needed."""
    if spec is None:
        return None
    visits = [await visit_near(run, spec, k, what) for k, what in enumerate(kit_places(spec), 1)]
    return RecoveryKit(spec.tip_in_flange_m, tuple(visits), spec.sigma_tip_m)


async def visit_near(
    run: Run, spec: KitSpec, step: int, what: tuple[PlaceKind, int, str], near_rad: Joints | None = None
) -> PlaceCapture:
    """Have one place visited, near the posture that was chosen for it where there is one."""
    how = (spec.sigma_m, spec.sigma_rad, spec.tolerance_counts)
    return await run.step(f"place {step}", visit_place, what, *how, near_rad)


def kit_places(spec: KitSpec) -> tuple[tuple[PlaceKind, int, str], ...]:
    """Return kind, number and label of the places to visit, in order."""
    arm: list[PlaceKind] = [spec.kind] * spec.places
    if spec.kind == "seat":
        arm = ["seat"]
        arm += ["point"] * spec.check_points
    nests: list[PlaceKind] = ["nest"] * spec.nests if spec.kind == "target" else []
    return tuple((kind, k, f"place {k + 1}") for k, kind in enumerate([*nests, *arm]))


def kit_prospect(record: MasteringRecord) -> KitProspect:
    """Say how surely lost turns would be found by visiting the places of a record's kit again.

    Raises
    ------
    RefusalError
        The record has no kit.
    """
    if record.kit is None:
        raise RefusalError("the record holds no recovery kit", code="procedure.no_kit")
    kit_prediction = predict_kit_recovery(
        load_model(record.model), record.kit, (record.drive, record.counts_at_zero)
    )
    return KitProspect(
        kit_prediction.success_probability, kit_prediction.sigma_turns, kit_prediction.fitted, kit_prediction
    )


def predict_kit(record: MasteringRecord) -> KitProspect:
    """Say what ``kit_prospect`` says; refuse a weak kit while the robot is healthy.

    Raises
    ------
    RefusalError
        The kit would not tell all motors, or the places kept for checking would not show a wrong turn.
    """
    found = kit_prospect(record)
    refuse_weak(record.model, found)
    return found


def refuse_weak(model_name: str, found: KitProspect) -> None:
    """Refuse a kit that a recovery would not be decided or confirmed with."""
    names, kit_prediction = load_model(model_name).joint_names, found.outlook
    if kit_prediction is None or kit_prediction.success_probability < GOOD_PROBABILITY:
        weakest = names[int(np.argmax(found.sigma_turns))]
        raise RefusalError(
            make_message(
                "these places would leave the motor of {weakest} open to {sigma_turns:.1f} turns",
                weakest=weakest,
                sigma_turns=max(found.sigma_turns),
            ),
            code="procedure.weak_kit",
            remedy="Choose places farther apart, with the tip farther from the last axis and the wrist bent by "
            "more than 40 degrees, then start a new run.",
        )
    if not is_strong(kit_prediction):
        raise RefusalError(
            make_message(
                "{fitted} places to fit and {checked} for checking are too little: a wrong turn would "
                "show at {check_sigmas:.1f} deviations, {good_sigmas:g} are needed; {spare} figures to "
                "spare",
                fitted=kit_prediction.fitted,
                checked=kit_prediction.checked,
                check_sigmas=kit_prediction.check_sigmas,
                good_sigmas=GOOD_SIGMAS,
                spare=max(kit_prediction.spare, 0),
            ),
            code="procedure.weak_kit",
            remedy="Record more places, with the tip farther from the last axis, then start a new run.",
        )


def kit_phases(spec: KitSpec | None) -> tuple[Phase, ...]:
    """Return the steps of a kit for the outline."""
    if spec is None:
        return ()
    return (Phase("place", len(kit_places(spec))), Phase("predict a recovery by places"))
