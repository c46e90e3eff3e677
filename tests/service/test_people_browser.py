"""A real browser makes its key, enrols, proves itself and signs a person in; another origin's page gets nowhere."""

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from cellcal.fake_devices.listening_port import ListeningPort
from cellcal.service.people.roles import Role
from tests.service.browser_pages import PATIENCE_MS, open_chromium
from tests.service.service_client import PINS, open_service_client
from tests.service.test_guard_wall import serve_on_socket

SIGN_IN = """async ([token, name, secret]) => {
    const post = async (path, content) => (await fetch('/api/sign-in/' + path, {
        method: 'POST', headers: {'Content-Type': 'application/json'}, body: JSON.stringify(content)})).json();
    const url64 = (bytes) => btoa(String.fromCharCode(...new Uint8Array(bytes)))
        .replaceAll('+', '-').replaceAll('/', '_').replaceAll('=', '');
    const key = await crypto.subtle.generateKey({name: 'ECDSA', namedCurve: 'P-256'}, false, ['sign', 'verify']);
    const {device} = await post('devices', {
        token, public_key: url64(await crypto.subtle.exportKey('spki', key.publicKey))});
    const {challenge} = await post('challenges', {});
    const text = `cellcal device sign-in\\n${location.origin}\\n${challenge}`;
    const signature = url64(await crypto.subtle.sign(
        {name: 'ECDSA', hash: 'SHA-256'}, key.privateKey, new TextEncoder().encode(text)));
    await post('device', {device, challenge, signature});
    await post('person', {name, secret});
    return [(await (await fetch('/api/session')).json()).person, document.cookie];
}"""
FORGE = """(url) => fetch(url + '/api/commands', {method: 'POST', credentials: 'include',
    headers: {'Content-Type': 'text/plain'}, body: '{"id":"1","rev":1,"order":{"op":"stop"}}'})
    .then((answer) => answer.status, (error) => String(error))"""


class AnswerRecorder:
    """ASGI middleware that writes down what was answered: a browser does not tell a page of another origin."""

    def __init__(self, app: Any, statuses: list[tuple[str, int]]) -> None:
        self.app, self.statuses = app, statuses

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        async def send_noted(message: Any) -> None:
            if message["type"] == "http.response.start":
                self.statuses.append((scope["path"], message["status"]))
            await send(message)

        await self.app(scope, receive, send_noted)


async def _a_page(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Answer whatever is asked with a page of another program on this computer."""
    writer.write(
        b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 2\r\nConnection: close\r\n\r\nhi"
    )
    await writer.drain()


async def test_a_browser_enrols_signs_in_and_keeps_its_cookie_from_scripts_and_other_pages(
    tmp_path: Path,
) -> None:
    statuses: list[tuple[str, int]] = []
    async with AsyncExitStack() as stack:
        service_client = await stack.enter_async_context(open_service_client(tmp_path))
        service_client.app.add_middleware(AnswerRecorder, statuses=statuses)
        address = await stack.enter_async_context(serve_on_socket(service_client))
        browser = await stack.enter_async_context(open_chromium())
        page = await browser.new_page()
        page.set_default_timeout(PATIENCE_MS)
        await page.goto(f"http://{address}/icon.svg")
        token = service_client.authenticator.accounts.create_enrolment("tablet 3", "test")
        person, visible_cookies = await page.evaluate(SIGN_IN, [token, "Tom", PINS["Tom"]])
        assert (person["name"], person["role"]) == ("Tom", Role.TECHNICIAN)
        assert visible_cookies == ""
        other = await stack.enter_async_context(ListeningPort("127.0.0.1", 0, _a_page))
        await page.goto(f"http://127.0.0.1:{other.port}/")  # same site: gets the cookie
        assert "Failed to fetch" in str(await page.evaluate(FORGE, f"http://{address}"))
        assert statuses[-1] == ("/api/commands", 403)
