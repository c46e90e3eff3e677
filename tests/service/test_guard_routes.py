"""Role by route, generated from the service's own routes and orders: what is new must be put into the tables."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts

from cellcal.service.cell_process.messages import Order
from cellcal.service.people.roles import Role
from tests.service.service_client import ORIGIN, ROLES, ServiceClient, another_browser, open_service_client

SIGNED_OUT, DEVICE = "signed out", "a device alone"
ANYBODY = {SIGNED_OUT, DEVICE, *Role}
KNOWN = ANYBODY - {SIGNED_OUT}
RUNNERS = {Role.TECHNICIAN, Role.ENGINEER}

# who may use a route at all; what /api/commands takes is in ORDERS
ROUTES: dict[tuple[str, str], set[str]] = {
    ("GET", "/openapi.json"): KNOWN,
    ("GET", "/metrics"): ANYBODY,  # of this computer, or with a token: test_metrics
    ("GET", "/api/session"): KNOWN,
    ("WS", "/api/screen"): KNOWN,
    ("POST", "/api/commands"): KNOWN,
    ("POST", "/api/commands/second"): KNOWN,
    ("POST", "/api/control"): KNOWN,  # who may ask for it is in test_people_control
    ("GET", "/api/procedures"): KNOWN,
    ("POST", "/api/dry-runs"): KNOWN,
    ("GET", "/api/runs"): KNOWN,
    ("GET", "/api/runs/{run_id}"): KNOWN,
    ("GET", "/api/runs/{run_id}/points"): KNOWN,
    ("GET", "/api/runs/{run_id}/pictures"): KNOWN,
    ("POST", "/api/runs/{run_id}/pictures"): KNOWN,  # who may: test_pictures
    ("GET", "/api/runs/{run_id}/pictures/{sha256}"): KNOWN,
    ("GET", "/api/runs/{run_id}/certificate.json"): KNOWN,
    ("GET", "/api/runs/{run_id}/certificate.pdf"): KNOWN,
    ("GET", "/api/runs/{run_id}/certificate.html"): KNOWN,
    ("GET", "/api/runs/{run_id}/certificate.txt"): KNOWN,
    ("GET", "/api/parameters"): KNOWN,
    ("GET", "/api/parameters/diff"): KNOWN,
    ("GET", "/api/parameters/{robot_serial}"): KNOWN,
    ("GET", "/api/trend"): KNOWN,
    ("GET", "/api/exports/runs.{form}"): KNOWN,
    ("GET", "/api/exports/history.{form}"): KNOWN,
    ("GET", "/api/exports/runs/{run_id}/points.{form}"): KNOWN,
    ("GET", "/api/exports/parameters/{robot_serial}.{form}"): KNOWN,
    ("GET", "/api/runs/{run_id}/certificate/check"): KNOWN,
    ("GET", "/api/runs/{run_id}/against/{other_id}"): KNOWN,
    ("GET", "/api/runs/{run_id}/review"): KNOWN,
    ("POST", "/api/runs/{run_id}/what-if"): KNOWN,  # it computes, and keeps nothing
    ("GET", "/api/parameters/{robot_serial}/displacement"): KNOWN,
    ("POST", "/api/parameters/{robot_serial}/rollback"): KNOWN,  # who may: test_reviews
    ("GET", "/api/programs"): KNOWN,
    ("POST", "/api/programs/jobs"): KNOWN,  # who may make: test_programs_api
    ("GET", "/api/programs/jobs/{job_id}"): KNOWN,
    ("POST", "/api/programs/jobs/{job_id}/stop"): KNOWN,  # who may make: test_programs_api
    ("GET", "/api/programs/jobs/{job_id}/points"): KNOWN,
    ("GET", "/api/programs/jobs/{job_id}/programs.zip"): KNOWN,  # who may make: test_programs_api
    ("GET", "/api/measurements"): KNOWN,
    ("POST", "/api/measurements/jobs"): KNOWN,  # who may begin and save: test_measurements_api
    ("GET", "/api/measurements/jobs/{job_id}"): KNOWN,
    ("POST", "/api/measurements/jobs/{job_id}/stop"): KNOWN,
    ("POST", "/api/measurements/jobs/{job_id}/save"): KNOWN,
    ("GET", "/api/models/{robot}/frames"): KNOWN,
    ("GET", "/api/models/{robot}/uncertainty"): KNOWN,
    ("GET", "/api/models/{robot}.urdf"): KNOWN,
    ("GET", "/api/models/{robot}.json"): KNOWN,
    ("GET", "/api/sign-in"): ANYBODY,
    ("GET", "/api/sign-in/console"): ANYBODY,  # the token says who
    ("GET", "/api/sign-in/people"): KNOWN,
    ("POST", "/api/sign-in/devices"): ANYBODY,
    ("POST", "/api/sign-in/challenges"): ANYBODY,
    ("POST", "/api/sign-in/device"): ANYBODY,
    ("POST", "/api/sign-in/person"): KNOWN,
    ("POST", "/api/sign-in/confirm"): KNOWN,
    ("POST", "/api/sign-in/leave"): KNOWN,
}
BODIES: dict[
    str, dict[str, Any]
] = {  # each is understood, so that only the check before the route can refuse it
    "/api/commands": {"id": "1", "rev": 1, "order": {"op": "stop"}},
    "/api/control": {"do": "withdraw"},
    "/api/dry-runs": {"procedure": "no_such_procedure"},
    "/api/runs/{run_id}/what-if": {"used": []},
    "/api/parameters/{robot_serial}/rollback": {"id": "1", "to": 1, "newest": 2},
    "/api/programs/jobs": {"do": "compensate", "cell": {"kind": "here"}},
    "/api/measurements/jobs": {"file": {"name": "a.csv", "content_base64": "AAAA"}, "robot": "none"},
    "/api/measurements/jobs/{job_id}/save": {"id": "1", "newest": 0},
    "/api/runs/{run_id}/pictures": {"content_base64": "AAAA"},
    "/api/sign-in/person": {"name": "Tom", "secret": "314159"},
    "/api/sign-in/confirm": {"secret": "314159"},
}

ORDERS: dict[str, tuple[dict[str, Any], set[str]]] = {
    "start": ({"procedure": "mastering_record"}, RUNNERS),
    "resume": ({"run_id": "x"}, RUNNERS),
    "answer": ({"prompt_id": "x"}, RUNNERS),
    "decline": ({"prompt_id": "x"}, RUNNERS),
    "stop": ({}, KNOWN),
    "pause": ({}, RUNNERS),
    "go_on": ({}, RUNNERS),
    "select_robot": ({"robot": "x"}, RUNNERS),
    "dismiss": ({}, RUNNERS),
    "sign": ({"run_id": "x", "lines": ["done"]}, RUNNERS),
    "hold": ({"held": False}, KNOWN),  # "held" only over a screen's link
}
NAMES = {role: name for name, role in reversed(ROLES.items())}


def own_routes(app: FastAPI) -> set[tuple[str, str]]:
    found = set()
    for context in iter_route_contexts(app.routes):
        route = context.original_route
        path = context.path or getattr(route, "path", "")
        if not path and getattr(route, "name", "") == "pages":
            continue  # built files; test_guard_wall looks at them
        methods = (context.methods or set()) - {"HEAD"}
        found |= {(method, path) for method in methods} if methods else {("WS", f"/api{route.path}")}
    return found


async def sign_in_as(service_client: ServiceClient, who: str) -> None:
    if who == SIGNED_OUT:
        return
    assert (await service_client.from_console()).status_code == 303
    if who != DEVICE:
        answer = await service_client.sign_in(NAMES[Role(who)])
        assert answer.status_code == 200, answer.text


async def test_every_route_of_the_service_is_in_the_table(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        assert own_routes(service_client.app) - set(ROUTES) == set(), "say in ROUTES who may use it"


async def test_no_route_deletes_or_replaces_what_was_kept(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        assert {method for method, _ in own_routes(service_client.app)} == {"GET", "POST", "WS"}


@pytest.mark.parametrize("who", sorted(ANYBODY))
async def test_a_route_answers_whom_it_is_for(tmp_path: Path, who: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        wrong = []
        for number, (method, path) in enumerate(
            sorted(own_routes(service_client.app) - {("WS", "/api/screen")})
        ):
            # each from an address of its own: one address may not sign in so often
            async with another_browser(service_client.app, address=f"127.0.1.{number}") as browser:
                other = replace(service_client, client=browser)
                await sign_in_as(other, who)
                status = (await _request(other, method, path)).status_code
            if (status == 401) != (who not in ROUTES.get((method, path), KNOWN)) or status in (405, 500):
                wrong.append((method, path, status))
        assert wrong == []


async def _request(service_client: ServiceClient, method: str, path: str) -> httpx.Response:
    filled = re.sub(r"\{\w+\}", "x", path)
    if method == "GET":
        return await service_client.client.get(filled)
    confirms = path == "/api/sign-in/confirm" and service_client.client.cookies
    if confirms:  # only a person has a PIN to give again
        await service_client.sign_in("Tom")
    return await service_client.client.request(method, filled, json=BODIES.get(path, {}))


def test_every_order_is_in_the_table() -> None:
    orders = get_args(get_args(Order)[0])
    assert {order.model_fields["op"].annotation.__args__[0] for order in orders} == set(ORDERS)


@pytest.mark.parametrize("who", sorted(ANYBODY))
async def test_an_order_is_taken_from_whom_may_give_it(tmp_path: Path, who: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        await sign_in_as(service_client, who)
        for op, (fields, allowed) in ORDERS.items():
            service_client.show_question("wire_is_hooked", prompt_id="x")
            answer = await service_client.send_order({"op": op, **fields}, press=op)
            if who in allowed:
                gone = "desk.stop_unconfirmed" if op == "stop" else "desk.gone"
                assert answer.json()["code"] == gone, (
                    op
                )  # it went to the cell process, which does not run here
            else:
                assert answer.status_code == (401 if who == SIGNED_OUT else 403), op


@pytest.mark.parametrize("who", [DEVICE, Role.VIEWER, Role.ADMIN])
async def test_a_viewer_may_release_the_hold_button(tmp_path: Path, who: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        await sign_in_as(service_client, who)
        answer = await service_client.send_order({"op": "hold", "held": False})
        assert answer.json()["code"] == "desk.gone"


@pytest.mark.parametrize("settings", [{"write_anyway": "it will do"}, {"limits": {"a": 1}}])
async def test_a_technician_does_not_change_limits(tmp_path: Path, settings: dict[str, Any]) -> None:
    async with open_service_client(tmp_path) as service_client:
        start = {"op": "start", "procedure": "six_point_tcp", "settings": settings}
        await sign_in_as(service_client, Role.TECHNICIAN)
        assert (await service_client.send_order(start)).json()["code"] == "people.role"
        await service_client.post_json("/api/sign-in/leave", {})
        await sign_in_as(service_client, Role.ENGINEER)
        assert (await service_client.send_order(start)).json()["code"] == "desk.gone"


async def test_a_run_may_be_looked_for_by_any_name_and_nothing_else_is_found(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await sign_in_as(service_client, Role.ENGINEER)
        for name in (
            "..%2f..%2fetc%2fpasswd",
            "%2e%2e",
            "x%00",
            "<script>alert(1)</script>",
            "'; DROP TABLE run;--",
        ):
            answer = await service_client.client.get(f"{ORIGIN}/api/runs/{name}/certificate.json")
            assert answer.status_code in (404, 422), name
            assert answer.headers["content-type"] == "application/json"
