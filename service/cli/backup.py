"""``cellcal backup`` and ``cellcal restore``: a cell's data in one file, and back."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.message import make_message

if TYPE_CHECKING:
    from cellcal.service.configuration.cell_file import CellConfig
    from cellcal.service.export.restore import ProvedBackup

Json = Annotated[bool, Parameter(name="--json", negative=())]
Flag = Annotated[bool, Parameter(negative=())]


def backup(  # noqa: PLR0913  a command's options are its arguments
    cell: Path,
    /,
    *,
    to: Path = Path(),
    keys: Flag = False,
    passphrase_file: Path | None = None,
    keep: int | None = None,
    accept_missing_end: Flag = False,
    as_json: Json = False,
) -> int:
    """Keep a cell's data in one file, also while it runs: journal, certificates, people, records, parameter sets.

    Parameters
    ----------
    cell
        The cell file (TOML).
    to
        A new file, or a folder in which it gets a name of cell and time.
    keys
        Also the signing key and the pepper, encrypted under a passphrase. Without them, keep both elsewhere.
    passphrase_file
        A file whose first line is that passphrase, for its owner only; asked for where it is not given.
    keep
        Remove all but so many of this cell's backups in the folder.
    accept_missing_end
        Make it although the end of the journal is missing (`cellcal runs` tells it).
    """
    from cellcal.calibration.errors import CellError
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.export.backup import back_up, forget_older

    if keep is not None and (keep < 1 or not to.is_dir()):
        raise CellError(
            "--keep takes a number from 1 on, and --to a folder.", remedy="Correct it.", code="usage"
        )
    config = read_cell_file(cell)
    _refuse_missing_end(config, accepted=accept_missing_end)
    phrase = _read_passphrase(passphrase_file, twice=True) if keys else None
    made = back_up(config, to, phrase)
    gone = [] if keep is None else forget_older(config, to, keep)
    STDERR_CONSOLE.print(
        f"{made.path}: {made.events} events, {made.certificates} certificates, {made.files} files, "
        f"{made.size / 1e6:.1f} MB.",
        markup=False, soft_wrap=True,
    )  # fmt: skip
    if not made.has_keys:
        STDERR_CONSOLE.print(
            "The signing key and the pepper are not in it: keep signing_key.pem and pepper.key elsewhere, or use "
            "--keys.",
            style="yellow",
        )
    for name in made.left_out:
        STDERR_CONSOLE.print(f"left out, since it is no plain file: {name}", style="yellow", markup=False)
    if as_json:
        print_json(
            {
                "path": str(made.path),
                "events": made.events,
                "certificates": made.certificates,
                "files": made.files,
                "bytes": made.size,
                "has_keys": made.has_keys,
                "left_out": list(made.left_out),
                "removed": [str(path) for path in gone],
            }
        )
    return 0


def restore(  # noqa: PLR0913  a command's options are its arguments
    archive: Path,
    cell: Path | None = None,
    /,
    *,
    passphrase_file: Path | None = None,
    keys: Flag = False,
    check: Flag = False,
    signed_by: str | None = None,
    as_json: Json = False,
) -> int:
    """Put a backup back where nothing is, after every byte, the journal's chain and every certificate were proved.

    Parameters
    ----------
    archive
        The backup.
    cell
        The cell file: its data_dir says where to. One that is not there yet is taken from the backup, and the data
        go to the folder data beside it.
    keys
        Also the keys that are in it.
    passphrase_file
        A file whose first line is their passphrase; asked for where it is not given.
    check
        Only prove it: a drill that needs no cell file and changes nothing.
    signed_by
        The public key of the cell that made the backup, or a file that holds it. --check shows it; compare it with
        a certificate of the cell.
    """
    from cellcal.calibration.errors import CellError
    from cellcal.service.cli.printing import print_json
    from cellcal.service.export.restore import prove_backup
    from cellcal.service.export.restore import restore_backup as put_back
    from cellcal.service.record.signing import read_public_key

    if (cell is None) != check:
        raise CellError(
            "Name a cell file, or --check to look only.",
            remedy="`cellcal restore FILE cell.toml`, or `cellcal restore FILE --check`.",
            code="usage",
        )
    phrase = _read_passphrase(passphrase_file, twice=False) if keys else None
    pinned = None if signed_by is None else read_public_key(signed_by)
    found = (
        prove_backup(archive, phrase) if cell is None else put_back(archive, cell, phrase, signed_by=pinned)
    )
    if pinned not in (None, found.public_key):
        raise CellError(
            f"{archive} is signed by key {found.public_key}, not by {pinned}.",
            remedy="Take the backup that this cell made; do not use this one.",
            code="signature",
        )
    _print_proof(found)
    if as_json:
        document = {name: getattr(found, name) for name in ("cell", "made_utc", "events", "certificates")}
        document |= {
            "public_key": found.public_key,
            "has_keys": found.has_keys,
            "keys_opened": found.keys_opened,
        }
        print_json({**document, "data_dir": None if found.data_dir is None else str(found.data_dir)})
    return 0


def _print_proof(found: "ProvedBackup") -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE

    STDERR_CONSOLE.print(
        f"Whole: {found.cell}, {found.made_utc}, {found.events} events in one chain, {found.certificates} "
        f"certificates as they were signed. The list of files is signed by key {found.public_key}.",
        style="green", markup=False, soft_wrap=True,
    )  # fmt: skip
    if found.data_dir is None:
        return
    STDERR_CONSOLE.print(f"Put back to {found.data_dir}.", markup=False, soft_wrap=True)
    STDERR_CONSOLE.print(
        f"All is as of {found.made_utc}. A robot that was mastered or changed since is not what the records say: "
        "take a new mastering record before anything is recovered from one. Who or what was revoked since is let in "
        "again: look through `cellcal people`.",
        style="yellow",
        markup=False,
    )
    if not found.keys_opened:
        STDERR_CONSOLE.print(
            "No keys were put back: bring signing_key.pem and pepper.key from where you keep them before the service "
            "starts. Without the pepper every PIN has to be set anew; a new signing key is another signature.",
            style="yellow",
        )


def _read_passphrase(file: Path | None, *, twice: bool) -> str:
    from getpass import getpass

    from cellcal.calibration.errors import CellError

    if file is not None:
        handed = str(file.parent) == os.environ.get("CREDENTIALS_DIRECTORY")  # systemd keeps it from others
        if not handed and file.stat().st_mode & 0o077:
            raise CellError(
                make_message("other users of this computer may read {path}.", path=file),
                remedy=make_message("Run: chmod 600 {path}", path=file),
                code="usage",
            )
        return read_plain_text(file).partition("\n")[0].rstrip("\r")
    phrase = getpass("Passphrase of the keys: ")
    if twice and getpass("Once more: ") != phrase:
        raise CellError("the passphrases differ.", remedy="Try again.", code="usage")
    return phrase


def _refuse_missing_end(config: "CellConfig", *, accepted: bool) -> None:
    """Refuse to keep a journal whose end is missing: with --keep it would drive the whole ones out."""
    from cellcal.service.record.journal_end import refuse_missing_end
    from cellcal.service.record.journal_files import journal_path, open_journal

    if journal_path(config).exists():
        with open_journal(config) as journal:
            refuse_missing_end(config, journal, accepted=accepted)
