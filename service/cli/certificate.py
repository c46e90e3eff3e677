"""``cellcal certificate`` and ``cellcal verify``: what a run may claim, signed; and whether a file still says it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.translation import Locale

if TYPE_CHECKING:
    from cellcal.service.certificates.certificate import IssuedCertificate
    from cellcal.service.record.signing import CellKey

certificate = App(name="certificate", help="Write the signed certificate of a finished run, or show the key.")

CellFile = Annotated[Path, Parameter(name="--cell", help="The cell file (TOML).")]
Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]


@certificate.default
def write_certificate(  # noqa: PLR0913  a command's options are its arguments
    run_id: str,
    /,
    *,
    cell: CellFile,
    out: Path | None = None,
    pdf: Path | None = None,
    html: Path | None = None,
    language: Locale = "en",
    as_json: Json = False,
) -> int:
    """Write the certificate of a finished run as JSON and as text, and print the text.

    The same run gives the same bytes, whenever it is asked for.

    Parameters
    ----------
    run_id
        A run from `cellcal runs`, or `last`; `key` shows the cell's public key instead.
    out
        Folder to write to; the cell's own (data_dir/certificates) when not said.
    pdf
        Write it to this file as well, as PDF/A with drawings and a square code.
    html
        Write it to this file as well, as one page that needs no other file and no other host.
    language
        Of the PDF and the page; what is signed, and the text, are in English.
    """
    import sys

    from cellcal.service.certificates.certificate import issue_certificate
    from cellcal.service.certificates.printing import html_from, pdf_from, write_sheet
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file

    issued = issue_certificate(read_cell_file(cell), run_id, out)
    if as_json:
        print_json(_as_object(issued))
    else:
        sys.stdout.write(read_plain_text(issued.text_path))
    print_issued(issued)
    for path, sheet in ((html, html_from), (pdf, pdf_from)):
        if path is not None:
            write_sheet(path, sheet(issued.json_path, language))
            STDERR_CONSOLE.print(f"printed: {path}", markup=False, soft_wrap=True)
    return 0


@certificate.command
def key(*, cell: CellFile, out: Path | None = None, as_json: Json = False) -> int:
    """Show the cell's public key, which checks its certificates; make the key if there is none.

    Parameters
    ----------
    out
        Write the public key to this file as well; it is not secret.
    """
    import sys

    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.record.signing import station_key

    config = read_cell_file(cell)
    found = station_key(config.cell.data_dir)
    if out is not None:
        out.write_text(found.public_key + "\n", encoding="utf-8")
    if as_json:
        print_json(
            {"public_key": found.public_key, "private_key_file": str(found.path), "created": found.created}
        )
    else:
        sys.stdout.write(found.public_key + "\n")
    _print_key(found)
    STDERR_CONSOLE.print(f"private key: {found.path}", markup=False, soft_wrap=True)
    STDERR_CONSOLE.print(
        "Back it up with data_dir and keep it secret: who has it signs in the name "
        "of this cell. If it is lost, the next certificate makes a new one; certificates signed before stay good "
        "with this public key, so keep that too.",
        markup=False,
    )
    return 0


def verify(file: Path, /, *, key: str | None = None, as_json: Json = False) -> int:
    """Check offline that a certificate or an exported record is what was signed, to the last byte.

    Exit codes: 0 unchanged (and signed by --key, where it is given), 8 tampered, 4 signed by another key than
    --key, 2 unreadable.

    Parameters
    ----------
    file
        The JSON file.
    key
        The public key that must have signed it, from `cellcal certificate key`, or a file that holds it.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.record.signing import CheckedDocument, check_document, read_document, read_public_key

    expected = None if key is None else read_public_key(key)
    raw = read_document(file)
    checked = raw if isinstance(raw, CheckedDocument) else check_document(raw, expected_key=expected)
    if as_json:
        document = {name: getattr(checked, name) for name in ("format", "sha256", "public_key", "sentence")}
        print_json({"finding": checked.finding.value, "key_checked": expected is not None, **document})
    intact = checked.content is not None
    STDERR_CONSOLE.print(f"{file}: {checked.sentence}", style="green" if intact else "bold red", markup=False)
    for line in _what_was_checked(checked, expected):
        STDERR_CONSOLE.print(line, markup=False)
    return _EXITS[checked.finding.value]


_EXITS = {"intact": 0, "tampered": 8, "unknown_key": 4, "unreadable": 2}  # of service/exit_codes.py


def issue_after_run(config: Any, run_id: str, *, quiet: bool = False) -> "IssuedCertificate | None":
    """Write the certificate at the end of a run; that it could not be written changes nothing about the run."""
    from cellcal.calibration.errors import CellError
    from cellcal.service.certificates.certificate import issue_certificate
    from cellcal.service.certificates.printing import print_beside
    from cellcal.service.cli.printing import STDERR_CONSOLE

    try:
        issued = issue_certificate(config, run_id)
    except CellError as error:
        STDERR_CONSOLE.print(f"No certificate: {error}", style="bold red", markup=False)
        return None
    printed = print_beside(issued.json_path)
    if printed.trouble:
        STDERR_CONSOLE.print(f"Not printed: {printed.trouble}", style="bold yellow", markup=False)
    if not quiet:
        print_issued(issued)
        for path in (printed.html_path, printed.pdf_path):
            if path is not None:
                STDERR_CONSOLE.print(f"to print: {path}", markup=False, soft_wrap=True)
    return issued


def print_issued(issued: "IssuedCertificate") -> None:
    """Say where a certificate is, and where the key that signed it was made."""
    from cellcal.service.cli.printing import STDERR_CONSOLE

    _print_key(issued.key)
    name = "refusal record:" if issued.word == "refused" else "certificate:"
    STDERR_CONSOLE.print(f"{name} {issued.json_path}", markup=False, soft_wrap=True)
    STDERR_CONSOLE.print(f"{'as text:':<{len(name)}} {issued.text_path}", markup=False, soft_wrap=True)


def _print_key(found: "CellKey") -> None:
    from cellcal.service.cli.printing import STDERR_CONSOLE

    if found.created:
        STDERR_CONSOLE.print(
            f"A signing key was made for this cell: {found.path}. Back it up; `cellcal certificate key` tells more. "
            "If there was one before, restore it from the backup instead.",
            style="bold yellow",
            markup=False,
        )
    if found.open_to_others:
        STDERR_CONSOLE.print(
            f"Other users of this computer may read {found.path} and sign with it: `chmod 600` it.",
            style="bold yellow",
            markup=False,
        )


def _what_was_checked(checked: Any, expected: str | None) -> list[str]:
    if not checked.sha256:
        return []
    lines = [
        f"format {checked.format}",
        f"content SHA-256 {checked.sha256}",
        f"signed by key {checked.public_key}",
    ]
    if checked.content is None:
        return lines
    lines += _summarise_content(checked.content)
    lines.append("Checked: every byte of the file, the SHA-256 of the content, the ed25519 signature.")
    if expected is None:
        lines.append(
            "Not checked: who owns that key. A signature can be made with any key: get the public key from the "
            "cell and give it with --key."
        )
    else:
        lines.append("Not checked: that the key belongs to whom you believe. That is for you to know.")
    return [*lines, "Not checked: whether what was measured is true."]


def _summarise_content(content: Any) -> list[str]:
    """Return the signed values of the document, so that they can be compared with its text."""
    if not isinstance(content, dict) or "verdict" not in content:
        return []
    run, robot = content["run"], content["devices"][0]["identity"]
    word, ended = str(content["verdict"]["word"]).upper(), str(run["ended_utc"])[:19].replace("T", " ")
    return [
        f"It says: {word}, {run['procedure']} of robot {robot['serial']}, run {run['run_id']}, {ended} UTC"
    ]


def _as_object(issued: "IssuedCertificate") -> dict[str, str]:
    return {
        "run_id": issued.run_id,
        "verdict": issued.word,
        "certificate": str(issued.json_path),
        "text": str(issued.text_path),
        "sha256": issued.sha256,
        "public_key": issued.key.public_key,
    }
