"""A mastering record without a draw-wire: which kit of places is best here, and the places one by one.

Every kit that the cell has the means for is designed and shown side by side with the error that a recovery would be
left with; a person chooses, brings the tool to the places, and a kit that turns out too weak gets further places.
"""

from dataclasses import dataclass, replace

from pydantic_core import to_jsonable_python

from cellcal.calibration.mastering.counts import MasteringRecord, RecoveryKit
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.procedure_definition import Phase
from cellcal.procedures.questions import ask_acceptance
from cellcal.procedures.recovery.kit_offers import (
    KitOffer,
    KitOffers,
    offers_at,
    offers_text,
    one_more_posture,
)
from cellcal.procedures.recovery.recovery_kit import (
    KitProspect,
    KitSpec,
    kit_places,
    kit_prospect,
    refuse_weak,
    visit_near,
)
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.steps.kit_bench import KitBench, choose_kit
from cellcal.procedures.steps.place import PlaceKind

MOST_FURTHER = 4
MOST_SIGMA_TURNS = 1.0


@dataclass(frozen=True, slots=True)
class RecordedPlaces:
    """The kit as recorded, what it promises, and what it was chosen from."""

    record: MasteringRecord
    prospect: KitProspect
    chosen: KitOffer
    offers: KitOffers
    visits: int


async def record_places(
    run: Run, bench: KitBench, blank: MasteringRecord, how: tuple[KitSpec | None, MotionBounds, int]
) -> RecordedPlaces:
    """Choose a kit, have its places visited, and see that a recovery would be decided and confirmed by them.

    ``blank`` is the record without a kit; ``how`` is an engineer's own kit, the room, and the seed of the design.

    Raises
    ------
    RefusalError
        The cell offers no kit; the places are too weak even with further ones.
    """
    own, room, seed = how
    offers = await run.solve("compare the kits", offers_at, bench, room, own, seed)
    chosen = await _choose_kit(run, offers, own)
    if max(chosen.outlook.sigma_turns) > MOST_SIGMA_TURNS:  # no number of places would help
        kit_prediction = chosen.outlook
        refuse_weak(
            bench.model,
            KitProspect(
                kit_prediction.success_probability,
                kit_prediction.sigma_turns,
                kit_prediction.fitted,
                kit_prediction,
            ),
        )
    visits = []
    postures = _with_nests(chosen)
    for k, (what, near) in enumerate(zip(kit_places(chosen.spec), postures, strict=True), 1):
        visits.append(await visit_near(run, chosen.spec, k, what, near))
    further = 0
    while True:
        kit = RecoveryKit(chosen.spec.tip_in_flange_m, tuple(visits), chosen.spec.sigma_tip_m)
        record = replace(blank, kit=kit)
        prospect = await run.solve(f"predict a recovery by places {further + 1}", kit_prospect, record)
        if prospect.is_strong or further >= MOST_FURTHER:
            break
        further += 1
        near = await run.solve(
            f"choose one more place {further}", one_more_posture, bench, room, chosen.spec, kit, seed
        )
        visits.append(
            await visit_near(run, chosen.spec, len(visits) + 1, _another_place(chosen, len(visits)), near)
        )
    refuse_weak(bench.model, prospect)
    return RecordedPlaces(record, prospect, chosen, offers, len(visits))


def place_phases(own: KitSpec | None) -> tuple[Phase, ...]:
    """Return the steps of a record by places for the outline."""
    count = len(kit_places(own)) if own is not None else 9
    return (
        *(Phase("look at the instruments"), Phase("compare the kits")),
        *(Phase("choose the kit"), Phase("place", count, adaptive=True)),
        *(
            Phase("predict a recovery by places", 1, adaptive=True),
            Phase("choose one more place", 0, adaptive=True),
        ),
    )


async def _choose_kit(run: Run, offers: KitOffers, own: KitSpec | None) -> KitOffer:
    if not offers.offers:
        raise RefusalError(
            make_message(
                "this cell offers no kit of places: {missing}", missing=join_messages("; ", offers.missing)
            ),
            code="procedure.no_kit",
            remedy="Do one of these, then start a new run; or record with a draw-wire.",
            evidence=offers,
        )
    table = offers_text(offers)
    if own is not None:
        question = Instruction(
            "use_kit", f"What this kit would leave open after a loss:\n{table}\nRecord its places?"
        )
        await run.step("choose the kit", ask_acceptance, question, sha256_of(to_jsonable_python(offers)))
        return offers.offers[0]
    text = (
        f"Which places shall be recorded, so that a lost zero is found again? The smallest error first:\n{table}\n"
        f"Type a name; nothing is {offers.offers[0].name}."
    )
    names = tuple(offer.name for offer in offers.offers)
    answer = await run.step("choose the kit", choose_kit, text, names)
    found = offers.offer_named(answer.kit)
    assert found is not None  # the step returns one of the names
    return found


def _with_nests(chosen: KitOffer) -> tuple[Joints | None, ...]:
    nests = len(kit_places(chosen.spec)) - len(chosen.postures_rad)
    return (*(None,) * nests, *chosen.postures_rad)


def _another_place(chosen: KitOffer, number: int) -> tuple[PlaceKind, int, str]:
    kind: PlaceKind = "point" if chosen.spec.kind == "seat" else chosen.spec.kind
    return (kind, number, f"place {number + 1}")
