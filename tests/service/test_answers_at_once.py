"""An answer goes out whole, without waiting for its receiver to confirm its head."""

import asyncio
import socket
from typing import Any

import httpx
import uvicorn

from cellcal.service.web.server import WebServer


async def test_what_is_sent_in_two_parts_does_not_wait_for_the_client_to_confirm_the_first() -> None:
    connected: list[int] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            return
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
        for entry in server.connections._open.values():
            line = entry.transport.get_extra_info("socket")
            connected.append(line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
        await send({"type": "http.response.body", "body": b"ok"})

    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        server = WebServer(
            uvicorn.Config(app, lifespan="off", log_level="warning", timeout_graceful_shutdown=2)
        )
        serving = asyncio.create_task(server.serve([listening]))
        try:
            while not (server.started or serving.done()):
                await asyncio.sleep(0.0)
            async with httpx.AsyncClient() as client:
                answer = await client.get(f"http://127.0.0.1:{listening.getsockname()[1]}/")
        finally:
            server.should_exit = True
            await serving
    assert answer.text == "ok"
    assert connected == [1]
