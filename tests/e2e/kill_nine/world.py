"""A cell whose world lives in one process while the run that may be killed lives in another."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cellcal.calibration.arm.kinematics import load_model
from cellcal.procedures.cell import Cell, MotionCaps, MotionLevel
from cellcal.procedures.progress import StepProgress
from cellcal.service.record.journal import Journal
from cellcal.service.runs.run_procedure import RunConditions, resume_procedure, run_procedure
from tests.procedures.procedure_scenes import ProcedureScene

Call = tuple[str, str, tuple[Any, ...], dict[str, Any]]
ACK = "acknowledged"


class RemoteDevice:
    """A device on the other side of a pipe: every call of a method travels there and back."""

    def __init__(self, pipe: Connection, device: str, capabilities: Any) -> None:
        self._pipe, self.name, self.capabilities = pipe, device, capabilities

    async def _call_remote(self, method: str, *args: Any, **kwargs: Any) -> Any:
        self._pipe.send((self.name, method, args, kwargs))
        kind, value = self._pipe.recv()
        if kind == "error":
            raise value
        return value

    async def identify(self) -> Any:
        return await self._call_remote("identify")

    async def read_condition(self) -> Any:
        return await self._call_remote("read_condition")


class RemoteArm(RemoteDevice):
    """The arm."""

    async def read_joints(self) -> Any:
        return await self._call_remote("read_joints")

    async def flange_pose(self) -> Any:
        return await self._call_remote("flange_pose")

    async def move_joints(self, target_rad: Any, *, speed_rad_s: float) -> None:
        await self._call_remote("move_joints", target_rad, speed_rad_s=speed_rad_s)

    async def jog_axis(self, axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        await self._call_remote("jog_axis", axis, delta_rad, speed_rad_s=speed_rad_s)

    async def stop(self) -> None:
        await self._call_remote("stop")

    async def encoder_counts(self) -> Any:
        return await self._call_remote("encoder_counts")

    async def read_mastering(self) -> Any:
        return await self._call_remote("read_mastering")

    async def drive_train(self) -> Any:
        return await self._call_remote("drive_train")

    async def encoder_epoch(self) -> Any:
        return await self._call_remote("encoder_epoch")

    async def write_mastering(self, counts_at_zero: Any) -> Any:
        return await self._call_remote("write_mastering", counts_at_zero)

    async def restore_mastering(self, data: Any) -> Any:
        return await self._call_remote("restore_mastering", data)

    async def reset_position_alarms(self) -> None:
        await self._call_remote("reset_position_alarms")


class RemoteWire(RemoteDevice):
    """The gauge."""

    async def read_distance(self) -> Any:
        return await self._call_remote("read_distance")


class RemoteTechnician(RemoteDevice):
    """The technician."""

    async def confirm(self, instruction: Any) -> Any:
        return await self._call_remote("confirm", instruction)

    async def ask_question(self, question: Any) -> Any:
        return await self._call_remote("ask_question", question)


def run_child(
    pipe: Connection, journal_path: Path, name: str, parts: dict[str, Any], run_id: str | None
) -> None:
    """Run or resume a procedure in this process; tell each finding after it was stored."""
    arm = RemoteArm(pipe, "arm", parts["arm_capabilities"])
    wire = RemoteWire(pipe, "wire", parts["wire_capabilities"])
    technician = RemoteTechnician(pipe, "hands", None)
    cell: Cell = replace(
        parts["cell"](arm, wire, technician), record=parts["record"], gauge_setup=parts["gauge_setup"]
    )

    def report_finding(progress: StepProgress) -> None:
        if progress.kind == "finding":
            pipe.send((ACK, progress.step, (progress.value,), {}))

    async def run_procedure_in_child() -> None:
        how = RunConditions(report_finding, free_bytes=0)
        with Journal.open_file(journal_path) as journal:
            if run_id is None:
                await run_procedure(cell, name, parts["spec"], journal, how=how)
            else:
                await resume_procedure(cell, run_id, journal, how=how)

    asyncio.run(run_procedure_in_child())
    pipe.close()


def remote_cell(arm: RemoteArm, wire: RemoteWire, technician: RemoteTechnician) -> Cell:
    """Return a cell of remote devices."""
    limits = MotionCaps(settle_s=0.0)
    model = load_model("fanuc_m6ib")
    return Cell(
        "test",
        arm,
        technician,
        jogs=arm,
        mastering=arm,
        gauge=wire,
        model=model,
        limits=limits,
        level=MotionLevel.COMMANDED,
        config_sha256="c0ffee",
    )


def parts_of(made: ProcedureScene) -> dict[str, Any]:
    """Return what a child needs to build its cell."""
    return {
        "cell": remote_cell,
        "arm_capabilities": made.arm.capabilities,
        "wire_capabilities": made.wire.capabilities,
        "gauge_setup": made.cell.gauge_setup,
        "record": made.cell.record,
        "spec": made.spec,
    }


class SceneServer:
    """Answers a child's calls from a scene; calls ``kill`` at the n-th call, some time later."""

    def __init__(self, made: ProcedureScene, pipe: Connection) -> None:
        self._devices: dict[str, Any] = {"arm": made.arm, "wire": made.wire, "hands": made.technician}
        self._pipe = pipe
        self.acknowledged: list[tuple[str, Any]] = []
        self.calls = 0
        self.killed = False

    def until_closed(
        self, kill: Callable[[], None], *, at_call: int | None = None, after_s: float = 0.0
    ) -> None:
        """Serve until the child is gone."""
        with asyncio.Runner() as runner:
            while True:
                try:
                    call: Call = self._pipe.recv()
                except (EOFError, ConnectionResetError):
                    return
                if call[0] == ACK:
                    self.acknowledged.append((call[1], call[2][0]))
                    continue
                self.calls += 1
                answer = runner.run(self._answer_call(call))
                if at_call == self.calls and after_s <= 0:
                    kill()
                try:
                    self._pipe.send(answer)
                except BrokenPipeError:
                    continue  # read what it said before it died
                if at_call == self.calls and after_s > 0:
                    time.sleep(after_s)
                    kill()

    async def _answer_call(self, call: Call) -> tuple[str, Any]:
        device, method, args, kwargs = call
        try:
            return "ok", await getattr(self._devices[device], method)(*args, **kwargs)
        except Exception as error:
            return "error", error
