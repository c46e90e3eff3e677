"""The kits that a cell could record, side by side: what each would leave open, known before anything fails."""

import math
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.mastering.counts import DriveTrain, RecoveryKit
from cellcal.calibration.mastering.kit_design import KitPlan, KitPrediction, design_kit, predict_kit_recovery
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts, Joints
from cellcal.procedures.arm.arm_motion import MotionSpace, draw_poses
from cellcal.procedures.forecast import PERSON_S
from cellcal.procedures.instruments import Instruments
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.recovery.recovery_kit import KitSpec, is_strong, kit_places
from cellcal.procedures.steps.kit_bench import KitBench

Triple = tuple[float, float, float]
CANDIDATES = 60
HAND_SIGMA_M = (
    1.5e-4  # of a ball in a punch mark or cone, brought there at creep speed until the probe signals
)
PIN_SIGMA_M = 3e-4  # of a pointed tip over a mark, or a pin in a hole, by eye
SEAT_SIGMA_M, SEAT_SIGMA_RAD = 1e-4, 3.5e-4
MAST_SIGMA_M = 5e-5  # of a reflector put into its nest again
TOOL_SIGMA_M = 0.002  # of a tool frame that was typed in
OWN_SIGMA_M = 0.001
_LOWEST_WRIST_RAD = (
    0.6  # a straight wrist tells two of its axes apart badly, and a person finds it hard to reach
)
_TIP_DOWN = -0.3  # of the tool's axis along the base's z: a mark stands on something


@dataclass(frozen=True, slots=True)
class KitOffer:
    """One way to find this robot's zero again without a draw-wire, and what it would leave open."""

    name: str  # probe, tracker, seat, pin
    words: str
    spec: KitSpec
    outlook: KitPrediction
    postures_rad: tuple[Joints, ...]  # of the places but the nests, in order

    @property
    def is_strong(self) -> bool:
        """Whether it would tell all motors, and its check places would show any wrong turn."""
        return is_strong(self.outlook)

    @property
    def duration_min(self) -> float:
        """The time that a person needs to record it."""
        return len(kit_places(self.spec)) * PERSON_S / 60.0

    @property
    def widest_u_rad(self) -> float:
        """The zero that would be known worst, k = 2."""
        return max(self.outlook.offset_u_rad)


@dataclass(frozen=True, slots=True)
class KitOffers:
    """The kits that this cell could record, the smallest error first, and what is missing for the rest."""

    offers: tuple[KitOffer, ...]
    missing: tuple[str, ...]

    def offer_named(self, name: str) -> KitOffer | None:
        """Return one of them."""
        return next((offer for offer in self.offers if offer.name == name), None)


def offers_at(bench: KitBench, room: MotionBounds, own: KitSpec | None, seed: int) -> KitOffers:
    """Design every kit that a cell has the means for; with settings of an engineer's own, that one alone."""
    robot = (bench.motors.drive, bench.motors.mastering.counts_at_zero)
    return design_offers(bench.model, robot, bench.instruments, room, (own, seed))


def design_offers(
    model_name: str,
    robot: tuple[DriveTrain, Counts],
    instruments: Instruments,
    room: MotionBounds,
    how: tuple[KitSpec | None, int],
) -> KitOffers:
    """Design the kits from what is known of a robot and its cell; pure."""
    own, seed = how
    model, missing, offers = load_model(model_name), list[str](), list[KitOffer]()
    kit_specs = _kit_specs(instruments) if own is None else ((name_of(own, instruments), own),)
    for name, spec in kit_specs:
        if isinstance(spec, str):
            missing.append(f"{name}: {spec}")
            continue
        try:
            offers.append(_design_offer(model, robot, name, spec, (room, seed)))
        except DegenerateDataError as error:
            missing.append(f"{name}: {error.message}")
    ranked = sorted(offers, key=lambda offer: (not offer.is_strong, offer.widest_u_rad))
    return KitOffers(tuple(ranked), tuple(missing))


def name_of(spec: KitSpec, instruments: Instruments) -> str:
    """Return what a kit of an engineer's own settings is called."""
    if spec.kind == "point":
        return "probe" if instruments.probe_tip_m is not None else "pin"
    return "tracker" if spec.kind == "target" else "seat"


def plan_of(spec: KitSpec) -> KitPlan:
    """Return the settings as the design of a kit wants them."""
    return KitPlan(
        spec.kind,
        spec.tip_in_flange_m,
        spec.places,
        spec.check_points,
        spec.sigma_m,
        spec.sigma_rad,
        spec.sigma_tip_m,
    )


def one_more_posture(
    bench: KitBench, room: MotionBounds, spec: KitSpec, kit: RecoveryKit, seed: int
) -> Joints:
    """Return where one more place would help a recorded kit most."""
    robot = (bench.motors.drive, bench.motors.mastering.counts_at_zero)
    model = load_model(bench.model)
    kind = replace(spec, kind="point") if spec.kind == "seat" else spec
    more = design_kit(
        model, robot, plan_of(kind), _candidate_postures(spec, model, (room, seed + 1))[:20], existing_kit=kit
    )
    return _joints_at(robot, more.places[-1].counts)


def offers_text(found: KitOffers) -> str:
    """Return the kits side by side, a line each, for a person who chooses."""
    lines = [
        f"{offer.name}: {offer.words}; about {offer.duration_min:.0f} minutes by hand. After a loss "
        f"every zero would be "
        f"known within {_degrees_text(offer)}"
        + ("" if offer.is_strong else ". TOO WEAK: it would be refused")
        for offer in found.offers
    ]
    return "\n".join([*lines, *(f"not here: {line}" for line in found.missing)])


def _degrees_text(offer: KitOffer) -> str:
    per_axis = ", ".join(f"{math.degrees(u):.3f}" for u in offer.outlook.offset_u_rad)
    return (
        f"{per_axis} deg (J1 on, k=2; whole turns come back exactly, chance "
        f"{offer.outlook.success_probability:.6f})"
    )


def _kit_specs(instruments: Instruments) -> tuple[tuple[str, KitSpec | str], ...]:
    tip, sigma_tip = instruments.probe_tip_m, OWN_SIGMA_M
    if tip is None:
        tip, sigma_tip = instruments.tool_tip_m, TOOL_SIGMA_M
    no_tip = "say where the tip is (kit.tip_in_flange_m), or type the tool frame into the controller"
    found: list[tuple[str, KitSpec | str]] = []
    if instruments.probe_tip_m is not None:
        sigma = math.hypot(HAND_SIGMA_M, instruments.probe_sigma_m)
        found.append(("probe", KitSpec("point", instruments.probe_tip_m, sigma_m=sigma)))
    else:
        found.append(("probe", "the cell has no touch probe"))
    if instruments.target_m is not None:
        sigma = max(MAST_SIGMA_M, instruments.tracker_sigma_m)
        found.append(("tracker", KitSpec("target", instruments.target_m, sigma_m=sigma)))
    else:
        found.append(("tracker", "the cell has no tracker"))
    seat = None if tip is None else KitSpec("seat", tip, sigma_m=SEAT_SIGMA_M, sigma_rad=SEAT_SIGMA_RAD)
    found.append(("seat", no_tip if seat is None else replace(seat, sigma_tip_m=sigma_tip)))
    if instruments.probe_tip_m is None:
        pin = None if tip is None else KitSpec("point", tip, sigma_m=PIN_SIGMA_M, sigma_tip_m=sigma_tip)
        found.append(("pin", no_tip if pin is None else pin))
    return tuple(found)


def _design_offer(
    model: RobotModel,
    robot: tuple[DriveTrain, Counts],
    name: str,
    spec: KitSpec,
    how: tuple[MotionBounds, int],
) -> KitOffer:
    kit = design_kit(model, robot, plan_of(spec), _candidate_postures(spec, model, how))
    places = [place for place in kit.places if place.kind != "nest"]
    kind_texts = {
        "probe": make_message("{place_count} marks touched with the probe", place_count=len(places)),
        "pin": make_message(
            "{place_count} marks or holes met with a pointed tip or a pin", place_count=len(places)
        ),
        "seat": make_message(
            "one keyed seat and {check_points} marks for checking", check_points=spec.check_points
        ),
        "tracker": make_message(
            "{place_count} postures seen by the tracker, and {nests} fixed nests",
            place_count=len(places),
            nests=spec.nests,
        ),
    }[name]
    postures = tuple(_joints_at(robot, place.counts) for place in places)
    return KitOffer(name, kind_texts, spec, predict_kit_recovery(model, kit, robot), postures)


def _candidate_postures(spec: KitSpec, model: RobotModel, how: tuple[MotionBounds, int]) -> np.ndarray:
    """Return postures (C, n) that a person can bring the tool to: the wrist bent, for marks the tip downwards."""
    room, seed = how
    reach = MotionSpace(model.name, spec.tip_in_flange_m, None, room)
    drawn = np.array(draw_poses(reach, 8 * CANDIDATES, seed))
    bent = np.abs(drawn[:, -2]) > _LOWEST_WRIST_RAD
    if spec.kind != "target":
        frames = model.base_flange(drawn)
        axis = frames[:, :3, 3] - (frames[:, :3, :3] @ np.array(spec.tip_in_flange_m) + frames[:, :3, 3])
        bent &= -axis[:, 2] / np.linalg.norm(axis, axis=1) < _TIP_DOWN
    found: np.ndarray = drawn[bent][:CANDIDATES]
    return found


def _joints_at(robot: tuple[DriveTrain, Counts], counts: Counts) -> Joints:
    joints = robot[0].to_joints(np.array(counts), np.array(robot[1]))
    return tuple(float(q) for q in joints)
