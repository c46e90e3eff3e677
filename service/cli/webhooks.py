"""``cellcal webhooks secret | show | test``: alarms to another program."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

webhooks = App(
    name="webhooks", help="Send a cell's alarms to another program; `cellcal serve` does it by itself."
)


@webhooks.command
def secret(file: Path, /) -> int:
    """Make the secret that signs what is sent; the receiver needs the same.

    Parameters
    ----------
    file
        A new file; nothing is written over.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.export.webhook_sender import new_secret
    from cellcal.service.files import create_file

    create_file(file, (new_secret() + "\n").encode())
    STDERR_CONSOLE.print(
        f"{file}: give its content to the receiver over a safe way. In the cell file:\n\\[webhook]\n"
        f'url = "https://…"\nsecret_file = "{file}"',
        soft_wrap=True,
    )
    return 0


@webhooks.command
def show(cell: Path, /, *, as_json: Annotated[bool, Parameter(name="--json", negative=())] = False) -> int:
    """Show how deliveries stand: what waits, what was taken, what was refused and why.

    Parameters
    ----------
    cell
        The cell file (TOML) with a [webhook] table.
    """
    import sys

    from cellcal.service.cli.printing import print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.export.webhook_outbox import WebhookOutbox
    from cellcal.service.export.webhook_sender import webhook_of
    from cellcal.service.export.webhook_target import target_of

    config = read_cell_file(cell)
    target = target_of(webhook_of(config))
    with WebhookOutbox(config.cell.data_dir) as outbox:
        standing = outbox.delivery_state()
    document = {name: getattr(standing, name) for name in standing.__slots__}
    if as_json:
        print_json({"host": target.host, **document})
        return 0
    sys.stdout.write(
        f"to {target.host}: {standing.waiting} waiting, {standing.delivered} delivered, {standing.refused} refused, "
        f"{standing.dropped} dropped; last delivered {standing.last_delivered_utc or 'never'}\n"
    )
    if standing.last_error:
        sys.stdout.write(f"last error: {standing.last_error}\n")
    return 0


@webhooks.command
def test(cell: Path, /) -> int:
    """Send one event of the type "test" now, and say what the receiver answers.

    Parameters
    ----------
    cell
        The cell file (TOML) with a [webhook] table.
    """
    import time
    import uuid

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.exit_codes import ExitCode
    from cellcal.service.export.webhook_outbox import event_body
    from cellcal.service.export.webhook_sender import read_secret, signed_headers, webhook_of
    from cellcal.service.export.webhook_target import deliver_event, target_of

    config = read_cell_file(cell)
    table = webhook_of(config)
    body = event_body("test", {"cell": config.cell.name})
    headers = signed_headers(read_secret(table.secret_file), f"evt_{uuid.uuid4().hex}", body, time.time())
    status = deliver_event(target_of(table), body, headers)
    taken = 200 <= status < 300
    STDERR_CONSOLE.print(f"The receiver answers {status}.", style="green" if taken else "bold red")
    return ExitCode.PASS if taken else ExitCode.UNREACHABLE
