"""The names of the files that a backup may hold: what the service itself writes into a cell's folders."""

import re

_NAME = r"[\w .@+-]{1,120}"
_ALLOWED = re.compile(
    r"cell\.toml|keys\.sealed"
    r"|data/(journal|people)\.db"
    rf"|data/(last_healthy|shown_position)_{_NAME}\.json"
    rf"|data/certificates/{_NAME}\.(json|txt|pdf|html|csv|svg)"
    rf"|data/pictures/{_NAME}/[0-9a-f]{{64}}\.(jpg|jpeg|png)"
    rf"|data/programs/({_NAME}/){{0,4}}{_NAME}"
    rf"|parameter_sets/{_NAME}/v\d{{4,9}}\.toml",
    re.IGNORECASE,
)


def is_backup_name(path: str) -> bool:
    """Return whether a path is one that a backup may hold; keys stand in it only sealed."""
    parts = path.split("/")
    return _ALLOWED.fullmatch(path) is not None and not any(part.strip(". ") == "" for part in parts)
