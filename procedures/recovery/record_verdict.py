"""What a mastering record promises: how surely a recovery would find lost turns with it."""

from dataclasses import dataclass

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.calibration.uncertainty import chi_square_limit
from cellcal.procedures.recovery.kit_offers import KitOffers
from cellcal.procedures.recovery.recovery_kit import (
    GOOD_PROBABILITY,
    GOOD_SIGMAS,
    KitProspect,
)
from cellcal.procedures.refit import (
    MEASURED_AGAIN,
)
from cellcal.procedures.verdict import (
    ProcedureVerdict,
    SetAside,
    chance_rule,
    chi_square_rule,
    state_evidence,
    state_fact,
    state_figure,
)


@dataclass(frozen=True, slots=True)
class RecoveryProspect:
    """The predicted result of a recovery with this record."""

    success_probability: float
    sigma_turns: tuple[float, ...]
    captures: int


@dataclass(frozen=True, slots=True)
class RecordResult:
    """The record, and what it promises."""

    record: MasteringRecord
    prospect: RecoveryProspect
    kit: KitProspect | None = None  # what its places promise, where it has any
    set_aside: tuple[str, ...] = ()  # captures that the others contradicted; measured again
    offers: KitOffers | None = None  # what its places were chosen from


def verdict_on_record(result: RecordResult) -> ProcedureVerdict:
    """Say whether the lengths agree, and how surely a recovery would find lost turns with them."""
    if result.record.wire is None:
        return _verdict_on_places(result)
    (wire, _), prospect = result.record.wire_lengths(), result.prospect
    agree = state_fact(
        "the lengths agree with each other",
        wire.is_consistent(),
        chi_square_rule("chi square at most its 99.9 % limit, and no capture stands out"),
        found=wire.chi_square,
        limit=chi_square_limit(wire.degrees_of_freedom),
    )
    finds = state_evidence(
        "chance that all lost turns would be found",
        prospect.success_probability >= GOOD_PROBABILITY,
        chance_rule(
            make_message(
                "PASS if at least {good_probability:g}, else UNDECIDED: record more poses",
                good_probability=GOOD_PROBABILITY,
            )
        ),
        found=prospect.success_probability,
        limit=GOOD_PROBABILITY,
    )
    weakest, words = max(prospect.sigma_turns), "predicted from the record"
    return ProcedureVerdict(
        (
            *(agree, finds),
            state_figure("deviation of the least known motor, were it lost", weakest, "turn", rule=words),
            state_figure("RMS of the lengths about the fit", wire.residual_rms_m, "m", rule="no accuracy"),
        ),
        limits_from="fixed limits of the procedure",
        not_verified=(
            "The mastering itself was not checked: the record keeps it as it was found.",
            "The accuracy of the robot was not measured.",
        ),
        remarks=(
            "Take a new record after a motor, encoder, belt or gear was exchanged.",
            "The number of poses is fixed by the settings, their places by design: nothing to save.",
        ),
        set_aside=tuple(SetAside(step, MEASURED_AGAIN) for step in result.set_aside),
    )


def _verdict_on_places(result: RecordResult) -> ProcedureVerdict:
    """Say how surely a recovery would find lost turns at the places, and how well a lost zero."""
    assert result.kit is not None  # a record without lengths has places
    assert result.kit.outlook is not None
    kit = result.kit.outlook
    finds = state_evidence(
        "chance that all lost turns would be found",
        kit.success_probability >= GOOD_PROBABILITY,
        chance_rule(
            make_message(
                "PASS if at least {good_probability:g}, else UNDECIDED: record more places",
                good_probability=GOOD_PROBABILITY,
            )
        ),
        found=kit.success_probability,
        limit=GOOD_PROBABILITY,
    )
    shows = state_evidence(
        "the places kept for checking would show any wrong turn",
        kit.check_sigmas >= GOOD_SIGMAS,
        make_message(
            "PASS if at {good_sigmas:g} deviations or more, else UNDECIDED: record more places",
            good_sigmas=GOOD_SIGMAS,
        ),
        found=kit.check_sigmas,
        limit=GOOD_SIGMAS,
    )
    words, names = "predicted from the places", load_model(result.record.model).joint_names
    zeros = [
        state_figure(
            make_message("{name}: U of its zero (k=2), were its reference lost", name=name),
            u,
            "rad",
            rule=words,
        )
        for name, u in zip(names, kit.offset_u_rad, strict=True)
    ]
    weakest = state_figure(
        "deviation of the least known motor, were it lost", max(kit.sigma_turns), "turn", rule=words
    )
    return ProcedureVerdict(
        (finds, shows, weakest, *zeros),
        limits_from="fixed limits of the procedure",
        not_verified=(
            "The mastering itself was not checked: the record keeps it as it was found.",
            "The accuracy of the robot was not measured.",
            "Whether the places stay where they are: look after marks, seat and nests.",
        ),
        remarks=(
            "Take a new record after a motor, encoder, belt or gear was exchanged, or the tip.",
            "The number of places is fixed by the kit, further ones by what it lacks: nothing to save.",
        ),
    )
