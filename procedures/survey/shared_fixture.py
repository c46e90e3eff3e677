"""What a fixture alignment shares with those of other robots: the wire, the fixture, and the base seen through it."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.points.alignment import Alignment, WirePoints
from cellcal.calibration.points.fixture import Covariance6, Triple, base_through_fixture
from cellcal.calibration.points.joint_bases import bases_together
from cellcal.calibration.wires.network_fit import WireNetwork
from cellcal.procedures.cell import Cell
from cellcal.procedures.steps.mastering import length_gauge
from cellcal.procedures.survey.survey import Survey


@dataclass(frozen=True, slots=True)
class KnownWire:
    """The wire that measures, and the newest alignment of every other robot with the fixture."""

    wire: str
    others: tuple[Alignment, ...]

    def worst_covariance(self, points_in_fixture_m: tuple[Triple, ...]) -> Covariance6:
        """Return the covariance of the least sure alignment with these points; empty where there is none."""
        found = [a for a in self.others if a.points_in_fixture_m == points_in_fixture_m]
        return max(found, key=lambda a: a.origin_u_m).covariance if found else ()


NOTHING_KNOWN = KnownWire("", ())


@dataclass(frozen=True, slots=True)
class BasePrediction:
    """The predicted uncertainty of another robot's base through the fixture; k = 2."""

    seen: str  # the other robot; empty: none is aligned yet, it is expected to become as good
    origin_u_m: float
    angle_u_rad: float


async def read_known_wire(cell: Cell, fixture: str) -> KnownWire:
    """Return which wire this is, and how other robots are aligned with the fixture."""
    wire, robot = await length_gauge(cell).identify(), (await cell.robot.identify()).serial
    others = {a.robot_serial: a for a in cell.alignments if a.fixture == fixture and a.robot_serial != robot}
    return KnownWire(f"{wire.vendor} {wire.model} {wire.serial}", tuple(others.values()))


def wire_points(survey: Survey, network: WireNetwork, wire: str) -> WirePoints:
    """Return all that a fit with other robots' alignments needs of what the wire told here."""
    network_prior, spots, rules = survey.wire_network_prior(), survey.list_places(), survey.rules
    covariance = network.exit_and_wire_covariance(spots)
    return WirePoints(
        wire=wire,
        found_m=tuple(network.exits_m[k] for k in spots),
        of_wire=(network.scale, network.exit_radius_m, *network.slow_m),
        covariance=tuple(tuple(float(v) for v in row) for row in covariance),
        believed=network_prior.wire_values(),
        sigma=network_prior.wire_sigmas(),
        sigma_seat_m=rules.seat_sigma_m,
        sigma_drawing_m=rules.drawing_sigma_m,
    )


def predict_base(alignment: Alignment, known_wire: KnownWire) -> BasePrediction:
    """Return the worst of the bases through the fixture; where no other robot is aligned, one as good as this one."""
    others = [a for a in known_wire.others if a.points_in_fixture_m == alignment.points_in_fixture_m]
    if not others:
        covariance = np.array(alignment.covariance)
        base = base_through_fixture(alignment.base_fixture, covariance, alignment.base_fixture, covariance)
        return BasePrediction("", base.origin_u_m, base.angle_u_rad)
    bases = [(other, bases_together([other, alignment]).bases[0]) for other in others]
    other, worst = max(bases, key=lambda pair: pair[1].origin_u_m)
    return BasePrediction(other.robot_serial, worst.origin_u_m, worst.angle_u_rad)
