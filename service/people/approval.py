"""A person who approves at the command line, by name and PIN, as on the pages."""

from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.service.people.accounts import AccountStore
from cellcal.service.people.errors import PeopleError
from cellcal.service.people.pin_hashing import PinHasher, pepper_of
from cellcal.service.people.roles import RIGHTS, Right
from cellcal.service.people.secret_check import verify_secret

_AT = "command line"


def approve_with_pin(data_dir: Path, name: str, secret: str, right: Right) -> str:
    """Return the name of a person of this cell who has a right and whose PIN this is.

    Raises
    ------
    PeopleError
        The name or the PIN is wrong, there were too many guesses, or the person lacks the right.
    """
    account = verify_secret(AccountStore(data_dir), lambda: PinHasher(pepper_of(data_dir)), name, secret, _AT)
    if right not in RIGHTS[account.role]:
        raise PeopleError(
            make_message("{name} may not {right}.", name=account.name, right=right),
            remedy="Ask an engineer.",
        )
    return account.name
