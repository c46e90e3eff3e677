"""The ``[metrics]`` and ``[webhook]`` tables of a cell file: what other programs are told."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field


class _ReportTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class MetricsTable(_ReportTable):
    """[metrics]: who may read `/metrics`. Without the table only programs on this computer."""

    token_file: Path  # whose first line a reader sends as "Authorization: Bearer …", from this computer, too


class WebhookTable(_ReportTable):
    """[webhook]: where alarms are sent. Without the table nothing leaves the computer."""

    url: str = Field(min_length=1, max_length=2000)
    secret_file: Path  # of `cellcal webhooks secret`: signs what is sent
    private_network: bool = False  # an admin vouches that the receiver is in the plant's own network
    ca_file: Path | None = (
        None  # who vouches for the receiver's certificate (PEM), instead of the system's list
    )


@dataclass(frozen=True)
class ReportTables:
    """The options of reports to other programs."""

    metrics: MetricsTable | None = None
    webhook: WebhookTable | None = None

    def seen_from(self, cell_file: Path) -> "ReportTables":
        """Return them with files as the cell file means them: a relative one from its own folder."""
        here = cell_file.parent
        metrics, webhook = self.metrics, self.webhook
        if metrics is not None:
            metrics = MetricsTable(token_file=here / metrics.token_file.expanduser())
        if webhook is not None:
            ca_file = None if webhook.ca_file is None else here / webhook.ca_file.expanduser()
            secret_file = here / webhook.secret_file.expanduser()
            webhook = webhook.model_copy(update={"secret_file": secret_file, "ca_file": ca_file})
        return ReportTables(metrics, webhook)
