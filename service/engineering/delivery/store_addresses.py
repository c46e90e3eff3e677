"""Where programs lie: ``abb://``, ``fanuc://``, ``ur://``, ``yaskawa://`` and a host, or a folder of this machine."""

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.abb.robot_web_services.generation import ServiceAddress
from cellcal.drivers.abb.robot_web_services.program_store import AbbProgramStore
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.fanuc.controller_files.controller_address import parse_address
from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin
from cellcal.drivers.fanuc.controller_files.ftp_store import FtpProgramStore
from cellcal.drivers.interfaces.program_store import ProgramStore
from cellcal.drivers.wire.folder_store import FolderStore
from cellcal.drivers.yaskawa.hses_frames import ROBOT_PORT
from cellcal.drivers.yaskawa.job_store import YaskawaJobStore

_ABB, _FANUC, _UR, _YASKAWA = "abb://", "fanuc://", "ur://", "yaskawa://"
_HOME = "$HOME"
_ABB_USER, _ABB_PASSWORD = "Default User", "robotics"  # the maker's defaults
OpenStore: TypeAlias = Callable[[], AbstractAsyncContextManager[ProgramStore]]


@dataclass(frozen=True, slots=True)
class StoreLogin:
    """The user; "" and None are what is usual for the make."""

    user: str = ""
    password: str | None = None
    certificate: Path | None = None
    host_keys: tuple[str, ...] = ()
    timeout_s: float = 10.0


def store_at(address: str, login: StoreLogin) -> OpenStore:
    """Return what opens the store at an address; each use is a connection of its own.

    Raises
    ------
    CellError
        The address is none.
    """
    if address.startswith(_ABB):
        return _abb_store(address, login)
    if address.startswith(_FANUC):
        controller = parse_address(address.removeprefix(_FANUC))
        ftp = FtpLogin(login.user or "anonymous", login.password or "", login.timeout_s)
        return lambda: FtpProgramStore(controller, ftp)
    if address.startswith(_UR):
        return _ur_store(address, login)
    if address.startswith(_YASKAWA):
        where = address.removeprefix(_YASKAWA)
        found = parse_address(where)
        port = found.port if ":" in where.rpartition("]")[2] else ROBOT_PORT
        return lambda: YaskawaJobStore(address, found.host, port=port, timeout_s=login.timeout_s)
    if "://" in address or not Path(address).is_dir():
        raise CellError(
            make_message("{address!r} is neither a controller nor a folder.", address=address[:80]),
            remedy="Give abb://HOST, fanuc://HOST, ur://HOST, yaskawa://HOST or a folder, such as a mounted share.",
            code="usage",
        )
    return lambda: _open_folder(Path(address))


def host_of(address: str) -> str:
    """Return the controller of an address, one text for every folder on it; a folder of this machine is itself."""
    make, mark, where = address.partition("://")
    return f"{make}{mark}{where.partition('/')[0].lower()}" if mark else str(Path(address).resolve())


def _abb_store(address: str, login: StoreLogin) -> OpenStore:
    where, _, folder = address.removeprefix(_ABB).partition("/")
    controller = parse_address(where)  # reads host and port, whatever the protocol
    port = controller.port if ":" in where.rpartition("]")[2] else None

    @asynccontextmanager
    async def open_store() -> AsyncIterator[ProgramStore]:
        link = WebLink(
            ServiceAddress(address, controller.host, port, login.certificate),
            (login.user or _ABB_USER, _ABB_PASSWORD if login.password is None else login.password),
            deadline_s=login.timeout_s,
        )
        try:
            await link.connect()
            yield AbbProgramStore(link, folder or _HOME)
        finally:
            await link.close()

    return open_store


def _ur_store(address: str, login: StoreLogin) -> OpenStore:
    from cellcal.drivers.universal_robots.program_store import (  # noqa: PLC0415  SSH takes long to load
        PROGRAM_FOLDER,
        SSH_PORT,
        USUAL_PASSWORD,
        USUAL_USER,
        UrProgramStore,
    )
    from cellcal.drivers.wire.sftp_link import SshLogin  # noqa: PLC0415  as above

    where, _, folder = address.removeprefix(_UR).partition("/")
    controller = parse_address(where)
    port = controller.port if ":" in where.rpartition("]")[2] else SSH_PORT
    password = USUAL_PASSWORD if login.password is None else login.password
    ssh = SshLogin(login.user or USUAL_USER, password, login.host_keys)
    path = f"/{folder.strip('/')}" if folder.strip("/") else PROGRAM_FOLDER
    return lambda: UrProgramStore(address, (controller.host, port), path, ssh, deadline_s=login.timeout_s)


@asynccontextmanager
async def _open_folder(folder: Path) -> AsyncIterator[ProgramStore]:
    yield FolderStore(folder)
