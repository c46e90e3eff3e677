"""Everything that the desk's words go to besides screens: figures for Prometheus, the site, whoever gets alarms."""

import asyncio
from pathlib import Path
from typing import Any

from cellcal.drivers.supervision import guarded
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.export.meter import Meter
from cellcal.service.site.feed import Feed

_SITE, _WEBHOOK = "cellcal.service.site.publisher", "cellcal.service.export.webhook_sender"


class Outlets:
    """What hangs on the service of one cell. None of it holds up the desk, and none of it commands anything."""

    def __init__(self, cell_file: Path, config: CellConfig) -> None:
        wanted = {_SITE: config.site, _WEBHOOK: config.reports.webhook}
        self._feeds = [Feed(module, cell_file) for module, table in wanted.items() if table is not None]
        self.meter = Meter(config)

    def heard(self, kind: str, content: dict[str, Any]) -> None:
        """Pass on what the desk said."""
        with guarded("figures of the cell"):
            self.meter.heard(kind, content)
        for feed in self._feeds:
            with guarded(f"words for {feed.title}"):
                feed.heard(kind, content)

    def keep(self) -> list[asyncio.Task[None]]:
        """Begin what runs beside the service; the tasks end when they are cancelled."""
        return [task for feed in self._feeds for task in feed.start()]
