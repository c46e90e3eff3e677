"""A server that answers nonsense: an error that is named, within the deadline, or exactly the bytes that were sent."""

import random
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cellcal.calibration.errors import CellError
from cellcal.drivers.errors import RefusedError, UnreachableError
from cellcal.drivers.fanuc.controller_files.controller_address import ControllerAddress
from cellcal.drivers.fanuc.controller_files.ftp_replies import FileNotGivenError
from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin, FtpSource
from cellcal.drivers.fanuc.controller_files.ftp_store import FtpProgramStore
from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.fake_devices.fanuc_files.ftp_server import FanucFtpServer
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.unit.helpers.fanuc_mutations import damage_bytes
from tests.wire.fanuc_ftp import address_of, ftp_controllers
from tests.wire.test_fanuc_record import take_record

CONTENT = b"F Number: F1\r\n" * 50
SEEDS = 120
REPLIES = {
    "USER": "230 Logged in.",
    "PASS": "230 Logged in.",
    "CWD": "250 OK.",
    "TYPE": "200 OK.",
    "QUIT": "221 Bye.",
}


class NonsenseServer:
    """One client at a time; some replies are damaged, as the seed says."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.sent: list[bytes] = []
        self._data: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve)

    @contextmanager
    def running(self) -> Iterator["NonsenseServer"]:
        self._thread.start()
        try:
            yield self
        finally:
            self._thread.join(timeout=30)
            self._listener.close()
            if self._data is not None:
                self._data.close()

    def _serve(self) -> None:
        client, _ = self._listener.accept()
        with client, client.makefile("rb") as commands:
            try:
                self._answer(client, "220 Ready.")
                for line in commands:
                    if not self._obey(client, line.decode("latin-1").strip()):
                        return
            except OSError:
                return  # the client has hung up

    def _obey(self, client: socket.socket, line: str) -> bool:
        verb = line.partition(" ")[0]
        if verb in ("PASV", "EPSV"):
            if self._data is not None:
                self._data.close()
            self._data = socket.create_server(("127.0.0.1", 0))
            self._data.settimeout(2.0)
            port = self._data.getsockname()[1]
            self._answer(client, f"227 Passive (127,0,0,1,{port >> 8},{port & 255}).")
        elif verb in ("NLST", "RETR") and self._data is not None:
            content = b"axis.dg\r\n" if verb == "NLST" else CONTENT
            with self._data, self._data.accept()[0] as data:
                self._answer(client, "150 Here.")
                damaged = self._rng.random() < 0.2
                body = damage_bytes(content, self._rng) if damaged else content
                data.sendall(body)
            if verb == "RETR":
                self.sent.append(body)
            self._answer(client, "226 Done.")
        else:
            self._answer(client, REPLIES.get(verb, "502 No."))
        return verb != "QUIT"

    def _answer(self, client: socket.socket, reply: str) -> None:
        text = f"{reply}\r\n".encode()
        if self._rng.random() < 0.12:
            text = damage_bytes(text, self._rng)
            if b"\n" not in text:
                text += b"\r\n"
        client.sendall(text)


def test_nonsense_is_named_or_what_was_sent() -> None:
    read, refusals = 0, []
    for seed in range(SEEDS):
        with NonsenseServer(seed).running() as server:
            login = FtpLogin(timeout_s=0.3, file_timeout_s=1.0)
            try:
                with FtpSource(ControllerAddress("127.0.0.1", server.port), login) as source:
                    content = source.read_file("axis.dg")
                    assert content is None or content in server.sent
                    read += content is not None
            except CellError as error:
                refusals.append((str(server.port), error))
    assert all(port in error.message and error.remedy for port, error in refusals)
    assert min(read, len(refusals)) > SEEDS // 8


def test_a_server_that_wants_an_account_refuses_the_login(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REPLIES, "USER", "331 Password.")
    monkeypatch.setitem(REPLIES, "PASS", "332 Account.")
    monkeypatch.setattr(random.Random, "random", lambda _rng: 1.0)  # no reply is damaged
    with NonsenseServer(0).running() as server:
        source = FtpSource(ControllerAddress("127.0.0.1", server.port), FtpLogin(timeout_s=5.0))
        with pytest.raises(CellError, match=r"login .* asks for an account"), source:
            pytest.fail("it was taken for a login")


def test_a_reply_without_an_end_is_no_reply() -> None:
    listener = socket.create_server(("127.0.0.1", 0))

    def talk() -> None:
        client, _ = listener.accept()
        with client:
            try:
                while True:
                    client.sendall(b"220-and on\r\n" * 100)
            except OSError:
                return

    thread = threading.Thread(target=talk)
    thread.start()
    address = ControllerAddress("127.0.0.1", listener.getsockname()[1])
    with pytest.raises(CellError, match="no FTP server answers"), FtpSource(address, FtpLogin(timeout_s=5.0)):
        pytest.fail("it was taken for a controller")
    thread.join(timeout=30)
    listener.close()


@pytest.fixture
def served() -> Iterator[FanucFtpServer]:
    with ftp_controllers(FanucCabinet(frames={1: (1000.0, -500.0, 250.0, 0.0, 0.0, 90.0)})) as servers:
        yield servers[0]


BUSY, FULL, NO_DATA = "450 File busy.", "421 Too many users.", "425 Can't open data connection."


def source_of(server: FanucFtpServer) -> FtpSource:
    return FtpSource(ControllerAddress("127.0.0.1", server.port), FtpLogin(timeout_s=5.0))


@pytest.mark.parametrize("reply", [BUSY, "451 Local error.", "*426 Transfer aborted.", "*450 Busy."])
def test_a_file_that_is_refused_once_is_read_the_next_time(served: FanucFtpServer, reply: str) -> None:
    with source_of(served) as source:
        content = source.read_file("version.dg")
        served.faults.replies = {"version.dg": [reply]}
        assert source.read_file("version.dg") == content


@pytest.mark.parametrize(
    ("reply", "kind", "words", "cure"),
    [
        (BUSY, FileNotGivenError, "refuses for now while reading axis.dg: 450 File busy", "backup"),
        (FULL, UnreachableError, "ended the FTP connection while reading axis.dg: 421", "few clients"),
        (NO_DATA, UnreachableError, "opened no data connection while reading axis.dg: 425", "firewall"),
        ("530 Not logged in.", RefusedError, "FTP login was refused while reading axis.dg: 530", "--user"),
        ("553 Not allowed.", RefusedError, "FTP command was refused while reading axis.dg: 553", "--user"),
    ],
)
def test_refusals_are_told_apart_with_their_cures(
    served: FanucFtpServer, reply: str, kind: type[CellError], words: str, cure: str
) -> None:
    served.faults.replies = {"axis.dg": [reply] * 9}
    with source_of(served) as source:
        with pytest.raises(CellError, match=words) as caught:
            source.read_file("axis.dg")
        assert type(caught.value) is kind
        assert cure in caught.value.remedy
        assert source.read_file("nothing.dg") is None  # 550
        assert source.read_file("curpos.dg")  # the connection is in step


def test_a_server_that_takes_no_more_clients_says_so() -> None:
    listener = socket.create_server(("127.0.0.1", 0))

    def refuse_client() -> None:
        with listener.accept()[0] as client:
            client.sendall(b"421 Too many users.\r\n")

    thread = threading.Thread(target=refuse_client)
    thread.start()
    address = ControllerAddress("127.0.0.1", listener.getsockname()[1])
    with pytest.raises(CellError, match="421 Too many users") as caught, FtpSource(address):
        pytest.fail("it was taken for a controller")
    assert "close others" in caught.value.remedy
    thread.join(timeout=30)
    listener.close()


def watch_without(server: FanucFtpServer, records: Path, *refused: str) -> int:
    server.faults.replies = {name: [BUSY] * 9 for name in refused}
    return run_command_line(["mastering", "watch", address_of(server), "--records", str(records)])


def test_the_watch_goes_on_without_files_that_are_refused(
    served: FanucFtpServer, tmp_path: Path, capsys
) -> None:
    assert take_record(address_of(served), tmp_path) == ExitCode.PASS
    capsys.readouterr()
    assert watch_without(served, tmp_path, "sysframe.va", "main.ls", "erract.ls") == ExitCode.REFUSED
    line = " ".join(capsys.readouterr().err.split())
    for words in ("NOT COMPARED", "ERRACT.LS (refused: 450 File busy)", "SYSFRAME.VA (", "not given: MAIN"):
        assert words in line
    assert watch_without(served, tmp_path, "main.ls") == ExitCode.PASS
    assert "not given: MAIN" in " ".join(capsys.readouterr().err.split())
    assert watch_without(served, tmp_path, "sysmast.va") == ExitCode.UNREACHABLE
    assert "refuses SYSMAST.VA for now (450 File busy)" in " ".join(capsys.readouterr().err.split())


def test_a_record_names_the_file_that_is_refused(served: FanucFtpServer, tmp_path: Path, capsys) -> None:
    served.faults.replies = {"sysmast.va": [BUSY] * 9}
    assert take_record(address_of(served), tmp_path) == ExitCode.REFUSED
    assert "refuses SYSMAST.VA (450 File busy) for now" in " ".join(capsys.readouterr().err.split())


async def test_a_program_that_cannot_be_written_says_where_to_look(served: FanucFtpServer) -> None:
    address = ControllerAddress("127.0.0.1", served.port)
    async with FtpProgramStore(address, FtpLogin(timeout_s=5.0)) as store:
        with pytest.raises(RefusedError, match=r"refused while writing main\.ls: 550") as caught:
            await store.write_file("main.ls", b"/PROG  MAIN\n/MN\n/POS\n/END\n")
    assert "open in the editor" in caught.value.remedy
