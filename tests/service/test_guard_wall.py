"""The wall on loopback: other names, other pages, forged posts, tricks in paths, floods; and the headers."""

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from cellcal.service.web.middleware import HEADERS, MOST_BYTES, RequestBudget, RequestFilter
from cellcal.service.web.pages import DIST
from tests.machine_speed import stretched_s
from tests.service.browser_pages import serve_app
from tests.service.service_client import (
    ORIGIN,
    ServiceClient,
    ServiceClock,
    TabletKey,
    another_browser,
    open_service_client,
)

STOP = {"id": "1", "rev": 1, "order": {"op": "stop"}}


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "127.0.0.1.evil.example",
        "localhost.evil.example:8470",
        "",
        "127.0.0.1@evil.example",
        "10.0.0.7",
        "[::2]:80",
        "0.0.0.0",
    ],
)
async def test_other_names_are_not_answered_on_loopback_either(tmp_path: Path, host: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        answer = await service_client.client.get("/api/session", headers={"host": host})
        assert (answer.status_code, answer.json()["code"]) == (421, "guard.host")


@pytest.mark.parametrize(
    "host", ["127.0.0.1:9", "localhost", "LOCALHOST:8470", "[::1]:8470", "127.3.2.1", "cell7.plant"]
)
async def test_its_own_names_are_answered(tmp_path: Path, host: str) -> None:
    async with open_service_client(tmp_path, allowed_hosts=("cell7.plant",)) as service_client:
        assert (await service_client.client.get("/api/sign-in", headers={"host": host})).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},  # another program of this computer
        {"origin": "https://127.0.0.1"},
        {"origin": "http://127.0.0.1.evil.example"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"},  # a form of another page
    ],
)
async def test_a_page_of_another_address_orders_nothing(tmp_path: Path, headers: dict[str, str]) -> None:
    async with open_service_client(tmp_path, people=False) as service_client:
        await service_client.from_console()
        answer = await service_client.client.post("/api/commands", json=STOP, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (403, "guard.origin")
        own = await service_client.client.post("/api/commands", json=STOP, headers={"origin": ORIGIN})
        assert own.json()["code"] == "desk.stop_unconfirmed"


@pytest.mark.parametrize(
    "kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", ""]
)
async def test_what_a_form_can_send_is_not_taken(tmp_path: Path, kind: str) -> None:
    async with open_service_client(tmp_path, people=False) as service_client:
        await service_client.from_console()
        answer = await service_client.client.post(
            "/api/commands", content=json.dumps(STOP), headers={"content-type": kind}
        )
        assert answer.status_code == 415


async def test_no_other_origin_is_allowed_to_read(tmp_path: Path) -> None:
    async with open_service_client(tmp_path, people=False) as service_client:
        await service_client.from_console()
        request_headers = {"origin": "https://evil.example", "access-control-request-method": "POST"}
        for answer in (
            await service_client.client.options("/api/commands", headers=request_headers),
            await service_client.client.get("/api/session", headers={"origin": "https://evil.example"}),
        ):
            assert answer.status_code == 403
            assert not any(name.startswith("access-control") for name in answer.headers)


async def test_the_cookie_stays_with_the_browser_and_the_site(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        cookie = (await service_client.from_console()).headers["set-cookie"].lower()
        assert {"httponly", "samesite=strict", "path=/", "max-age=43200"} <= set(cookie.split("; "))
        assert "domain" not in cookie
    async with open_service_client(tmp_path, people=False, tls=True) as service_client:
        cookie = (await service_client.from_console()).headers["set-cookie"]
        assert cookie.startswith("__Host-cellcal")
        assert "secure" in cookie.lower()


async def test_a_long_body_and_one_that_says_a_false_length_are_refused(tmp_path: Path) -> None:
    async with open_service_client(tmp_path, people=False) as service_client:
        await service_client.from_console()

        async def without_end() -> AsyncIterator[bytes]:
            for _ in range(MOST_BYTES // 65536 + 2):
                yield b" " * 65536

        answer = await service_client.client.post(
            "/api/commands", content=without_end(), headers={"content-type": "application/json"}
        )
        assert answer.status_code == 413


@pytest.mark.parametrize(
    "path",
    [
        "/../pyproject.toml",
        "/%2e%2e/pyproject.toml",
        "/assets/..%2f..%2f..%2fpyproject.toml",
        "/assets/%252e%252e/x",
        "//etc/passwd",
        "/assets/..%5c..%5cx",
        "/api/../api/session",
        "/x%00.html",
        "/assets/.%2e/index.html",
        "/%0d%0aX: y",
    ],
)
async def test_no_path_leads_out(tmp_path: Path, path: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        scope = {
            "type": "http", "method": "GET", "path": path, "raw_path": path.encode(), "query_string": b"",
            "headers": [(b"host", b"127.0.0.1")], "server": ("127.0.0.1", 80), "client": ("127.0.0.1", 1),
            "scheme": "http", "http_version": "1.1", "root_path": "", "asgi": {"version": "3.0"},
        }  # fmt: skip
        answers: list[dict[str, object]] = []

        async def send(message: object) -> None:
            answers.append(dict(message))  # type: ignore[call-overload]

        async def receive() -> dict[str, object]:
            return {"type": "http.request", "body": b"", "more_body": False}

        await service_client.app(scope, receive, send)  # httpx would tidy the path up
        assert answers[0]["status"] == 404
        assert b"project" not in bytes(answers[1]["body"])  # type: ignore[call-overload]


async def test_unknown_paths_reveal_nothing(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        for path in (
            "/openapi.json",
            "/docs",
            "/redoc",
            "/api/nothing",
            "/.env",
            "/assets/nothing.js",
        ):
            assert (await service_client.client.get(path)).status_code == 401, path


async def test_every_answer_has_the_headers_even_a_refusal_and_a_fault(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:

        async def break_down() -> None:
            raise RuntimeError("secret of the program")

        service_client.app.router.routes.insert(0, _make_route("/api/broken", break_down))
        refused = await service_client.client.get("/api/session")
        await service_client.from_console()
        broken = await service_client.client.get("/api/broken")
        missing = await service_client.client.get("/api/nothing")
        good = await service_client.client.get("/api/session")
        assert [a.status_code for a in (refused, broken, missing, good)] == [401, 500, 404, 200]
        for answer in (refused, broken, missing, good):
            assert {name: answer.headers[name] for name in HEADERS} == dict(HEADERS)
            assert answer.headers["cache-control"] == "no-store"
            assert "secret" not in answer.text
            assert "Traceback" not in answer.text


def _make_route(path: str, endpoint: object) -> object:
    from fastapi.routing import APIRoute

    return APIRoute(path, endpoint, include_in_schema=False)  # type: ignore[arg-type]


async def test_a_document_made_here_runs_no_script(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        from starlette.responses import HTMLResponse

        async def page() -> HTMLResponse:
            return HTMLResponse("<script>alert(1)</script>")

        service_client.app.router.routes.insert(0, _make_route("/api/page", page))
        await service_client.from_console()
        policy = (await service_client.client.get("/api/page")).headers["content-security-policy"]
        assert policy.startswith("sandbox; default-src 'none'")
        assert "script-src" not in policy


def test_the_built_pages_need_nothing_that_the_policy_forbids() -> None:
    pages = list(DIST.glob("*.html"))
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<script(?![^>]*\bsrc=)", text), "an inline script"
        assert not re.search(r"\son\w+=|\sstyle=|<style", text)
        assert not re.search(r"(?:src|href)=\"(?:https?:)?//", text)


async def test_a_flood_waits_and_a_stop_still_gets_through(tmp_path: Path) -> None:
    few = {
        kind: RequestBudget(burst=5.0, rate_hz=1.0, clock=ServiceClock())
        for kind in ("sign-in", "orders", "else")
    }
    async with open_service_client(tmp_path, people=False) as service_client:
        service_client.app.add_middleware(RequestFilter, pages=frozenset(), budgets=few)
        await service_client.from_console()
        answers = [await service_client.client.get("/api/sign-in") for _ in range(6)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 200, 429, 429]
        assert answers[-1].headers["retry-after"] == "1"
        assert (await service_client.client.post("/api/commands", json=STOP)).json()[
            "code"
        ] == "desk.stop_unconfirmed"


def test_a_budget_fills_again_and_is_each_address_s_own() -> None:
    clock = ServiceClock()
    budget = RequestBudget(burst=3.0, rate_hz=1.0, clock=clock)
    assert [budget.spend_request("a") for _ in range(4)] == [True, True, True, False]
    assert budget.spend_request("b")
    clock.pass_by(1.0)
    assert [budget.spend_request("a") for _ in range(2)] == [True, False]
    for number in range(10000):
        clock.pass_by(0.01)
        budget.spend_request(str(number))
    assert len(budget._remaining) < 5000


@asynccontextmanager
async def serve_on_socket(service_client: ServiceClient) -> AsyncIterator[str]:
    """The same service on a real socket, without its cell process."""
    async with serve_app(service_client.app, lifespan="off", log_level="critical") as url:
        yield url.removeprefix("http://")


async def test_a_screen_needs_a_session_and_its_own_page(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client, serve_on_socket(service_client) as address:
        url = f"ws://{address}/api/screen"
        with pytest.raises(InvalidStatus):
            await connect(url)
        async with httpx.AsyncClient(base_url=f"http://{address}") as client:
            token = service_client.authenticator.console_token()
            await client.get("/api/sign-in/console", params={"token": token})
            cookie_header = {"cookie": "; ".join(f"{name}={value}" for name, value in client.cookies.items())}
        with pytest.raises(InvalidStatus):
            await connect(url, additional_headers=cookie_header, origin="http://evil.example")
        with pytest.raises(InvalidStatus):
            await connect(
                url, additional_headers=cookie_header | {"host": f"evil.example:{address.split(':')[1]}"}
            )
        async with connect(url, additional_headers=cookie_header, origin=f"http://{address}"):
            pass


async def test_a_screen_of_a_revoked_device_sees_nothing_more(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client, serve_on_socket(service_client) as address:
        tablet = TabletKey()
        await tablet.enrol_device(service_client)
        port = int(address.split(":")[1])
        token = service_client.authenticator.sessions.open_session(tablet.id)
        cookie = {"cookie": f"cellcal-{port}={token}"}
        async with connect(f"ws://{address}/api/screen", additional_headers=cookie) as screen:
            service_client.authenticator.accounts.revoke_device(tablet.id, "test")
            await screen.send('{"op": "hold", "held": false}')
            with pytest.raises(ConnectionClosed):
                await _everything_from(screen)


async def _everything_from(screen: ClientConnection) -> None:
    async with asyncio.timeout(stretched_s(90.0)):
        while True:  # what was on its way before may still come
            await screen.recv()


async def test_a_second_cell_on_this_computer_ends_no_session(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        names = set()
        for port in (8470, 8471):
            async with another_browser(service_client.app, f"http://127.0.0.1:{port}") as client:
                token = service_client.authenticator.console_token()
                await client.get("/api/sign-in/console", params={"token": token})
                with contextlib.suppress(KeyError):
                    names |= set(client.cookies)
        assert len(names) == 2
