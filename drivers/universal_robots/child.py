"""Runs in a process of its own, one per motion session; the only importer of ur-rtde.

ur-rtde's constructor holds the interpreter and may wait for ever; its reconnect thread crashes the process.
So nothing here reconnects, retries or waits: the parent looks on and ends this process instead. Only
asynchronous moves: the parent decides on its own stream when the arm has arrived.
"""

import time

from rtde_control import RTDEControlInterface

from cellcal.calibration.message import make_message
from cellcal.drivers.wire.child import serve_requests

_CYCLE_HZ = 125.0  # enough for commands, and the client spins while it waits
_READY_S = 0.5


class _ControlInterface:
    """One connection of ur-rtde's control interface."""

    def __init__(self) -> None:
        self._control: RTDEControlInterface | None = None

    def connect(self, address: str, watchdog_hz: float) -> None:
        """Upload ur-rtde's program; it stops itself, and the arm, when we fall silent."""
        flags = RTDEControlInterface.FLAG_UPLOAD_SCRIPT.value | RTDEControlInterface.FLAG_NO_EXT_FT.value
        control = RTDEControlInterface(address, _CYCLE_HZ, flags)
        if not control.setWatchdog(watchdog_hz):
            raise RuntimeError("the controller did not accept the watchdog")
        self._control = control

    def keep_alive(self) -> bool:
        """Feed the watchdog; False when the program has ended."""
        control = self._connected_control()
        return bool(control.isConnected() and control.isProgramRunning() and control.kickWatchdog())

    def move_joints(self, target_rad: list[float], speed_rad_s: float, acceleration_rad_s2: float) -> bool:
        """Start a joint move; False when the controller did not take it."""
        # A wrong length would be a malformed packet and a call that never returns.
        if len(target_rad) != 6:
            raise ValueError(
                make_message(
                    "{target_rad_count} joint angles for an arm of 6", target_rad_count=len(target_rad)
                )
            )
        return bool(self._connected_control().moveJ(target_rad, speed_rad_s, acceleration_rad_s2, True))

    def move_running(self) -> bool:
        """Whether the program still works on a move."""
        return int(self._connected_control().getAsyncOperationProgress()) >= 0

    def stop(self, deceleration_rad_s2: float) -> None:
        """Let the arm decelerate; returns at once."""
        self._connected_control().stopJ(deceleration_rad_s2, True)

    def release(self) -> None:
        """End our program, so that the pendant and the hand have the robot again."""
        control = self._connected_control()
        control.stopScript()
        deadline_s = time.monotonic() + _READY_S
        while control.isProgramRunning() and time.monotonic() < deadline_s:
            time.sleep(0.01)

    def _connected_control(self) -> RTDEControlInterface:
        if self._control is None:
            raise RuntimeError("not connected")
        return self._control


def main() -> None:
    """Serve the parent."""
    arm = _ControlInterface()
    serve_requests(
        {
            "connect": arm.connect,
            "keep_alive": arm.keep_alive,
            "move_joints": arm.move_joints,
            "move_running": arm.move_running,
            "stop": arm.stop,
            "release": arm.release,
        }
    )


if __name__ == "__main__":
    main()
