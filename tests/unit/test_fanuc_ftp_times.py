"""A FANUC controller whose octets trickle: replies, listings and all files together have an end in time."""

import time

import pytest

from cellcal.drivers.errors import DeviceTimeoutError
from cellcal.drivers.fanuc.controller_files.controller_address import ControllerAddress
from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin, FtpSource, ReadOnlyFtp

LOGIN = FtpLogin(timeout_s=10.0, file_timeout_s=120.0, session_timeout_s=600.0)


class TricklingConnection:
    """Brings one octet in nine seconds, so that no wait for the next one is too long."""

    def __init__(self, content: bytes) -> None:
        self._left, self.now_s = content, 0.0

    def settimeout(self, timeout_s: float) -> None:
        del timeout_s

    def recv(self, size: int) -> bytes:
        del size
        self.now_s += 9.0
        piece, self._left = self._left[:1], self._left[1:]
        return piece

    def __enter__(self) -> "TricklingConnection":
        return self

    def __exit__(self, *_: object) -> None:
        return


@pytest.fixture
def connection(monkeypatch: pytest.MonkeyPatch) -> TricklingConnection:
    made = TricklingConnection(b"220-" + b"axis.dg\r\n" * 1000)
    monkeypatch.setattr(time, "monotonic", lambda: made.now_s)
    return made


def test_a_reply_that_trickles_is_given_up(connection: TricklingConnection) -> None:
    client = ReadOnlyFtp(encoding="latin-1")
    client.sock, client.timeout = connection, LOGIN.timeout_s  # type: ignore[assignment]
    with pytest.raises(TimeoutError):
        client.getresp()
    assert connection.now_s <= 2 * LOGIN.timeout_s


def test_a_listing_that_trickles_is_given_up(
    connection: TricklingConnection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ReadOnlyFtp, "voidcmd", lambda *_: "200 OK.")
    monkeypatch.setattr(ReadOnlyFtp, "transfercmd", lambda *_: connection)
    with pytest.raises(
        DeviceTimeoutError, match="of the list of its files less than 1000 bytes arrived in 10 s"
    ):
        FtpSource(ControllerAddress("127.0.0.1"), LOGIN).list_names()
    assert connection.now_s <= 2 * LOGIN.timeout_s


def test_a_file_that_is_slow_but_comes_is_given_up_at_its_own_limit(
    connection: TricklingConnection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ReadOnlyFtp, "voidcmd", lambda *_: "200 OK.")
    monkeypatch.setattr(ReadOnlyFtp, "transfercmd", lambda *_: connection)
    monkeypatch.setattr(
        connection, "recv", lambda size: b"x" * 600 if TricklingConnection.recv(connection, size) else b""
    )
    with pytest.raises(DeviceTimeoutError, match="the list of its files did not arrive within 120 s"):
        FtpSource(ControllerAddress("127.0.0.1"), LOGIN).list_names()
    assert connection.now_s <= LOGIN.file_timeout_s + LOGIN.timeout_s


def test_files_that_never_end_are_given_up(
    connection: TricklingConnection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FtpSource, "_open_link", lambda _: None)
    monkeypatch.setattr(FtpSource, "_list_lines", lambda _: [f"p{n}.ls" for n in range(1000)])

    def retrieve(source: FtpSource, name: str) -> bytes:
        del source, name
        connection.recv(1)
        return b""

    monkeypatch.setattr(FtpSource, "_retrieve", retrieve)
    source = FtpSource(ControllerAddress("127.0.0.1"), LOGIN).__enter__()

    def read_all() -> None:
        for name in source.list_names():
            source.read_file(name)

    with pytest.raises(DeviceTimeoutError, match="within 600 s"):
        read_all()
