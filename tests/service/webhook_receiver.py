"""Another program that takes alarms: a real server on loopback, for tests."""

import base64
import hashlib
import hmac
import http.server
import json
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cellcal.service.configuration.report_tables import WebhookTable

SECRET = bytes(range(32))


@dataclass
class WebhookReceiver:
    """Another program: keeps what it understood by its id, as receivers of webhooks do."""

    port: int
    answers: list[int] = field(default_factory=list)  # instead of 204, one after another
    messages: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    context: ssl.SSLContext | None = None

    @property
    def received_events(self) -> list[tuple[str, str]]:
        once = dict(self.messages)
        return [(message["type"], message["data"]["code"]) for message in once.values()]

    @contextmanager
    def open_receiver(self) -> Iterator["WebhookReceiver"]:
        receiver = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["content-length"]))
                event_id = self.headers["webhook-id"]
                signed = f"{event_id}.{self.headers['webhook-timestamp']}.".encode() + body
                expected_signature = base64.b64encode(
                    hmac.new(SECRET, signed, hashlib.sha256).digest()
                ).decode()
                if self.headers["webhook-signature"] != f"v1,{expected_signature}":
                    self._answer(401)
                    return
                status = receiver.answers.pop(0) if receiver.answers else 204
                if status != 400:
                    receiver.messages.append((event_id, json.loads(body)))
                self._answer(status)

            def _answer(self, status: int) -> None:
                self.send_response(status)
                self.send_header("location", "http://127.0.0.1:1/elsewhere")
                self.send_header("content-length", "0")
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        server = http.server.ThreadingHTTPServer(("127.0.0.1", self.port), Handler)
        if self.context is not None:
            server.socket = self.context.wrap_socket(server.socket, server_side=True)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield self
        finally:
            server.shutdown()
            thread.join()
            server.server_close()


def webhook_table(url: str, folder: Path, **more: Any) -> WebhookTable:
    return WebhookTable(url=url, secret_file=folder / "secret", **more)
