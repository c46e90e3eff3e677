"""``cellcal people``: who may sign in at a cell, with which role, on which devices."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from cellcal.calibration.message import make_message

if TYPE_CHECKING:
    from cellcal.service.people.accounts import AccountStore
    from cellcal.service.people.pin_hashing import PinHasher
    from cellcal.service.people.roles import Role

people = App(name="people", help="People, roles, PINs and enrolled devices of a cell's service.")

CellFile = Annotated[Path, Parameter(name="--cell", help="The cell file (TOML).")]
RoleName = Annotated[
    Literal["viewer", "technician", "engineer", "admin"],
    Parameter(
        name="--role",
        help="viewer looks on and stops; technician runs procedures; engineer also writes alone and changes "
        "limits; admin keeps people and devices and runs nothing.",
    ),
]
FromInput = Annotated[
    bool, Parameter(name="--secret-stdin", negative=(), help="Read the PIN from standard input, one line.")
]
Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]


@people.command
def add(name: str, /, *, cell: CellFile, role: RoleName, secret_stdin: FromInput = False) -> int:
    """Add a person; the PIN or passphrase is asked for.

    Parameters
    ----------
    name
        As it will stand in runs and certificates; never given to another person again.
    """
    register, hasher = _open_with_hasher(cell)
    kept_name = register.add_person(
        name, _parse_role(role), _ask_pin_hash(hasher, _parse_role(role), secret_stdin), _administrator_name()
    )
    _print_message(f"{kept_name} may sign in as {role}.")
    return 0


@people.command
def reset(
    name: str, /, *, cell: CellFile, role: RoleName | None = None, secret_stdin: FromInput = False
) -> int:
    """Set a person's PIN anew, and the role where one is given; wrong guesses are forgotten, sessions end.

    Parameters
    ----------
    name
        The person.
    """
    from cellcal.service.people.errors import PeopleError

    register, hasher = _open_with_hasher(cell)
    account = register.find_person(name)
    if account is None:
        raise PeopleError(
            make_message("there is no {name!r} here.", name=name),
            remedy="`cellcal people list` lists all people.",
        )
    new = account.role if role is None else _parse_role(role)
    register.reset_person(name, new, _ask_pin_hash(hasher, new, secret_stdin), _administrator_name())
    _print_message(f"{account.name} may sign in as {new}, with the new PIN.")
    return 0


@people.command
def remove(name: str, /, *, cell: CellFile) -> int:
    """Let a person sign in no longer. The name stays in what was signed, and is not given again.

    Parameters
    ----------
    name
        The person.
    """
    _open_accounts(cell).remove_person(name, _administrator_name())
    _print_message(f"{name} may sign in no longer; sessions have ended.")
    return 0


@people.command(name="list")
def list_people(*, cell: CellFile, as_json: Json = False) -> int:
    """List people and devices."""
    import sys
    from datetime import UTC, datetime

    from cellcal.service.cli.printing import print_json

    register = _open_accounts(cell)
    who = [{"name": each.name, "role": each.role} for each in register.list_people()]
    devices = [
        {
            "id": each.id,
            "name": each.name,
            "enrolled_utc": datetime.fromtimestamp(each.enrolled_at, UTC).isoformat(timespec="seconds"),
        }
        for each in register.list_devices()
    ]
    if as_json:
        print_json({"people": who, "devices": devices})
        return 0
    lines = [f"{each['name']:<30} {each['role']}" for each in who]
    lines += [f"device {each['id']}  {each['name']:<30} since {each['enrolled_utc']}" for each in devices]
    sys.stdout.write(
        "\n".join(lines or ["No person is set up; the browser at this computer is the technician."])
    )
    sys.stdout.write("\n")
    return 0


@people.command
def enrol_device(name: str, /, *, cell: CellFile, url: str = "http://localhost:8470") -> int:
    """Print an address, and its QR code, that enrols one browser within ten minutes; it works once.

    Parameters
    ----------
    name
        What the device is called, for example "tablet 3".
    url
        The service's address as the device sees it.
    """
    import sys
    from urllib.parse import urlsplit

    import segno

    from cellcal.calibration.errors import CellError
    from cellcal.service.web.middleware import is_loopback

    parts = urlsplit(url)
    usable = parts.scheme == "https" or (parts.scheme == "http" and is_loopback(parts.hostname or ""))
    if not usable or not parts.hostname:
        raise CellError(
            f"--url {url} is no address that a device can be enrolled at: browsers make keys for https only.",
            remedy="Give https://NAME:PORT of the service.",
            code="usage",
        )
    token = _open_accounts(cell).create_enrolment(name, _administrator_name())
    address = f"{parts.scheme}://{parts.netloc}/#/enrol/{token}"
    if sys.stdout.isatty():
        segno.make(address, error="m").terminal(sys.stdout, compact=True)
    sys.stdout.write(f"{address}\n")
    _print_message("Open it on the device within ten minutes; it works once.")
    return 0


@people.command
def revoke_device(device_id: str, /, *, cell: CellFile) -> int:
    """Let a lost device in no longer; its sessions end at once.

    Parameters
    ----------
    device_id
        As `cellcal people list` shows it.
    """
    device = _open_accounts(cell).revoke_device(device_id, _administrator_name())
    _print_message(f"{device.name} ({device.id}) is let in no longer.")
    return 0


def _open_accounts(cell: Path) -> "AccountStore":
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.people.accounts import AccountStore

    return AccountStore(read_cell_file(cell).cell.data_dir)


def _open_with_hasher(cell: Path) -> "tuple[AccountStore, PinHasher]":
    from cellcal.service.people.pin_hashing import PinHasher, pepper_of

    register = _open_accounts(cell)
    hasher = PinHasher(pepper_of(register.path.parent))
    register.hold_to_pepper(hasher.pepper_mark)
    return register, hasher


def _parse_role(name: str) -> "Role":
    from cellcal.service.people.roles import Role

    return Role(name)


def _ask_pin_hash(hasher: "PinHasher", role: "Role", from_input: bool) -> str:
    """Ask for a PIN twice, unseen, and return what is kept of it."""
    import sys
    from getpass import getpass

    from cellcal.calibration.errors import CellError
    from cellcal.service.people.naming import refuse_weak

    if from_input:
        secret = sys.stdin.readline().rstrip("\r\n")
    elif sys.stdin.isatty():
        secret = getpass("PIN or passphrase: ")
        if getpass("Once more: ") != secret:
            raise CellError("the two are not the same.", remedy="Try again.", code="usage")
    else:
        raise CellError("there is no terminal to ask for a PIN.", remedy="Give --secret-stdin.", code="usage")
    refuse_weak(secret, role)
    return hasher.hash_secret(secret)


def _administrator_name() -> str:
    """Return who types here, for the log: the user of this computer."""
    from cellcal.drivers.operator.terminal_user import terminal_user

    return f"{terminal_user()} (command line)"


def _print_message(text: str) -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE

    STDERR_CONSOLE.print(text, markup=False, soft_wrap=True)
