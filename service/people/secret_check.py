"""Whether a name and a PIN are those of a person: the same for pages and the command line."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from cellcal.service.people.accounts import Account, AccountStore
from cellcal.service.people.errors import WrongSecretError
from cellcal.service.people.pin_hashing import PinHasher

_TRIES_REMEDY = "Try again; mind how many tries there are: five, then one an hour."


def verify_secret(
    accounts: AccountStore,
    make_hasher: Callable[[], PinHasher],
    name: str,
    secret: str,
    device: str,
    hashing: AbstractContextManager[object] | None = None,
) -> Account:
    """Return the account of a person whose PIN this is; the guess is noted for a device before it is tried.

    ``hashing`` is entered around the hash, which takes much memory.

    Raises
    ------
    PeopleError
        The name or the PIN is wrong, or there were too many guesses.
    """
    guess = accounts.note_guess(name, device)
    with hashing or nullcontext():
        hasher = make_hasher()
        accounts.hold_to_pepper(hasher.pepper_mark)
        account = accounts.find_person(name)
        if account is None:
            hasher.hash_secret(secret)  # a name that is unknown takes as long as a wrong PIN
        is_right = account is not None and hasher.is_right(account.pin_hash, secret)
    if account is None or not is_right:
        raise WrongSecretError("the name or the PIN", _TRIES_REMEDY)
    accounts.guessed_right(guess, name)
    return account
