"""Dry runs of the mastering procedures: the plans they would make, from what is known without a device."""

import math
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord, RecoveryKit, WireCapture
from cellcal.calibration.mastering.kit_design import KitPrediction, predict_kit_recovery
from cellcal.calibration.mastering.place_recovery import places_to_fit
from cellcal.calibration.mastering.pose_design import predict_turns
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.wires.reference import fit_wire_reference
from cellcal.drivers.interfaces import Condition, Counts, Identity, Joints, MasteringData, Readiness
from cellcal.procedures.accuracy_limits import MASTERING
from cellcal.procedures.forecast import (
    ANSWER_S,
    PERSON_S,
    SAMPLE_S,
    Forecast,
    Knowledge,
    PlannedPose,
    Prediction,
    missing_wire_setup,
)
from cellcal.procedures.motion.approach import OVERSHOOT_RAD
from cellcal.procedures.motion.lost_plans import index_travel, plan_first
from cellcal.procedures.motion.plans import MotionBounds, MotionPlan, plan_kit, wire_prior
from cellcal.procedures.motion.turn_uncertainty import first_uncertainty
from cellcal.procedures.motors import MotorState
from cellcal.procedures.recovery.kit_offers import KitOffer, KitOffers, design_offers
from cellcal.procedures.recovery.position_alarms import INDEX_TURNS
from cellcal.procedures.recovery.recovery_kit import KitSpec

ASSUMED_RATIO, ASSUMED_COUNTS = 100.0, 2**19  # where no record tells the gears
ASSUMED_TIP_M = (0.045, 0.02, 0.15)  # of a tool whose frame was not read yet
POWER_CYCLE_S = 120.0


def forecast_record(
    knowledge: Knowledge, room: MotionBounds, captures: tuple[int, int], how: tuple[KitSpec | None, int]
) -> Forecast:
    """Plan the captures of a record as the procedure would, from where the robot is assumed to stand.

    ``captures`` are poses and samples at each; ``how`` is an engineer's own kit of places, and the seed. The kits
    that could be recorded beside the lengths, or in their stead, are told with them.
    """
    (poses, samples), (kit, seed) = captures, how
    assumed = _assumption_texts(knowledge)
    state = state_of(knowledge)
    if state is None:
        return Forecast(0.0, assumed=assumed)
    plan = plan_kit(state, room, poses, seed)
    rehearsed = _rehearse_record(state, plan)
    moves_s = plan.moving_s + len(plan.poses_rad) * OVERSHOOT_RAD / plan.speed_rad_s
    capture_s = len(plan.poses_rad) * (3.0 * knowledge.limits.settle_s + samples * SAMPLE_S)
    return Forecast(
        duration_s=2.0 * ANSWER_S + moves_s + capture_s,
        poses=_label_poses(plan, "pose"),
        speed_rad_s=max(plan.speeds_rad_s),
        predictions=(
            _turn_prediction(rehearsed, np.array(plan.poses_rad)),
            _offset_prediction(rehearsed, np.array(plan.poses_rad)),
            *_kit_predictions(_design_offers(knowledge, room, kit, seed)),
        ),
        assumed=assumed,
        not_checked=plan.not_checked,
    )


def forecast_recovery(
    knowledge: Knowledge,
    room: MotionBounds,
    captures: tuple[int, int, int],
    samples: int,
    index_speed_rad_s: float,
) -> Forecast:
    """Plan the first captures after a loss; checks and final checks are counted at the same pace.

    ``captures`` are the first ones, those at check poses, and the final ones.
    """
    walk = forecast_walk(knowledge, room, (captures[0], sum(captures[1:])), samples)
    if knowledge.record is None or not walk.poses:
        return walk
    index_s = _index_time_s(knowledge, knowledge.record, room, index_speed_rad_s)
    return replace(walk, duration_s=walk.duration_s + index_s, assumed=(*walk.assumed, *_WAKING))


def forecast_walk(
    knowledge: Knowledge, room: MotionBounds, captures: tuple[int, int], samples: int
) -> Forecast:
    """Plan the first captures of an arm whose motors may be turns off, and count those that follow at the same pace.

    ``captures`` are the first ones, and those that follow.
    """
    record = knowledge.record
    state = state_of(knowledge)
    if record is None or record.wire is None or state is None:
        return Forecast(0.0, assumed=_assumption_texts(knowledge), lacks=missing_wire_setup(knowledge))
    first, later = captures
    here = _start_joints(record, knowledge.last_counts)
    doubt = first_uncertainty(room, len(here), is_measured=knowledge.last_counts is not None)
    plan = plan_first(record, state, room, here, first, doubt)
    share = (first + later) / max(len(plan.poses_rad), 1)
    backwards_s = (
        len(plan.poses_rad) * len(here) * OVERSHOOT_RAD / plan.speed_rad_s
    )  # every second axis, twice
    capture_s = (len(here) + 1) * knowledge.limits.settle_s + samples * SAMPLE_S
    walk_s = share * (plan.travel_rad / plan.speed_rad_s + backwards_s + len(plan.poses_rad) * capture_s)
    joints = np.array(plan.poses_rad)
    return Forecast(
        duration_s=walk_s + 4.0 * ANSWER_S,
        poses=_label_poses(plan, "capture"),
        speed_rad_s=plan.speed_rad_s,
        predictions=(_turn_prediction(record, joints), _offset_prediction(record, joints)),
        assumed=_assumption_texts(knowledge),
        not_checked=(*plan.not_checked, "check poses are chosen when the turns are known"),
    )


def forecast_place_recovery(knowledge: Knowledge, room: MotionBounds, index_speed_rad_s: float) -> Forecast:
    """Return which places of the record's kit would be found again after a loss, and what they would tell."""
    record = knowledge.record
    lacks = _missing_need_texts(knowledge)
    if record is None or record.kit is None or lacks:
        return Forecast(0.0, lacks=lacks)
    kit, fitted = record.kit, places_to_fit(record)
    kit_prediction = predict_kit_recovery(
        load_model(record.model), kit, (record.drive, record.counts_at_zero)
    )
    check_places = [place.place for place in kit.places if place.kind != "nest" and place.place not in fitted]
    visits = [
        *((f"place {k}", number) for k, number in enumerate(fitted, 1)),
        *((f"check place {k}", number) for k, number in enumerate(check_places, 1)),
        ("final place", check_places[-1] if check_places else fitted[-1]),
    ]
    by_hand = len(visits) + sum(place.kind == "nest" for place in kit.places)
    return Forecast(
        duration_s=_index_time_s(knowledge, record, room, index_speed_rad_s)
        + by_hand * PERSON_S
        + 3.0 * ANSWER_S,
        poses=tuple(PlannedPose(label, _posture_of(record, kit, number)) for label, number in visits),
        predictions=_place_predictions(kit_prediction),
        assumed=(
            *_WAKING,
            "a person finds each place again within a minute; the postures are those of the record",
            *(line for line in _assumption_texts(knowledge) if line.startswith("the robot stands")),
        ),
    )


_WAKING = ("the battery is exchanged and the power cycled within two minutes",)


def _missing_need_texts(knowledge: Knowledge) -> tuple[str, ...]:
    if knowledge.record is None:
        return ("a mastering record of this robot, taken before the loss",)
    if knowledge.record.kit is None:
        return ("a recovery kit in the record: touched points, a keyed seat or targets",)
    is_visible = any(place.kind in ("target", "nest") for place in knowledge.record.kit.places)
    if is_visible and knowledge.tracker is None:
        return ("the tracker that the record's targets were seen with",)
    return ()


def _index_time_s(
    knowledge: Knowledge, record: MasteringRecord, room: MotionBounds, index_speed_rad_s: float
) -> float:
    """Return how long it takes until every motor has passed its index."""
    here = _start_joints(record, knowledge.last_counts)
    doubt = first_uncertainty(room, len(here), is_measured=knowledge.last_counts is not None)
    speed = min(index_speed_rad_s, knowledge.limits.jog_speed_rad_s)
    return POWER_CYCLE_S + sum(map(abs, index_travel(record, here, INDEX_TURNS, room, doubt))) / speed


def _posture_of(record: MasteringRecord, kit: RecoveryKit, number: int) -> Joints:
    place = next(place for place in kit.places if place.place == number)
    joints = record.drive.to_joints(np.array(place.counts), np.array(record.counts_at_zero))
    return tuple(float(q) for q in joints)


def _place_predictions(kit_prediction: KitPrediction) -> tuple[Prediction, ...]:
    words = make_message(
        "the chance that all lost turns are found right with these places is "
        "{success_probability:.6f}; a wrong turn would show at {check_sigmas:.0f} deviations at "
        "the places for checking",
        success_probability=kit_prediction.success_probability,
        check_sigmas=kit_prediction.check_sigmas,
    )
    return (
        Prediction(
            "turns of the least known motor", 2.0 * max(kit_prediction.sigma_turns), "turn", sentence=words
        ),
        Prediction(
            "new zero of the least known axis, were every motor exchanged",
            max(kit_prediction.offset_u_rad),
            "rad",
            {name: limit.axis_rad for name, limit in MASTERING.items()},
        ),
    )


def forecast_places(knowledge: Knowledge, room: MotionBounds, own: KitSpec | None, seed: int) -> Forecast:
    """Design the kits as the procedure would; each is told with the error that it would leave."""
    if knowledge.model is None:
        return Forecast(0.0, assumed=_assumption_texts(knowledge))
    offers = _design_offers(knowledge, room, own, seed)
    minutes = offers.offers[0].duration_min if offers.offers else 0.0
    return Forecast(
        duration_s=60.0 * minutes + 2.0 * ANSWER_S,
        poses=tuple(
            PlannedPose(f"{offers.offers[0].name}, place {k}", pose)
            for k, pose in enumerate(offers.offers[0].postures_rad, 1)
        )
        if offers.offers
        else (),
        predictions=_kit_predictions(offers),
        assumed=(*(line for line in _assumption_texts(knowledge) if line.startswith("gears")), *_TIPS),
        lacks=() if offers.offers else offers.missing,
        not_checked=offers.missing,
    )


_TIPS = (
    "tips and targets are where the cell file has them; the controller's tool frame is looked at in the run",
)


def _design_offers(knowledge: Knowledge, room: MotionBounds, own: KitSpec | None, seed: int) -> KitOffers:
    assert knowledge.model is not None
    record = knowledge.record
    drive = _nominal_drive(knowledge.model) if record is None else record.drive
    zero = (0,) * knowledge.model.axis_count if record is None else record.counts_at_zero
    tool = knowledge.instruments.tool_tip_m or ASSUMED_TIP_M
    found = replace(knowledge.instruments, tool_tip_m=tool)
    return design_offers(knowledge.model.name, (drive, zero), found, room, (own, seed))


def _kit_predictions(offers: KitOffers) -> tuple[Prediction, ...]:
    """Return a line for each kit that could be recorded: what it would leave open of the least known axis."""
    limits = {name: limit.axis_rad for name, limit in MASTERING.items()}
    return tuple(
        Prediction(
            make_message("new zero of the least known axis, by kit '{offer_name}'", offer_name=offer.name),
            offer.widest_u_rad,
            "rad",
            limits,
            _offer_text(offer),
        )
        for offer in offers.offers
    )


def _offer_text(offer: KitOffer) -> str:
    offer_texts = [
        offer.words,
        make_message("about {duration_min:.0f} minutes by hand", duration_min=offer.duration_min),
        make_message(
            "whole turns would be found right with a chance of {success_probability:.6f}",
            success_probability=offer.outlook.success_probability,
        ),
        make_message(
            "check places show a wrong turn at {check_sigmas:.0f} deviations",
            check_sigmas=offer.outlook.check_sigmas,
        ),
        *(() if offer.is_strong else ("too weak, it would be refused",)),
    ]
    return join_messages("; ", offer_texts)


def _turn_prediction(record: MasteringRecord, joints: np.ndarray) -> Prediction:
    probability, sigmas = predict_turns(load_model(record.model), record, joints)
    words = make_message(
        "the chance that all lost turns are found right with these poses is {probability:.6f}",
        probability=probability,
    )
    return Prediction("turns of the least known motor", 2.0 * float(max(sigmas)), "turn", sentence=words)


def _offset_prediction(record: MasteringRecord, joints: np.ndarray) -> Prediction:
    _, sigmas = predict_turns(load_model(record.model), record, joints)
    per_turn = np.abs(np.diag(record.drive.radians_per_turn()))
    return Prediction(
        "new zero of the least known axis, were its motor exchanged",
        2.0 * float(np.max(sigmas * per_turn)),
        "rad",
        {name: limit.axis_rad for name, limit in MASTERING.items()},
    )


def _rehearse_record(state: MotorState, plan: MotionPlan) -> MasteringRecord:
    """Return the record that a robot without any error would give at the planned poses."""
    model, prior, zero = load_model(state.model), wire_prior(state), state.mastering.counts_at_zero
    joints = np.array(plan.poses_rad)
    tips = model.tip_positions(joints, np.array(prior.hook_in_flange_m))
    lengths = np.linalg.norm(tips - np.array(prior.anchor_in_base_m), axis=1) + prior.zero_m
    sigmas = np.full(len(lengths), state.gauge_sigma_m)
    counts = state.drive.to_counts(joints, np.array(zero))
    captures = tuple(
        WireCapture(tuple(int(c) for c in row), float(length), state.gauge_sigma_m)
        for row, length in zip(counts, lengths, strict=True)
    )
    wire = fit_wire_reference(model, joints, lengths, sigmas, prior)
    return MasteringRecord(
        robot_serial="",
        model=state.model,
        epoch=0,
        drive=state.drive,
        counts_at_zero=zero,
        reference_joints_rad=state.joints_rad,
        reference_counts=state.counts,
        captures=captures,
        wire=wire,
        prior=prior,
        taken_by="rehearsal",
        sha256="",
    )


def _label_poses(plan: MotionPlan, what: str) -> tuple[PlannedPose, ...]:
    return tuple(PlannedPose(f"{what} {k}", pose) for k, pose in enumerate(plan.poses_rad, 1))


def _start_joints(record: MasteringRecord, last_counts: Counts | None) -> Joints:
    if last_counts is None or len(last_counts) != len(record.counts_at_zero):
        return record.reference_joints_rad
    joints = record.drive.to_joints(np.array(last_counts), np.array(record.counts_at_zero))
    return tuple(float(q) for q in joints)


def _assumption_texts(knowledge: Knowledge) -> tuple[str, ...]:
    sentence = make_message(
        "a reading of the gauge takes {sample_s:g} s, an answer {answer_s:g} s",
        sample_s=SAMPLE_S,
        answer_s=ANSWER_S,
    )
    if knowledge.record is None:
        return (
            sentence,
            make_message(
                "gears of {assumed_ratio:g}:1: the true ones are read from the controller",
                assumed_ratio=ASSUMED_RATIO,
            ),
            "the robot stands with every joint at zero, or as near as its limits allow",
        )
    if knowledge.last_counts is None:
        return sentence, "the robot stands where its record was taken"
    return sentence, "the robot stands where it was last seen healthy"


def state_of(knowledge: Knowledge) -> MotorState | None:
    """Return what reading the motors would say, as far as it is known; None where too little is."""
    model, setup, gauge, record = knowledge.model, knowledge.gauge_setup, knowledge.gauge, knowledge.record
    if model is None or setup is None or gauge is None:
        return None
    drive = _nominal_drive(model) if record is None else record.drive
    zero = (0,) * model.axis_count if record is None else record.counts_at_zero
    here = (
        _middle_joints(model)
        if record is None or not record.is_measured
        else _start_joints(record, knowledge.last_counts)
    )
    return MotorState(
        identity=Identity("", model.name, "", ""),
        condition=Condition(Readiness.READY),
        model=model.name,
        counts=tuple(int(c) for c in drive.to_counts(np.array(here), np.array(zero))),
        joints_rad=here,
        mastering=MasteringData(zero, mastered=True),
        drive=drive,
        epoch=0,
        gauge_setup=setup,
        gauge_range_m=gauge.range_m,
        gauge_sigma_m=gauge.sigma_m,
        limits=replace(knowledge.limits),
    )


def _nominal_drive(model: RobotModel) -> DriveTrain:
    per_count = 2.0 * math.pi / ASSUMED_RATIO / ASSUMED_COUNTS
    rows = np.eye(model.axis_count) * per_count
    return DriveTrain(
        tuple(tuple(float(v) for v in row) for row in rows), (ASSUMED_COUNTS,) * model.axis_count
    )


def _middle_joints(model: RobotModel) -> Joints:
    margin = 0.1
    return tuple(float(v) for v in np.clip(0.0, model.lower_rad + margin, model.upper_rad - margin))
