"""Receivers of the cell process's messages besides screens: figures for Prometheus, the site, alarm targets."""

import asyncio
from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import log_failures
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.export.cell_metrics import CellMetrics
from cellcal.service.session_documents import EventContent
from cellcal.service.site.forwarding_process import ForwardingProcess

_SITE, _WEBHOOK = "cellcal.service.site.publisher", "cellcal.service.export.webhook_sender"


class EventSinks:
    """The receivers of one cell's messages. None of them delays the cell process, and none commands anything."""

    def __init__(self, cell_file: Path, config: CellConfig) -> None:
        tables = {_SITE: config.site, _WEBHOOK: config.reports.webhook}
        self._feeds = [
            ForwardingProcess(module, cell_file) for module, table in tables.items() if table is not None
        ]
        self.meter = CellMetrics(config)

    def on_event(self, kind: str, content: EventContent) -> None:
        """Pass on a message of the cell process."""
        with log_failures("figures of the cell"):
            self.meter.on_event(kind, content)
        for feed in self._feeds:
            with log_failures(make_message("words for {receiver}", receiver=feed.title)):
                feed.on_event(kind, content)

    def start_tasks(self) -> list[asyncio.Task[None]]:
        """Begin what runs beside the service; the tasks end when they are cancelled."""
        return [task for feed in self._feeds for task in feed.start_tasks()]
