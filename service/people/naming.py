"""Names of people and devices, and what a PIN must be."""

import unicodedata

from cellcal.calibration.message import make_message
from cellcal.service.people.errors import PeopleError
from cellcal.service.people.roles import Role

LONGEST_NAME = 60
LOCAL = "local technician"
_RESERVED = frozenset({LOCAL, "service", "console"})
_PIN_DIGITS = 6
_PASSPHRASE = 12
LONGEST_SECRET = 200


def clean_name(raw: str) -> str:
    """Return a name as it is kept.

    Raises
    ------
    PeopleError
        Empty, too long, taken by the service itself, or with characters that cannot be seen.
    """
    name = unicodedata.normalize("NFC", raw).strip()
    unseen = [each for each in name if unicodedata.category(each)[0] == "C" or each in "\u2028\u2029"]
    if not name or len(name) > LONGEST_NAME or unseen:
        raise PeopleError(
            make_message(
                "a name has 1 to {longest_name} characters that can be seen.", longest_name=LONGEST_NAME
            ),
            remedy="Give another name.",
        )
    if fold_name(name) in _RESERVED:
        raise PeopleError(
            make_message("the name {name!r} is the service's own.", name=name),
            remedy="Give the person's full name.",
        )
    return name


def fold_name(name: str) -> str:
    """Return what two names that look alike to a person have in common."""
    return " ".join(unicodedata.normalize("NFKC", name).casefold().split())


def refuse_weak(secret: str, role: Role) -> None:
    """Refuse a PIN or passphrase that is guessed at once.

    Raises
    ------
    PeopleError
        A viewer or technician has fewer than six digits, or a PIN that is tried first; an engineer or
        administrator has no passphrase of twelve characters.
    """
    wordy = role in (Role.ENGINEER, Role.ADMIN)
    if len(secret) > LONGEST_SECRET:
        raise PeopleError(
            make_message("that is longer than {longest_secret} characters.", longest_secret=LONGEST_SECRET),
            remedy="Give a shorter one.",
        )
    if wordy and len(secret) < _PASSPHRASE:
        raise PeopleError(
            make_message(
                "the passphrase of an {role} has at least {passphrase} characters.",
                role=role,
                passphrase=_PASSPHRASE,
            ),
            remedy="Four words that do not belong together are good.",
        )
    if not wordy and len(secret) < _PIN_DIGITS:
        raise PeopleError(
            make_message("a PIN has at least {pin_digits} digits.", pin_digits=_PIN_DIGITS),
            remedy="Give a longer one.",
        )
    if len(set(secret)) < 3 or secret in "01234567890123456789" or secret in "98765432109876543210":
        raise PeopleError("such a PIN is the first that is tried.", remedy="Give one without a pattern.")
