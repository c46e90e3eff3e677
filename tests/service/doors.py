"""A service without its desk, a clock to turn, and people with PINs that cost little to check."""

import base64
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
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
from cellcal.service.web import programs, residuals
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.described import Described

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


class Clock:
    """Seconds that pass when told to."""

    def __init__(self) -> None:
        self.now_s = 1_000_000.0

    def __call__(self) -> float:
        return self.now_s

    def pass_by(self, seconds: float) -> None:
        self.now_s += seconds


def quick(pepper: bytes) -> PinHasher:
    return PinHasher(pepper, PasswordHasher(time_cost=1, memory_cost=8, parallelism=1))


def with_people(entrance: Authenticator) -> Authenticator:
    hasher = quick(pepper_of(entrance.data_dir))
    entrance.accounts.hold_to_pepper(hasher.pepper_mark)
    for name, pin in PINS.items():
        entrance.accounts.add_person(name, ROLES[name], hasher.hash_secret(pin), "test")
    return entrance


@dataclass
class Tablet:
    """A browser's key, as WebCrypto keeps it."""

    key: ec.EllipticCurvePrivateKey = field(default_factory=lambda: ec.generate_private_key(ec.SECP256R1()))
    id: str = ""

    @property
    def spki(self) -> str:
        form = serialization.PublicFormat.SubjectPublicKeyInfo
        return url64(self.key.public_key().public_bytes(serialization.Encoding.DER, form))

    def signature(self, challenge: str, origin: str = ORIGIN) -> str:
        text = f"cellcal device sign-in\n{origin}\n{challenge}".encode()
        r, s = decode_dss_signature(self.key.sign(text, ec.ECDSA(hashes.SHA256())))
        return url64(r.to_bytes(32, "big") + s.to_bytes(32, "big"))

    async def enrol(self, door: "Door") -> None:
        token = door.entrance.accounts.create_enrolment("tablet 3", "test")
        told = await door.post("/api/sign-in/devices", {"token": token, "public_key": self.spki})
        assert told.status_code == 200, told.text
        self.id = told.json()["device"]

    async def come_in(self, door: "Door") -> httpx.Response:
        challenge = (await door.post("/api/sign-in/challenges", {})).json()["challenge"]
        proof = {"device": self.id, "challenge": challenge, "signature": self.signature(challenge)}
        return await door.post("/api/sign-in/device", proof)


@dataclass
class Door:
    """The service, as one browser sees it."""

    app: FastAPI
    client: httpx.AsyncClient
    clock: Clock

    @property
    def entrance(self) -> Authenticator:
        found: Authenticator = self.app.state.house.authenticator
        return found

    async def post(self, path: str, content: dict[str, Any]) -> httpx.Response:
        return await self.client.post(path, json=content)

    async def order(self, order: dict[str, Any], *, rev: int = 1, press: str = "1") -> httpx.Response:
        return await self.post("/api/commands", {"id": press, "rev": rev, "order": order})

    async def sign_in(self, name: str, secret: str | None = None) -> httpx.Response:
        return await self.post("/api/sign-in/person", {"name": name, "secret": secret or PINS[name]})

    async def from_console(self) -> httpx.Response:
        token = self.entrance.console_token()
        return await self.client.get("/api/sign-in/console", params={"token": token})

    def shows(self, key: str, *, rev: int = 1, prompt_id: str = "run:1") -> dict[str, Any]:
        """Let the desk have asked a question; return the order that says yes."""
        self.app.state.house.link.session = {"rev": rev, "prompt": {"id": prompt_id, "key": key}}
        return {"op": "answer", "prompt_id": prompt_id}


@asynccontextmanager
async def a_door(folder: Path, *, people: bool = True, **settings: Any) -> AsyncIterator[Door]:
    path = write_cell_file(folder, "127.0.0.1", seed=1, time_factor=1.0)
    app, clock = create_app(ServiceSettings(path, **settings)), Clock()
    data_dir, is_open = read_cell_file(path).cell.data_dir, bool(settings.get("open_access"))
    entrance = Authenticator(data_dir, is_open, clock=clock, wall_clock=clock, make_hasher=quick)
    app.state.house = replace(app.state.house, entrance=with_people(entrance) if people else entrance)
    async with (
        what_was_begun_ends(app),
        another_browser(app, "https://127.0.0.1" if app.state.house.settings.tls else ORIGIN) as client,
    ):
        yield Door(app, client, clock)


@asynccontextmanager
async def what_was_begun_ends(app: FastAPI) -> AsyncIterator[None]:
    """End jobs and the solver as the service does, where its desk is not started."""
    async with programs.router.lifespan_context(app), residuals.router.lifespan_context(app):
        yield


def another_browser(app: FastAPI, origin: str = ORIGIN, address: str = "127.0.0.1") -> httpx.AsyncClient:
    """Return a client to whom every answer must be as the service describes it."""
    transport = httpx.ASGITransport(app, raise_app_exceptions=False, client=(address, 50_000))
    hooks = {"response": [Described(app).check]}
    return httpx.AsyncClient(transport=transport, base_url=origin, event_hooks=hooks)


def url64(raw: bytes) -> str:
    return base64.urlsafe_b64encode(raw).decode().rstrip("=")
