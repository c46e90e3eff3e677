"""A person who approves at the command line, by name and PIN, as on the pages."""

from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.service.people.accounts import AccountStore
from cellcal.service.people.errors import PeopleError, WrongSecretError
from cellcal.service.people.pin_hashing import PinHasher, pepper_of
from cellcal.service.people.roles import RIGHTS, Right

_AT = "command line"
_MIND = "Try again; mind how many tries there are: five, then one an hour."


def approve_with_pin(data_dir: Path, name: str, secret: str, right: Right) -> str:
    """Return the name of a person of this cell who has a right and whose PIN this is.

    Raises
    ------
    PeopleError
        The name or the PIN is wrong, there were too many guesses, or the person lacks the right.
    """
    register = AccountStore(data_dir)
    guess = register.note_guess(name, _AT)
    hasher = PinHasher(pepper_of(data_dir))
    register.hold_to_pepper(hasher.pepper_mark)
    account = register.find_person(name)
    if account is None:
        hasher.hash_secret(secret)  # a name that is unknown takes as long as a wrong PIN
    if account is None or not hasher.is_right(account.pin_hash, secret):
        raise WrongSecretError("the name or the PIN", _MIND)
    register.guessed_right(guess, name)
    if right not in RIGHTS[account.role]:
        raise PeopleError(
            make_message("{name} may not {right}.", name=account.name, right=right),
            remedy="Ask an engineer.",
        )
    return account.name
