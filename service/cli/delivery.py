"""``cellcal program fetch | compare | deliver | restore``: programs of controllers, copied, compared, replaced."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    from cellcal.calibration.errors import CellError
    from cellcal.service.engineering.delivery.deliveries import Approval
    from cellcal.service.engineering.delivery.store_addresses import StoreLogin
    from cellcal.service.engineering.delivery.stored_copies import StoredDelivery

Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]


@Parameter(name="*")
@dataclass(frozen=True)
class LoginOptions:
    """The user that the controller knows."""

    user: Annotated[str, Parameter(name="--user")] = ""
    """User of the controller; the maker's default when none is given."""
    password_file: Annotated[Path | None, Parameter(name="--password-file")] = None
    """File with the user's password."""
    certificate: Annotated[Path | None, Parameter(name="--certificate")] = None
    """The certificate that an ABB controller with RobotWare 7 shows (PEM)."""
    host_keys: Annotated[tuple[str, ...], Parameter(name="--host-key", negative=())] = ()
    """Fingerprint of the SSH key of a Universal Robots controller, SHA256:...; once per controller."""
    timeout_s: Annotated[float, Parameter(name="--timeout")] = 10.0
    """Longest wait for an answer, in seconds."""


@Parameter(name="*")
@dataclass(frozen=True)
class ApprovalOptions:
    """The person who approves."""

    approved_by: Annotated[str, Parameter(name="--approved-by")]
    """The engineer who approves; the PIN is asked for."""
    cell: Annotated[Path, Parameter(name="--cell")]
    """The cell file whose people hold the engineer (`cellcal people add`)."""
    robot_stands: Annotated[bool, Parameter(name="--robot-stands", negative=())] = False
    """Say that the robot stands and no program is selected, where the controller does not tell it."""
    secret_stdin: Annotated[bool, Parameter(name="--secret-stdin", negative=())] = False
    """Read the PIN from standard input, one line."""


_USUAL = LoginOptions()
_WITH_USERS = ("abb://", "fanuc://", "ur://")


def fetch(
    *addresses: str,
    out: Path = Path("controller_programs"),
    login: LoginOptions = _USUAL,
    as_json: Json = False,
) -> int:
    """Copy all programs of a folder of each controller; nothing is written to a controller.

    Example: cellcal program fetch abb://192.168.125.1 fanuc://192.168.0.10 /mnt/kuka --out backup

    Parameters
    ----------
    addresses
        abb://HOST[:PORT][/FOLDER], fanuc://HOST[:PORT], ur://HOST[:PORT][/FOLDER], yaskawa://HOST, or a folder
        such as a controller's mounted share.
    out
        A folder; each controller gets one of its own in it.
    """
    from cellcal.calibration.errors import CellError
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.engineering.delivery.comparison import fetch_programs, folders_below
    from cellcal.service.engineering.delivery.store_addresses import store_at
    from cellcal.service.engineering.delivery.stored_copies import sha256_of

    if not addresses:
        raise CellError("no controller is named.", remedy="Give one or more addresses.", code="usage")
    who = _login(login, *addresses)

    async def fetch_one(address: str) -> dict[str, object]:
        folder = out / _plain_name(address)
        async with store_at(address, who)() as store:
            found = await fetch_programs(store, folder)
            below = ", ".join(await folders_below(store))
        STDERR_CONSOLE.print(f"{address}: {len(found)} programs in {folder}", markup=False, soft_wrap=True)
        if below:
            STDERR_CONSOLE.print(
                f"{address}: its folders {below} are not copied; give each an address of its own",
                markup=False,
                soft_wrap=True,
            )
        sums = {name: sha256_of(content) for name, content in found.items()}
        return {"address": address, "folder": str(folder), "sha256": sums}

    fetched, failures = _fetch_each(addresses, fetch_one)
    if as_json and fetched:
        print_json({"controllers": fetched})
    if failures:
        raise failures[0]
    return 0


def _fetch_each(
    addresses: tuple[str, ...], fetch_one: Callable[[str], Coroutine[Any, Any, dict[str, object]]]
) -> tuple[list[dict[str, object]], "list[CellError]"]:
    """Return what was fetched, and why others were not: one controller that is off keeps none of the others out."""
    from cellcal.calibration.errors import CellError
    from cellcal.service.cli.printing import STDERR_CONSOLE

    fetched: list[dict[str, object]] = []
    failures: list[CellError] = []
    for address in addresses:
        try:
            fetched.append(asyncio.run(fetch_one(address)))
        except CellError as error:
            failures.append(error)
            if len(addresses) > 1:
                STDERR_CONSOLE.print(f"{address}: {error.message}", markup=False, soft_wrap=True)
    return fetched, failures


def compare(address: str, /, *programs: Path, login: LoginOptions = _USUAL, as_json: Json = False) -> int:
    """Compare programs here with those of a controller. Exit code 0: all the same; 3: something differs.

    Parameters
    ----------
    address
        As for `fetch`.
    programs
        Files, or folders whose files are all meant.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE, PlainTable, print_json
    from cellcal.service.engineering.delivery.comparison import (
        ComparedProgram,
        Difference,
        compare_programs,
        folders_below,
        folders_inside,
        read_programs,
    )
    from cellcal.service.engineering.delivery.store_addresses import store_at
    from cellcal.service.exit_codes import ExitCode

    here = read_programs(programs)
    who = _login(login, address)

    async def compare_all() -> tuple[tuple[ComparedProgram, ...], tuple[str, ...]]:
        async with store_at(address, who)() as store:
            return await compare_programs(store, here), await folders_below(store)

    found, below = asyncio.run(compare_all())
    left_out = {"on the controller": list(below), "here": list(folders_inside(programs))}
    table = PlainTable("program", "compared")
    for each in found:
        table.add_row(each.name, str(each.difference))
    STDERR_CONSOLE.print(table)
    for where, folders in left_out.items():
        if folders:
            STDERR_CONSOLE.print(
                f"folders {where} that are not compared: {', '.join(folders)}; name each on both sides",
                markup=False,
                soft_wrap=True,
            )
    if as_json:
        programs_found = {each.name: str(each.difference) for each in found}
        print_json({"address": address, "programs": programs_found, "not_compared": left_out})
    same = all(each.difference is Difference.SAME for each in found)
    return ExitCode.PASS if same else ExitCode.OUT_OF_TOLERANCE


def deliver(
    address: str,
    /,
    *programs: Path,
    approval: ApprovalOptions,
    copies: Path = Path("program_copies"),
    login: LoginOptions = _USUAL,
    as_json: Json = False,
) -> int:
    """Bring programs to a controller; what is there before is kept, and put back where the delivery fails.

    Example: cellcal program deliver abb://192.168.125.1 moved/main.mod --approved-by Eva --cell cell.toml

    Every file is read back and compared. `restore` with the folder that is printed puts the old ones back.

    Parameters
    ----------
    address
        As for `fetch`.
    programs
        Files, or folders whose files are all meant.
    copies
        Where what was there before is kept, with checksums and a signed document.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.delivery.comparison import read_programs
    from cellcal.service.engineering.delivery.deliveries import deliver_programs
    from cellcal.service.engineering.delivery.store_addresses import store_at
    from cellcal.service.engineering.delivery.stored_copies import list_unended

    new = read_programs(programs)
    open_store = store_at(address, _login(login, address))

    def show_line(line: str) -> None:
        STDERR_CONSOLE.print(line, markup=False, soft_wrap=True)

    for earlier in list_unended(copies, address):
        show_line(
            f"A delivery that began {earlier.delivery.begun_utc[:19]} never ended, and programs may be half written. "
            f"Put back what was there before it: cellcal program restore {earlier.folder}"
        )
    delivering = deliver_programs(
        open_store, new, copies, _approval(approval), address,
        on_copies=lambda copied: show_line(f"What is there now is kept in {copied.folder}"),
    )  # fmt: skip
    stored = asyncio.run(delivering)
    _print_delivery(stored, as_json=as_json)
    show_line(f"Put back what was there before: cellcal program restore {stored.folder}")
    return 0


def restore(
    delivery: Path,
    /,
    *,
    approval: ApprovalOptions,
    changed_too: Annotated[bool, Parameter(name="--changed-too", negative=())] = False,
    login: LoginOptions = _USUAL,
    as_json: Json = False,
) -> int:
    """Put back the programs that a delivery replaced; a program that it added is deleted.

    What is on the controller is copied first; `restore` with the folder that is printed brings it there again.

    Parameters
    ----------
    delivery
        The folder that `deliver` printed.
    changed_too
        Replace programs, too, that were changed on the controller since the delivery.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.engineering.delivery.deliveries import restore_programs
    from cellcal.service.engineering.delivery.store_addresses import store_at
    from cellcal.service.engineering.delivery.stored_copies import read_delivery

    stored = read_delivery(delivery)
    open_store = store_at(stored.delivery.address, _login(login, stored.delivery.address))
    restored = asyncio.run(restore_programs(open_store, stored, _approval(approval), changed_too=changed_too))
    _print_delivery(restored.put_back, as_json=as_json)
    if restored.replaced is not None:
        STDERR_CONSOLE.print(
            f"What was replaced now: cellcal program restore {restored.replaced.folder}",
            markup=False,
            soft_wrap=True,
        )
    return 0


def _print_delivery(stored: "StoredDelivery", *, as_json: bool) -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE, PlainTable, print_json

    table = PlainTable(
        "program", "before", "delivered", title=f"{stored.delivery.address}: {stored.delivery.state}"
    )
    for file in stored.delivery.files:
        table.add_row(file.name, (file.old_sha256 or "-")[:12], (file.new_sha256 or "-")[:12])
    STDERR_CONSOLE.print(table)
    if as_json:
        print_json({"folder": str(stored.folder), **stored.delivery.model_dump(mode="json")})


def _approval(options: ApprovalOptions) -> "Approval":
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.engineering.delivery.deliveries import Approval
    from cellcal.service.people.approval import approve_with_pin
    from cellcal.service.people.roles import Right

    data_dir = read_cell_file(options.cell).cell.data_dir
    secret = _ask_secret(from_input=options.secret_stdin)
    name = approve_with_pin(data_dir, options.approved_by, secret, Right.DELIVER_PROGRAMS)
    return Approval(name, options.robot_stands)


def _ask_secret(*, from_input: bool) -> str:
    import sys
    from getpass import getpass

    from cellcal.calibration.errors import CellError

    if from_input:
        return sys.stdin.readline().rstrip("\r\n")
    if not sys.stdin.isatty():
        raise CellError("there is no terminal to ask for a PIN.", remedy="Give --secret-stdin.", code="usage")
    return getpass("PIN or passphrase: ")


def _login(options: LoginOptions, *addresses: str) -> "StoreLogin":
    """Return the login at these addresses; what none of them reads is refused."""
    import re
    from math import isfinite

    from cellcal.calibration.documents.plain_files import read_plain_text
    from cellcal.calibration.errors import CellError
    from cellcal.service.engineering.delivery.store_addresses import StoreLogin

    _refuse_idle_login(options, addresses)
    if not isfinite(options.timeout_s) or not 0.1 <= options.timeout_s <= 600.0:
        raise CellError("--timeout is from 0.1 to 600 seconds.", code="usage")
    password = None
    if options.password_file is not None:
        password = (read_plain_text(options.password_file).splitlines() or [""])[0]
    if any(mark in options.user + (password or "") for mark in "\r\n\0"):
        raise CellError("a user or password holds no line ends.", code="usage")
    if not all(re.fullmatch("SHA256:[A-Za-z0-9+/]{43}", key) for key in options.host_keys):
        raise CellError("--host-key is SHA256: and 43 characters, as ssh-keygen -lf shows it.", code="usage")
    return StoreLogin(options.user, password, options.certificate, options.host_keys, options.timeout_s)


def _refuse_idle_login(options: LoginOptions, addresses: tuple[str, ...]) -> None:
    from cellcal.calibration.errors import CellError

    for option, value, schemes in (
        ("--user", options.user, _WITH_USERS),
        ("--password-file", options.password_file, _WITH_USERS),
        ("--certificate", options.certificate, ("abb://",)),
        ("--host-key", options.host_keys, ("ur://",)),
    ):
        if value and not any(address.startswith(schemes) for address in addresses):
            raise CellError(
                f"{option} has no effect without an address {' or '.join(schemes)}.",
                remedy="Leave out what is not meant.",
                code="usage",
            )


def _plain_name(address: str) -> str:
    return "".join(c if c.isalnum() or c in "._-" else "-" for c in address).strip("-.")[-80:]
