"""Robot Web Services 2 beyond the contract: detection, mastership, the event log, and a client of others."""

import asyncio
import ssl
import urllib.error
import urllib.request
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from rwswrap.RWS import RWS

from cellcal.drivers.abb.robot_web_services.event_log import event_kinds, position_alarms
from cellcal.drivers.abb.robot_web_services.generation import ServiceAddress
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError
from cellcal.drivers.interfaces import AlarmKind, Readiness
from cellcal.fake_devices.listening_port import ListeningPort
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import open_retrying, wait_until
from tests.wire.robot_cases import ROBOTS, open_at_home

CASE = ROBOTS["abb_web_services 2"]
pytestmark = pytest.mark.filterwarnings("ignore:Unverified HTTPS request")  # rwswrap compares no certificate


@pytest.fixture
async def omnicore(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """The ABB on an OmniCore, healthy and at home."""
    async with open_at_home(CASE, cell, fake_client) as robot:
        yield robot
        await CASE.heal(fake_client, robot)


@pytest.fixture
def base_url(cell: CellConfig) -> str:
    config: Any = cell.robot_named(CASE.name)
    return f"https://{config.address}:{config.port}"


async def truth_of(fake_client: FakeCellClient) -> dict[str, Any]:
    return dict((await fake_client.read_truth())["robots"][CASE.name])


@pytest.mark.parametrize(
    ("name", "software"), [("abb", "RobotWare 6.15.04.00"), ("abb_7", "RobotWare 7.21.0+150")]
)
async def test_the_generation_is_found_out_by_itself(cell: CellConfig, name: str, software: str) -> None:
    async with open_retrying(cell.robot_named(name)) as robot:
        assert (await robot.identify()).firmware == software


async def test_a_wrong_password_is_said(cell: CellConfig) -> None:
    config = cell.robot_named(CASE.name).model_copy(update={"password": "wrong"})
    with pytest.raises(RefusedError, match="password"):
        async with config.open():
            pytest.fail("a stranger was let in")


async def test_a_basic_challenge_without_tls_gets_no_password(cell: CellConfig) -> None:
    answers: list[bytes] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        answers.append(await reader.read(4096))
        writer.write(b'HTTP/1.1 401 No\r\nWWW-Authenticate: Basic realm="x"\r\nContent-Length: 0\r\n\r\n')

    async with ListeningPort("127.0.0.1", 0, serve) as port:
        config = cell.robot_named(CASE.name).model_copy(update={"address": "127.0.0.1", "port": port.port})
        with pytest.raises(UnreachableError):
            async with config.open():
                pytest.fail("a stranger was taken for a controller")
    assert answers
    assert not any(b"uthorization" in octets for octets in answers)


async def test_the_certificate_of_the_cell_file_is_compared(
    cell: CellConfig, tmp_path: Path, fake_client: FakeCellClient
) -> None:
    config: Any = cell.robot_named(CASE.name)
    shown = await asyncio.to_thread(ssl.get_server_certificate, (config.address, config.port))
    path = tmp_path / "controller.pem"
    path.write_text(shown)
    async with config.model_copy(update={"certificate": path}).open() as robot:
        assert (await robot.read_condition()).readiness is Readiness.READY
    other = Path(__file__).parents[1] / "data" / "other_controller.pem"
    with pytest.raises(RefusedError, match="certificate of the cell file"):
        async with config.model_copy(update={"certificate": other}).open():
            pytest.fail("another controller was taken for this one")


@asynccontextmanager
async def web_server(status: str, challenge: str) -> AsyncIterator[int]:
    """Answer every request alike; return the port."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        head = f"HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n{challenge}\r\n"
        writer.write(head.encode())
        await writer.drain()

    async with ListeningPort("127.0.0.1", 0, serve) as port:
        yield port.port


async def test_a_controller_without_a_free_session_says_so() -> None:
    async with web_server("503 Service Unavailable", "") as port:
        link = WebLink(
            ServiceAddress("abb", "127.0.0.1", port), ("Default User", "robotics"), deadline_s=20.0
        )
        with pytest.raises(RefusedError, match="no session left"):
            await link.connect()


@pytest.mark.parametrize("kind", ['qop="auth-int"', "qop=auth, algorithm=SHA-512-256"])
async def test_a_digest_of_another_kind_is_refused_in_a_sentence(kind: str) -> None:
    challenge = f'WWW-Authenticate: Digest realm="validusers@robapi.abb", nonce="1", {kind}\r\n'
    async with web_server("401 Unauthorized", challenge) as port:
        link = WebLink(
            ServiceAddress("abb", "127.0.0.1", port), ("Default User", "robotics"), deadline_s=20.0
        )
        await link.connect()
        with pytest.raises(RefusedError, match="digest login of a kind"):
            await link.get_state("/rw/panel/opmode")
        await link.close()


@pytest.mark.parametrize("text", [None, "no certificate"])
async def test_a_certificate_that_is_none_is_named(
    cell: CellConfig, tmp_path: Path, text: str | None
) -> None:
    path = tmp_path / "controller.pem"
    if text is not None:
        path.write_text(text)
    with pytest.raises(RefusedError, match="is no certificate"):
        async with cell.robot_named(CASE.name).model_copy(update={"certificate": path}).open():
            pytest.fail("it went on without")


async def test_a_foreign_client_reads_and_writes_the_simulated_controller(
    omnicore: Any, base_url: str, fake_client: FakeCellClient
) -> None:
    def session() -> tuple[Any, ...]:
        client = RWS(base_url, username="Default User", password="robotics", module="CellcalServer")
        taken = client.toggle_mastership(1).status_code, client.toggle_mastership(0).status_code
        written = client.set_rapid_variable("nTime", 0.75, module="CellcalServer").status_code
        found = (client.get_rapid_variable("nTime", module="CellcalServer"), client.get_modules())
        running = client.is_running()
        stopped = client.stop_RAPID().status_code
        return taken, written, found, running, stopped, client.get_exec_state()

    taken, written, found, running, stopped, after = await asyncio.to_thread(session)
    assert taken == (204, 204)
    assert written == 204
    assert found == ("0.75", ["CellcalServer"])
    assert running is True
    assert (stopped, after) == (204, "stopped")


async def test_mastership_is_held_for_a_motion_only(omnicore: Any, base_url: str) -> None:
    await omnicore.move_joints(CASE.home_rad, speed_rad_s=0.5)
    client = RWS(base_url, username="Default User", password="robotics")
    assert (await asyncio.to_thread(client.toggle_mastership, 1)).status_code == 204
    try:
        with pytest.raises(RefusedError, match="does not allow"):
            await omnicore.move_joints(CASE.away_rad, speed_rad_s=0.5)
        assert await asyncio.to_thread(client.is_running)  # nothing was ordered: nothing was stopped
    finally:
        await asyncio.to_thread(client.toggle_mastership, 0)
    await omnicore.move_joints(CASE.away_rad, speed_rad_s=0.5)


async def test_a_stop_works_although_another_client_has_mastership(
    cell: CellConfig, omnicore: Any, fake_client: FakeCellClient
) -> None:
    move = asyncio.create_task(omnicore.move_joints(CASE.away_rad, speed_rad_s=CASE.slow_rad_s))
    await wait_until(lambda: _moves(fake_client))
    async with open_retrying(cell.robot_named(CASE.name)) as second:
        await second.stop()
    assert not (await truth_of(fake_client))["moving"]
    with pytest.raises(DeviceError):
        await move


async def test_a_lost_counter_is_explained_by_the_log(omnicore: Any, fake_client: FakeCellClient) -> None:
    await fake_client.inject_fault("counters_lost", device=CASE.name, axes=["4"])
    condition = await omnicore.read_condition()
    assert condition.readiness is Readiness.POSITION_LOST
    assert [(alarm.code, alarm.axis, alarm.kind) for alarm in condition.alarms] == [
        ("20032", 3, AlarmKind.TURNS),
        ("20032", None, AlarmKind.TURNS),
    ]
    await fake_client.inject_fault("mend", device=CASE.name)
    assert not (await omnicore.read_condition()).alarms  # what the log tells of the past is no alarm


def test_only_events_that_concern_the_position_are_taken_from_a_log() -> None:
    def entry(code: str, stamp: str, **more: str) -> dict[str, Any]:
        return {"_type": "elog-message-li", "code": code, "tstamp": stamp, "title": f"event {code}", **more}

    found = position_alarms(
        [
            entry("38213", "2026-01-01 T 10:00:00"),
            entry("10002", "2026-01-03 T 10:00:00"),
            entry("38213", "2026-01-02 T 10:00:00"),
            entry("50057", "2026-01-02 T 11:00:00"),
            {"_type": "elog-message-li", "code": "20032"},
            {"_type": "other", "code": "20032", "tstamp": "2027", "title": "x"},
        ]
    )
    assert [(alarm.code, alarm.kind) for alarm in found] == [
        ("50057", AlarmKind.TURNS),
        ("38213", AlarmKind.BATTERY_LOW),
    ]
    assert "2026-01-02" in found[1].text
    assert {AlarmKind.TURNS, AlarmKind.BATTERY_LOW} == set(event_kinds().values())


def test_answers_come_in_the_form_that_was_asked_for(cell: CellConfig, base_url: str) -> None:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE

    def status_of(accept: str) -> tuple[int, str]:
        request = urllib.request.Request(
            f"{base_url}/rw/panel/opmode",
            headers={"Accept": accept, "Authorization": "Basic RGVmYXVsdCBVc2VyOnJvYm90aWNz"},
        )
        try:
            with urllib.request.urlopen(request, context=context) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, ""

    assert status_of("application/json")[0] == 406
    assert '"opmode": "AUTO"' in status_of("application/hal+json;v=2.0")[1]
    assert '<span class="opmode">AUTO</span>' in status_of("application/xhtml+xml;v=2.0")[1]


async def _moves(fake_client: FakeCellClient) -> bool:
    return bool((await truth_of(fake_client))["moving"])
