"""The handshake with CELLCAL.SRC, the program that moves the robot (deploy/controller_setup/kuka)."""

import math

from cellcal.calibration.documents.plain_numbers import parse_whole
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import MotionStoppedError, RefusedError
from cellcal.drivers.kuka.variables.state import read_value
from cellcal.drivers.kuka.variables.values import write_axes
from cellcal.drivers.kuka.variables.variable_link import VariableLink
from cellcal.drivers.wire.program_handshake import ProgramHandshake, ProgramState

_START = "Select CELLCAL at the pendant, in AUT or EXT, and start it."


class MotionServer(ProgramHandshake):
    """CELLCAL on the controller. The heartbeat is written while a step is waited for."""

    def __init__(self, link: VariableLink) -> None:
        super().__init__()
        self._link = link

    async def order_move(self, joints_rad: tuple[float, ...], percent: int) -> int:
        """Order one step; return the number under which it is acknowledged. The request is written last."""
        request = await self._next_request()
        await self._link.write_variable("CC_AXIS", write_axes(joints_rad))
        await self._link.write_variable("CC_VEL", str(percent))
        return await self._start_step(request)

    async def _read_state(self) -> ProgramState:
        try:
            return ProgramState(await self._read("CC_STATE"))
        except RefusedError:  # its variables are not there
            return ProgramState.OFF

    async def _read_heartbeat_counter(self) -> int:
        return await self._read("CC_LIFE")

    async def _read_request(self) -> int:
        return await self._read("CC_REQ")

    async def _read_acknowledged(self) -> int:
        return await self._read("CC_ACK")

    async def _order_stop(self) -> None:
        await self._link.write_variable("CC_STOP", "TRUE")

    async def _release_stop(self) -> None:
        await self._link.write_variable("CC_STOP", "FALSE")

    async def _write_request(self, number: int) -> None:
        await self._link.write_variable("CC_REQ", str(number))

    async def _write_heartbeat(self, number: int) -> None:
        await self._link.write_variable("CC_HB", str(number))

    async def _refused_error(self) -> RefusedError:
        axis = await self._read("CC_BAD")
        return RefusedError(
            self._link.device,
            make_message("the target of A{axis} is beyond the software limit of the controller.", axis=axis),
            remedy="Compare the joint limits of the cell file's model with those of the controller.",
        )

    def _not_running_error(self) -> RefusedError:
        return RefusedError(self._link.device, "the program CELLCAL does not run.", remedy=_START)

    def _stop_unconfirmed_error(self) -> MotionStoppedError:
        return MotionStoppedError(
            self._link.device,
            "the program CELLCAL has not confirmed the stop.",
            remedy="Press the emergency stop and look at the robot.",
        )

    def _stopped_error(self) -> MotionStoppedError:
        return MotionStoppedError(
            self._link.device,
            "the program CELLCAL was stopped.",
            remedy=f"Look at the robot and the pendant. {_START}",
        )

    async def _read(self, variable: str) -> int:
        return await read_value(self._link, variable, parse_whole)


def speed_percent(device: str, speed_rad_s: float, fastest_axis_rad_s: float) -> int:
    """Return the axis speed in whole per cent, rounded down.

    Raises
    ------
    RefusedError
        Slower than one per cent, the least that a joint move of this controller takes.
    """
    percent = math.floor(100.0 * speed_rad_s / fastest_axis_rad_s)
    if percent < 1:
        least = math.degrees(fastest_axis_rad_s) / 100.0
        raise RefusedError(
            device,
            make_message(
                "the slowest joint move of this controller is {least:.2f} deg/s, and a slower one was "
                "asked for.",
                least=least,
            ),
            remedy="Raise speed_limit_rad_s in the cell file, or turn the override down at the pendant.",
        )
    return min(100, percent)
