"""[[robot]] driver = "opc_ua" in cell.toml. The model is the factory."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.drivers.wire.link_errors import bracket_host

if TYPE_CHECKING:
    from cellcal.drivers.opc_ua.robot import OpcUaRobot
    from cellcal.drivers.opc_ua.server_access import ServerAccess

_REQUEST_SHARE = 0.5  # of the deadline: a request that fails leaves time for saying so
_USUAL_AXES = 6
_Name = Annotated[str, Field(min_length=1, max_length=64)]


class OpcUaConfig(BaseModel):
    """How to reach a controller with OPC UA for Robotics (OPC 40010-1), which is read and never moved."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: Literal["opc_ua"]
    name: str = Field(min_length=1, max_length=64)
    address: str = Field(min_length=1)
    port: int = Field(default=4840, ge=1, le=65535)
    path: str = Field(default="/", pattern=r"^/[^\s?#@]*$")  # of the endpoint: opc.tcp://ADDRESS:PORT/PATH
    user: str = Field(default="", max_length=64)  # "": anonymous
    password: str = Field(default="", max_length=128)
    certificate: Path | None = None  # ours, with its key, and the server's own: all three encrypt the channel
    private_key: Path | None = None
    server_certificate: Path | None = None
    model: str = Field(min_length=1)  # name of the nominal robot model
    serial: str = Field(
        min_length=1
    )  # SerialNumber of the motion device; compared whenever nodes are looked for
    motion_device: str = Field(default="", max_length=200)  # its browse name, where the server shows several
    axes: tuple[_Name, ...] = Field(default=(), max_length=12)  # browse names in the model's order
    deadline_s: float = Field(default=5.0, gt=0, le=60)
    still_s: float = Field(
        default=1.0, gt=0, le=10
    )  # unchanged for so long: the arm stands; above the update rate
    speed_limit_rad_s: float = Field(default=0.25, gt=0, le=3.0)  # of plans that a person carries out
    settle_s: float = Field(default=0.5, ge=0, le=60)

    @model_validator(mode="after")
    def _check_limits(self) -> Self:
        if self.still_s > self.deadline_s / 2.0:
            raise ValueError("still_s is at most half of deadline_s: a reading may have to wait so long")
        if len(set(self.axes)) != len(self.axes):
            raise ValueError("axes names each axis once")
        return self

    @model_validator(mode="after")
    def _check_access(self) -> Self:
        files = (self.certificate, self.private_key, self.server_certificate)
        if None in files and files != (None, None, None):
            raise ValueError("certificate, private_key and server_certificate go together")
        if self.user and None in files:
            raise ValueError(
                "user: a password goes over an encrypted channel only; name the certificates as well"
            )
        if self.password and not self.user:
            raise ValueError("password without user")
        return self

    @property
    def capabilities(self) -> RobotCapabilities:
        """The robot's capabilities, known before it is reached."""
        return RobotCapabilities(
            axes=len(self.axes) or _USUAL_AXES,
            moves_joints=False,
            moves_slowly=False,
            tells_flange_pose=False,
            tells_active_frames=True,
            tells_mode=True,
            tells_speed_override=True,
        )

    @property
    def pendant_language(self) -> str:
        """The key of the pendant's language among the program writers of the registry; there is none."""
        return self.driver

    @asynccontextmanager
    async def open(self) -> AsyncIterator["OpcUaRobot"]:
        """Open a session, find the motion device, compare its serial number, and close the session at the end."""
        from cellcal.drivers.opc_ua.robot import OpcUaOptions, OpcUaRobot  # noqa: PLC0415  the library loads slowly
        from cellcal.drivers.opc_ua.server_link import ServerLink  # noqa: PLC0415  as above

        url = f"opc.tcp://{bracket_host(self.address)}:{self.port}{self.path}"
        link = ServerLink(self.name, url, self._make_access(), deadline_s=_REQUEST_SHARE * self.deadline_s)
        options = OpcUaOptions(
            self.serial, self.motion_device, self.axes, self.capabilities, self.deadline_s, self.still_s
        )
        robot = OpcUaRobot(link, options)
        try:
            await robot.connect()
            yield robot
        finally:
            await robot.close()

    def _make_access(self) -> "ServerAccess":
        from cellcal.drivers.opc_ua.server_access import CertificateFiles, ServerAccess  # noqa: PLC0415  as above

        if self.certificate is None or self.private_key is None or self.server_certificate is None:
            return ServerAccess()
        files = CertificateFiles(self.certificate, self.private_key, self.server_certificate)
        return ServerAccess(self.user, self.password, files)
