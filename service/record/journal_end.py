"""Whether a journal still has the events that its cell's certificates were issued after.

A chain of hashes shows what was changed; that its end was cut off, or the whole begun anew, shows only from outside.
"""

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.message import make_message
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import Journal, StoreError
from cellcal.service.record.journal_files import certificates_folder, open_journal

NOT_ACCEPTED = "store.end_missing"


def missing_end(config: CellConfig, journal: Journal) -> str:
    """Return in words that a journal's end is missing; "" where it is whole, as far as certificates tell."""
    heads = {event.hash.hex() for event in journal.list_events()}
    for path in sorted(certificates_folder(config).glob("*.json")):
        try:
            head = parse_json(read_plain_bytes(path))["content"]["run"]["journal_head_sha256"]
        except (OSError, ValueError, KeyError, TypeError):
            continue  # `cellcal verify` says what is wrong with it
        if head not in heads:
            return make_message(
                "The end of the journal is missing: {path_name} was issued after an event that it does "
                "not have. Restore a backup of data_dir; or, where it was begun anew on purpose, move "
                "old certificates away.",
                path_name=path.name,
            )
    return ""


def describe_missing_end(config: CellConfig) -> str:
    """Return the same for the journal of a cell, for a screen; "" also where it cannot be read at all."""
    try:
        with open_journal(config) as journal:
            return "" if journal.damage is not None else missing_end(config, journal)
    except StoreError:
        return ""  # a later use of the journal is refused with the cause


def refuse_missing_end(config: CellConfig, journal: Journal, *, accepted: bool) -> str:
    """Refuse to go on from a journal whose end is missing, unless a person has accepted just that.

    Returns in words what was accepted, for the journal; "" where nothing is missing.

    Raises
    ------
    StoreError
        Its code is ``NOT_ACCEPTED``.
    """
    words = "" if journal.damage is not None else missing_end(config, journal)
    if words and not accepted:
        what, _, remedy = words.partition(". ")
        raise StoreError(make_message("{what}.", what=what), remedy=remedy, code=NOT_ACCEPTED)
    return words.partition(". ")[0]
