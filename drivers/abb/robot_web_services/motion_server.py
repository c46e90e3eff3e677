"""The handshake with the RAPID module CellcalServer (deploy/controller_setup/abb)."""

from cellcal.calibration.documents.plain_numbers import parse_whole
from cellcal.drivers.abb.robot_web_services.rapid_values import write_joint_target
from cellcal.drivers.abb.robot_web_services.state import converted
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import MotionStoppedError, RefusedError
from cellcal.drivers.wire.program_handshake import ProgramHandshake, ProgramState

_MODULE = "CellcalServer"
_START = "Load the module CellcalServer, move the program pointer to main, and start it in AUTO."


class MotionServer(ProgramHandshake):
    """CellcalServer on the controller. The heartbeat is written while a step is waited for."""

    def __init__(self, link: WebLink) -> None:
        super().__init__()
        self._link = link

    async def order_move(self, joints_rad: tuple[float, ...], duration_s: float) -> int:
        """Order one step; return the number under which it is acknowledged. The request is written last."""
        request = await self._next_request()
        await self._link.write_symbol(f"{_MODULE}/jTarget", write_joint_target(joints_rad))
        await self._link.write_symbol(f"{_MODULE}/nTime", f"{max(duration_s, 0.01):.4f}")
        return await self._start_step(request)

    async def _read_state(self) -> ProgramState:
        return ProgramState(await self._read("nState"))

    async def _read_heartbeat_counter(self) -> int:
        return await self._read("nLife")

    async def _read_request(self) -> int:
        return await self._read("nReq")

    async def _read_acknowledged(self) -> int:
        return await self._read("nAck")

    async def _order_stop(self) -> None:
        await self._write("nStop", 1)

    async def _release_stop(self) -> None:
        await self._write("nStop", 0)

    async def _write_request(self, number: int) -> None:
        await self._write("nReq", number)

    async def _write_heartbeat(self, number: int) -> None:
        await self._write("nHeart", number)

    async def _refused_error(self) -> RefusedError:
        return self._not_running_error()  # this program refuses no step: the controller does

    def _not_running_error(self) -> RefusedError:
        return RefusedError(self._link.device, "the program CellcalServer does not run.", remedy=_START)

    def _stop_unconfirmed_error(self) -> MotionStoppedError:
        return MotionStoppedError(
            self._link.device,
            "the program CellcalServer has not confirmed the stop.",
            remedy="Press the emergency stop and look at the robot.",
        )

    def _stopped_error(self) -> MotionStoppedError:
        return MotionStoppedError(
            self._link.device,
            "the program CellcalServer was stopped.",
            remedy=f"Look at the robot and the pendant. {_START}",
        )

    async def _read(self, name: str) -> int:
        text = await self._link.read_symbol(f"{_MODULE}/{name}")
        return converted(self._link, lambda: parse_whole(text))

    async def _write(self, name: str, value: int) -> None:
        await self._link.write_symbol(f"{_MODULE}/{name}", str(value))
