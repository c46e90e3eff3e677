"""The recovery kit of a mastering record: places that tell lost turns again where there is no draw-wire."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from calibration.arm.kinematics import load_model
from calibration.mastering.counts import MasteringRecord, RecoveryKit
from calibration.mastering.place_recovery import places_to_fit, predict_places
from procedures.entry import Phase
from procedures.run import RefusalError, Run
from procedures.steps.place import PlaceKind, visit_place

GOOD_PROBABILITY = 0.9999
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class KitSpec:
    """Places to record beside the lengths, so that a recovery needs no draw-wire."""

    kind: Literal["point", "seat", "target"]
    tip_in_flange_m: Triple  # touching tip, or the instrument's target; it must be the same after a loss
    places: Annotated[int, Field(ge=1, le=40)] = 9  # of points or targets, three of them for checking
    check_points: Annotated[int, Field(ge=2, le=10)] = 2  # touched beside a seat
    nests: Annotated[int, Field(ge=3, le=20)] = (
        4  # fixed targets, for an instrument that will stand elsewhere
    )
    sigma_m: Annotated[float, Field(gt=0, le=0.005)] = 2e-4  # of one touch, seat or target
    sigma_rad: Annotated[float, Field(gt=0, le=0.01)] = 3.5e-4  # of a seat
    tolerance_counts: Annotated[int, Field(ge=0)] = 50
    sigma_tip_m: Annotated[float, Field(gt=0, le=0.02)] = 0.001


@dataclass(frozen=True, slots=True)
class KitProspect:
    """What a recovery could reach by visiting the best places of the kit again."""

    success_probability: float
    sigma_turns: tuple[float, ...]
    places: int


async def recorded_kit(run: Run, spec: KitSpec | None) -> RecoveryKit | None:
    """Have every place of the kit visited; their coordinates are nobody's business."""
    if spec is None:
        return None
    visits = [
        await run.step(f"place {k}", visit_place, what, spec.sigma_m, spec.sigma_rad, spec.tolerance_counts)
        for k, what in enumerate(kit_places(spec), 1)
    ]
    return RecoveryKit(spec.tip_in_flange_m, tuple(visits), spec.sigma_tip_m)


def kit_places(spec: KitSpec) -> tuple[tuple[PlaceKind, int, str], ...]:
    """Return kind, number and label of the places to visit, in order."""
    arm: list[PlaceKind] = [spec.kind] * spec.places
    if spec.kind == "seat":
        arm = ["seat"]
        arm += ["point"] * spec.check_points
    nests: list[PlaceKind] = ["nest"] * spec.nests if spec.kind == "target" else []
    return tuple((kind, k, f"place {k + 1}") for k, kind in enumerate([*nests, *arm]))


def predict_kit(record: MasteringRecord) -> KitProspect:
    """Say how surely lost turns would be found by visiting the best places of the kit again; refuse a weak kit.

    Raises
    ------
    RefusalError
        The kit would not tell all motors.
    """
    model, kit = load_model(record.model), record.kit
    if kit is None:
        raise RefusalError("the record holds no recovery kit", code="procedure.no_kit")
    fitted = places_to_fit(record)
    probability, sigmas = predict_places(model, kit, (record.drive, record.counts_at_zero), fitted)
    if probability < GOOD_PROBABILITY:
        weakest = model.joint_names[int(np.argmax(sigmas))]
        raise RefusalError(
            f"these places would leave the motor of {weakest} open to {max(sigmas):.1f} turns",
            code="procedure.weak_kit",
            remedy="Choose places farther apart, with the tip farther from the last axis and the wrist bent by "
            "more than 40 degrees, then start a new run.",
        )
    return KitProspect(probability, tuple(float(s) for s in sigmas), len(fitted))


def kit_phases(spec: KitSpec | None) -> tuple[Phase, ...]:
    """Return the steps of a kit for the outline."""
    if spec is None:
        return ()
    return (Phase("place", len(kit_places(spec))), Phase("predict a recovery by places"))
