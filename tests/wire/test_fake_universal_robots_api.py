"""The fake's PolyScope X and CB3 faces, asked by clients that know nothing of the product: requests and sockets."""

import asyncio
import json
import socket
from typing import Any

import pytest
import requests

from cellcal.fake_devices.universal_robots.device import FakeUniversalRobot
from tests.machine_speed import stretched_s
from tests.wire.fake_ur import ROBOT_API_PORT, fake_ur

DEADLINE_S = stretched_s(10.0)
X = {"software": "10.12.1.0"}
EARLY_X = {"software": "10.11.0.0"}
READS = {  # since Robot API 3.1.4
    "/robotstate/v1/robotmode": {"mode": "RUNNING"},
    "/robotstate/v1/safetymode": {"mode": "NORMAL"},
    "/system/v1/controlmode": {"mode": "REMOTE"},
    "/system/v1/operationalmode": {"mode": "AUTOMATIC"},
    "/program/v1/loaded": {"name": "cell.urp"},
}


def base_of(fake: FakeUniversalRobot) -> str:
    return f"http://{fake.server.address}:{ROBOT_API_PORT}/universal-robots/robot-api"


async def call(method: str, url: str, **fields: Any) -> requests.Response:
    body = {"json": fields} if fields else {}
    return await asyncio.to_thread(requests.request, method, url, timeout=DEADLINE_S, **body)


async def test_the_description_of_the_interface_names_every_path_that_answers() -> None:
    async with fake_ur(settings=X) as fake:
        base = base_of(fake)
        document = (await call("GET", f"{base}/openapi.json")).json()
        assert document["info"]["version"] == "3.1.4"
        for path, verbs in document["paths"].items():
            if "get" in verbs:
                assert (await call("GET", base + path)).status_code == 200, path
        assert document["paths"].keys() >= {*READS, "/program/v1/state", "/robotstate/v1/state"}


async def test_the_modes_can_be_read() -> None:
    async with fake_ur(settings=X) as fake:
        for path, expected in READS.items():
            assert (await call("GET", base_of(fake) + path)).json() == expected
        assert (await call("GET", f"{base_of(fake)}/program/v1/state")).json() == {"state": "STOPPED"}


async def test_the_first_robot_api_has_no_modes_and_loads_by_another_path() -> None:
    async with fake_ur(settings=EARLY_X) as fake:
        for path in READS:
            assert (await call("GET", base_of(fake) + path)).status_code == 404
        load = f"{base_of(fake)}/program/v1/load"
        assert (await call("PUT", load, programName="other")).status_code == 200
        assert fake.server.controller.loaded_program == "other"


async def test_power_brakes_and_a_protective_stop_go_by_the_robot_state() -> None:
    async with fake_ur(settings=X) as fake:
        url = f"{base_of(fake)}/robotstate/v1/state"
        for action, mode in (("POWER_OFF", "POWER_OFF"), ("POWER_ON", "IDLE"), ("BRAKE_RELEASE", "RUNNING")):
            assert (await call("PUT", url, action=action)).status_code == 200
            assert (await call("GET", f"{base_of(fake)}/robotstate/v1/robotmode")).json() == {"mode": mode}
        await fake.inject_fault("protective_stop", {})
        safety = f"{base_of(fake)}/robotstate/v1/safetymode"
        assert (await call("GET", safety)).json() == {"mode": "PROTECTIVE_STOP"}
        assert (await call("PUT", url, action="UNLOCK_PROTECTIVE_STOP")).status_code == 200
        assert (await call("GET", safety)).json() == {"mode": "NORMAL"}
        assert (await call("PUT", url, action="DANCE")).status_code == 400


async def test_a_program_is_paused_resumed_and_stopped() -> None:
    async with fake_ur(settings=X) as fake:
        url = f"{base_of(fake)}/program/v1/state"
        assert (await call("PUT", url, action="pause")).status_code == 409
        await fake.inject_fault("other_client_moves", {"axis": "J1", "rad": 2.0, "speed": 0.01})
        for action, state in (("pause", "PAUSED"), ("resume", "PLAYING"), ("stop", "STOPPED")):
            assert (await call("PUT", url, action=action)).json()["state"] == state
            assert (await call("GET", url)).json() == {"state": state}


async def test_orders_are_refused_in_local_control() -> None:
    async with fake_ur(settings=X) as fake:
        await fake.inject_fault("local_mode", {})
        assert (await call("GET", f"{base_of(fake)}/system/v1/controlmode")).json() == {"mode": "LOCAL"}
        answer = await call("PUT", f"{base_of(fake)}/robotstate/v1/state", action="POWER_OFF")
        assert answer.status_code == 403
        assert fake.true_state()["robot_mode"] == "RUNNING"


async def test_a_moved_interface_is_found_by_who_follows_redirects() -> None:
    async with fake_ur(settings=X) as fake:
        await fake.inject_fault("api_moved", {})
        answer = await call("GET", f"{base_of(fake)}/robotstate/v1/robotmode")
        assert answer.history
        assert answer.json() == {"mode": "RUNNING"}


async def test_requests_in_pieces_and_two_in_one_segment_are_answered_in_order() -> None:
    async with fake_ur(settings=X) as fake:
        reader, writer = await asyncio.open_connection(fake.server.address, ROBOT_API_PORT)
        path = "/universal-robots/robot-api/program/v1/state"
        body = b'{"action": "stop"}'
        put = f"PUT {path} HTTP/1.1\r\nHost: x\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body
        get = f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode()
        for piece in (put[:30], put[30:-5], put[-5:] + get):
            writer.write(piece)
            await writer.drain()
        async with asyncio.timeout(DEADLINE_S):
            text = (await reader.read()).decode()
        writer.close()
        await writer.wait_closed()
        states = [json.loads(part.partition("\r\n\r\n")[2])["state"] for part in text.split("HTTP/1.1 ")[1:]]
        assert states == ["STOPPED", "STOPPED"]


def ask_dashboard(address: str, question: str) -> str:
    with socket.create_connection((address, 29999), DEADLINE_S) as link:
        lines = link.makefile("rwb")
        lines.readline()
        lines.write(question.encode() + b"\n")
        lines.flush()
        return lines.readline().decode().strip()


async def test_polyscope_x_has_no_dashboard_and_the_others_no_robot_api() -> None:
    async with fake_ur(settings=X) as new, fake_ur() as old:
        with pytest.raises(ConnectionRefusedError):
            await asyncio.to_thread(ask_dashboard, new.server.address, "robotmode")
        assert await asyncio.to_thread(ask_dashboard, old.server.address, "get robot model") == "UR10"
        with pytest.raises(requests.ConnectionError):
            await call("GET", f"{base_of(old)}/openapi.json")


@pytest.mark.parametrize(
    ("model", "settings", "question", "answer"),
    [
        ("ur5", {}, "PolyscopeVersion", "URSoftware 3.15.8.106339 (Nov 18 2021)"),
        ("ur5", {}, "get robot model", "UR5"),
        ("ur5", {}, "is in remote control", "could not understand: 'is in remote control'"),
        ("ur5", {"software": "3.11.0"}, "get serial number", "could not understand: 'get serial number'"),
        ("ur7e", {"arm": "ur5e", "software": "5.22.0"}, "get robot model", "UR7"),
        ("ur7e", {"arm": "ur5e", "dashboard_model": "UR5"}, "get robot model", "UR5"),
    ],
)
async def test_the_dashboard_answers_as_its_software_does(
    model: str, settings: dict[str, Any], question: str, answer: str
) -> None:
    async with fake_ur(model=model, settings=settings) as fake:
        assert await asyncio.to_thread(ask_dashboard, fake.server.address, question) == answer
