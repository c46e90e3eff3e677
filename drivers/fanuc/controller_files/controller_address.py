"""Where a controller's FTP server is: a host name or address, with a port where it is not the usual one."""

import ipaddress
import re
from dataclasses import dataclass

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message

FTP_PORT = 21
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,252}[A-Za-z0-9])?\Z")
_ADDRESS = re.compile(
    r"(?:(?:ftp|fanuc)://)?(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<host>[^\[\]:/@]+))(?::(?P<port>\d{1,5}))?/?\Z"
)


@dataclass(frozen=True, slots=True)
class ControllerAddress:
    """Host and port."""

    host: str
    port: int = FTP_PORT

    def __str__(self) -> str:
        """Write it as a person types it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == FTP_PORT else f"{host}:{self.port}"


def parse_address(text: str) -> ControllerAddress:
    """Read HOST, HOST:PORT, [IPv6]:PORT or an IPv6 address alone; fanuc:// may stand before it, as for programs.

    Raises
    ------
    CellError
        It is none of them.
    """
    if _is_address(text.strip(), 6):
        return ControllerAddress(text.strip())
    found = _ADDRESS.match(text.strip())
    host = (found["six"] or found["host"]) if found else ""
    port = int(found["port"] or FTP_PORT) if found else 0
    if not 1 <= port <= 65535 or not _is_host(host):
        raise CellError(
            make_message("{text!r} is neither a folder nor the address of a controller.", text=text[:80]),
            remedy="Give an address such as 192.168.0.10 or robot1:2121, or a folder that holds a backup.",
            code="usage",
        )
    return ControllerAddress(host, port)


def _is_host(host: str) -> bool:
    if ":" in host:
        return _is_address(host, 6)
    if host and not host.strip("0123456789."):
        return _is_address(host, 4)
    return _HOST.match(host) is not None


def _is_address(text: str, version: int) -> bool:
    try:
        return ipaddress.ip_address(text).version == version
    except ValueError:
        return False
