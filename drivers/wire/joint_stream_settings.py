"""The table of a cell file that names a stream of joint angles beside a robot's own link."""

import ipaddress
import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


def _check_listen(text: str) -> str:
    address = _as_address(text)
    if address.is_unspecified or address.is_multicast:
        raise ValueError("give the one address of this computer that the controller sends to")
    return text


def _check_sender(text: str | None) -> str | None:
    if text is not None:
        _as_address(text)
    return text


def _as_address(text: str) -> ipaddress.IPv4Address:
    try:
        return ipaddress.IPv4Address(text)
    except ValueError as error:
        raise ValueError("give an address of four numbers, such as 192.168.125.50") from error


class JointStreamSettings(BaseModel):
    """The port of a stream of joint angles, and what counts as standing and as the same angles.

    ``listen`` is an address of this computer, never all of them. ``sender`` is the controller's address on that
    network, where it is another than the robot's.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    listen: Annotated[str, AfterValidator(_check_listen)]
    port: int = Field(ge=1, le=65535)
    sender: Annotated[str | None, AfterValidator(_check_sender)] = None
    still_deg: float = Field(
        default=0.005, gt=0, le=0.1
    )  # less motion of any joint in a window: the arm stands
    window_s: float = Field(default=0.2, ge=0.05, le=2.0)
    silent_s: float = Field(default=0.5, ge=0.1, le=5.0)  # without a packet: there is no stream
    late_s: float = Field(
        default=0.1, ge=0.01, le=1.0
    )  # longer under way than the quickest: it shows the past
    agree_deg: float = Field(
        default=0.02, gt=0, le=0.5
    )  # further from the robot's own link: one of both is wrong

    @property
    def still_rad(self) -> float:
        """The limit of motion in a window [rad]."""
        return math.radians(self.still_deg)

    def sender_of(self, robot_address: str) -> str:
        """Return the only address that datagrams count from.

        Raises
        ------
        ValueError
            The robot is addressed by a name, and no sender is given.
        """
        if self.sender is not None:
            return self.sender
        try:
            return str(ipaddress.IPv4Address(robot_address))
        except ValueError as error:
            raise ValueError("give the controller's address as sender: the robot's is a name") from error
