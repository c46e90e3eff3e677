"""What every route of the service has: the cell file, the cell's process, the open screens, who may come in."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from fastapi import APIRouter

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.people.authentication import Authenticator
from cellcal.service.people.authorization import OrderAuthorizer
from cellcal.service.people.session_control import SessionControl
from cellcal.service.session_documents import OnCellEvent
from cellcal.service.web.cell_client import CellProcessClient
from cellcal.service.web.websocket_hub import OpenScreens


class ServiceExtension(Protocol):
    """Further routes of the service, and its own line to the cell's process: what a demo adds."""

    @property
    def router(self) -> APIRouter:
        """The routes, below ``/api``."""
        ...

    def make_link(self, cell_file: Path, on_event: OnCellEvent) -> CellProcessClient:
        """Return the line to the cell's process."""
        ...


@dataclass(frozen=True, slots=True)
class ServiceSettings:
    """The settings of the service.

    ``open_access`` makes every request the local technician's: for demos on loopback, without a robot. ``extension``
    adds such a demo's routes: with them the pages have buttons that make things go wrong. Names
    other than this computer's own loopback ones are answered only where they stand in ``allowed_hosts``.
    """

    cell_file: Path
    demo: bool = False
    open_access: bool = False
    extension: ServiceExtension | None = None
    tls: bool = False
    allowed_hosts: tuple[str, ...] = ()
    on_console_token: Callable[[str], None] | None = None


@dataclass(frozen=True, slots=True)
class AppContext:
    """The parts that every route uses: the cell's file, its process, the open screens, and who may sign in."""

    settings: ServiceSettings
    config: CellConfig
    link: CellProcessClient
    screens: OpenScreens
    authenticator: Authenticator
    authorizer: OrderAuthorizer
    control: SessionControl
