"""A service without its cell process, a clock to turn, and people with PINs that cost little to check."""

import base64
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import httpx
from argon2 import PasswordHasher
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature
from fastapi import FastAPI

from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.people.authentication import Authenticator
from cellcal.service.people.pin_hashing import PinHasher, pepper_of
from cellcal.service.people.roles import Role
from cellcal.service.web import measurements, procedures, programs, residuals
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.openapi_check import DescribedApi

ORIGIN = "http://127.0.0.1"
PINS = {
    "Vera": "271828",
    "Tom": "314159",
    "Tina": "141421",
    "Emil": "correct horse battery",
    "Ada": "staple tin lamp 7",
}
ROLES = {
    "Vera": Role.VIEWER,
    "Tom": Role.TECHNICIAN,
    "Tina": Role.TECHNICIAN,
    "Emil": Role.ENGINEER,
    "Ada": Role.ADMIN,
}


class ServiceClock:
    """Seconds that pass when told to."""

    def __init__(self) -> None:
        self.now_s = 1_000_000.0

    def __call__(self) -> float:
        return self.now_s

    def pass_by(self, seconds: float) -> None:
        self.now_s += seconds


def cheap_hasher(pepper: bytes) -> PinHasher:
    return PinHasher(pepper, PasswordHasher(time_cost=1, memory_cost=8, parallelism=1))


def with_people(authenticator: Authenticator) -> Authenticator:
    hasher = cheap_hasher(pepper_of(authenticator.data_dir))
    authenticator.accounts.hold_to_pepper(hasher.pepper_mark)
    for name, pin in PINS.items():
        authenticator.accounts.add_person(name, ROLES[name], hasher.hash_secret(pin), "test")
    return authenticator


@dataclass
class TabletKey:
    """A browser's key, as WebCrypto keeps it."""

    key: ec.EllipticCurvePrivateKey = field(default_factory=lambda: ec.generate_private_key(ec.SECP256R1()))
    id: str = ""

    @property
    def spki(self) -> str:
        form = serialization.PublicFormat.SubjectPublicKeyInfo
        return encode_base64url(self.key.public_key().public_bytes(serialization.Encoding.DER, form))

    def sign_challenge(self, challenge: str, origin: str = ORIGIN) -> str:
        text = f"cellcal device sign-in\n{origin}\n{challenge}".encode()
        r, s = decode_dss_signature(self.key.sign(text, ec.ECDSA(hashes.SHA256())))
        return encode_base64url(r.to_bytes(32, "big") + s.to_bytes(32, "big"))

    async def enrol_device(self, service_client: "ServiceClient") -> None:
        token = service_client.authenticator.accounts.create_enrolment("tablet 3", "test")
        answer = await service_client.post_json(
            "/api/sign-in/devices", {"token": token, "public_key": self.spki}
        )
        assert answer.status_code == 200, answer.text
        self.id = answer.json()["device"]

    async def come_in(self, service_client: "ServiceClient") -> httpx.Response:
        challenge = (await service_client.post_json("/api/sign-in/challenges", {})).json()["challenge"]
        proof = {"device": self.id, "challenge": challenge, "signature": self.sign_challenge(challenge)}
        return await service_client.post_json("/api/sign-in/device", proof)


@dataclass
class ServiceClient:
    """The service, as one browser sees it."""

    app: FastAPI
    client: httpx.AsyncClient
    clock: ServiceClock

    @property
    def authenticator(self) -> Authenticator:
        found: Authenticator = self.app.state.context.authenticator
        return found

    async def post_json(self, path: str, content: dict[str, Any]) -> httpx.Response:
        return await self.client.post(path, json=content)

    async def send_order(self, order: dict[str, Any], *, rev: int = 1, press: str = "1") -> httpx.Response:
        return await self.post_json("/api/commands", {"id": press, "rev": rev, "order": order})

    async def sign_in(self, name: str, secret: str | None = None) -> httpx.Response:
        return await self.post_json("/api/sign-in/person", {"name": name, "secret": secret or PINS[name]})

    async def from_console(self) -> httpx.Response:
        token = self.authenticator.console_token()
        return await self.client.get("/api/sign-in/console", params={"token": token})

    def show_question(self, key: str, *, rev: int = 1, prompt_id: str = "run:1") -> dict[str, Any]:
        """Let the cell process have asked a question; return the order that says yes."""
        self.app.state.context.link.session = {"rev": rev, "prompt": {"id": prompt_id, "key": key}}
        return {"op": "answer", "prompt_id": prompt_id}


@asynccontextmanager
async def open_service_client(
    folder: Path, *, people: bool = True, **settings: Any
) -> AsyncIterator[ServiceClient]:
    path = write_cell_file(folder, "127.0.0.1", seed=1, time_factor=1.0)
    app, clock = create_app(ServiceSettings(path, **settings)), ServiceClock()
    data_dir, is_open = read_cell_file(path).cell.data_dir, bool(settings.get("open_access"))
    authenticator = Authenticator(data_dir, is_open, clock=clock, wall_clock=clock, make_hasher=cheap_hasher)
    app.state.context = replace(
        app.state.context, authenticator=with_people(authenticator) if people else authenticator
    )
    async with (
        what_was_begun_ends(app),
        another_browser(app, "https://127.0.0.1" if app.state.context.settings.tls else ORIGIN) as client,
    ):
        yield ServiceClient(app, client, clock)


@asynccontextmanager
async def what_was_begun_ends(app: FastAPI) -> AsyncIterator[None]:
    """End jobs, the solver and the planner as the service does, where its cell process is not started."""
    async with AsyncExitStack() as stack:
        for module in (programs, procedures, residuals, measurements):
            await stack.enter_async_context(module.router.lifespan_context(app))
        yield


def another_browser(app: FastAPI, origin: str = ORIGIN, address: str = "127.0.0.1") -> httpx.AsyncClient:
    """Return a client to whom every answer must be as the service describes it."""
    transport = httpx.ASGITransport(app, raise_app_exceptions=False, client=(address, 50_000))
    hooks = {"response": [DescribedApi(app).check_answer]}
    return httpx.AsyncClient(transport=transport, base_url=origin, event_hooks=hooks)


def encode_base64url(raw: bytes) -> str:
    return base64.urlsafe_b64encode(raw).decode().rstrip("=")
