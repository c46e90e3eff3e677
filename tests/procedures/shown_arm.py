"""An ideal arm whose encoders nothing reads: its controller shows joints, and a person updates its counters."""

from dataclasses import dataclass, field, replace

import numpy as np

from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.position_record import ArmPositionRecord, ShownValue
from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, PositionCure, Readiness, RobotCapabilities
from cellcal.procedures.position_cure import PositionCureSpec
from cellcal.procedures.position_record import PositionRecordSpec, position_record
from cellcal.procedures.run import Run
from cellcal.procedures.shown_motors import ShownMotors
from tests.procedures.ideal_devices import COUNTS, RATIOS, IdealArm, IdealWire, ScriptedTechnician
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene

START_RAD = np.array([0.2, 0.1, -0.3, 0.4, 0.5, -0.6])


def _drive_without_coupling() -> DriveTrain:
    rows = np.diag(2 * np.pi / np.array(RATIOS)) / COUNTS
    return DriveTrain(tuple(tuple(float(v) for v in row) for row in rows), (COUNTS,) * 6)


@dataclass
class ShownArm(IdealArm):
    """Lost axes are named one by one; updating a counter leaves an axis the turns off that ``leaves_turns`` says."""

    drive: DriveTrain = field(default_factory=_drive_without_coupling)
    lost_axes: list[int] = field(default_factory=list)
    leaves_turns: dict[int, int] = field(default_factory=dict)
    constants: tuple[ShownValue, ...] = ()
    cure: PositionCure = PositionCure.REVOLUTION_COUNTERS

    @property
    def capabilities(self) -> RobotCapabilities:
        return RobotCapabilities(axes=6, tells_lost_position=True, position_cure=self.cure)

    async def read_condition(self) -> Condition:
        if self.lost_axes:
            alarms = tuple(
                Alarm("20032", f"axis {axis + 1}", axis, AlarmKind.TURNS) for axis in self.lost_axes
            )
            return Condition(Readiness.POSITION_LOST, "axes are not synchronised.", "update them", alarms)
        return Condition(Readiness.READY)

    async def position_data(self) -> tuple[ShownValue, ...]:
        joints = (await self.read_joints()).joints_rad
        return (*(ShownValue("rax", f"{q:.6f}", k, "rad") for k, q in enumerate(joints)), *self.constants)

    def update_next(self) -> None:
        """Update the counter of the first axis that is lost."""
        if self.lost_axes:
            axis = self.lost_axes.pop(0)
            turns = list(self.lost_turns)
            turns[axis] = self.leaves_turns.get(axis, 0)
            self.lost_turns = tuple(turns)


def shown_scene() -> ProcedureScene:
    """Return a healthy cell whose robot shows joints and no encoders."""
    made, arm, hands = healthy_scene(), ShownArm(), ScriptedTechnician()
    wire = IdealWire(arm)
    hands.does["bring_back_revolution_counters"] = arm.update_next
    cell = replace(
        made.cell,
        robot=arm,
        operator=hands,
        jogs=None,
        mastering=None,
        tool_frames=None,
        user_frames=None,
        frames=None,
        mode=None,
        gauge=wire,
        position_data=arm,
        shown_motors=ShownMotors(arm, RATIOS),
    )
    return ProcedureScene(arm, wire, hands, cell, PositionRecordSpec(poses=20, samples=2))


_record_cache: dict[str, ArmPositionRecord] = {}


async def cure_scene(
    lost: tuple[int, ...] = (1, 4), leaves_turns: dict[int, int] | None = None
) -> ProcedureScene:
    """Return a cell that lost some axes after its position record was taken."""
    if "record" not in _record_cache:
        healthy = shown_scene()
        spec = PositionRecordSpec(samples=2)
        _record_cache["record"] = (await position_record(Run(healthy.cell, MemoryLedger()), spec)).record
    made = shown_scene()
    assert isinstance(made.arm, ShownArm)
    made.arm.write_program(START_RAD)
    made.arm.lost_axes, made.arm.leaves_turns = list(lost), leaves_turns or {}
    made.arm.lost_turns = tuple(3 if axis in lost else 0 for axis in range(6))
    made.cell = replace(made.cell, position_record=_record_cache["record"])
    made.spec = PositionCureSpec(samples=2)
    return made
