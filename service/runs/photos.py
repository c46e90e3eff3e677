"""Photos of a run, such as of witness marks: checked to be pictures, freed of what a camera adds, hashed, kept.

The picture lies beside the journal, its SHA-256 stands in it: a picture that was altered is not shown any more.
"""

import hashlib
import struct
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.files import make_private_folder, replace_file
from cellcal.service.record.journal import JournalEvent
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore

MOST_BYTES = 180 * 1024  # what a page may send holds it as base64
MOST_A_RUN = 12
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
TYPES = {"image/jpeg": ".jpg", "image/png": ".png"}
_KEPT_CHUNKS = frozenset(
    {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"sRGB", b"cHRM", b"sBIT", b"bKGD"}
)
_KEPT_MARKERS = frozenset(
    {0xE0, 0xEE}
)  # JFIF and Adobe: how colours are stored; the other APPs and comments go
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # starts of frame: the others are tables
MOST_PIXELS_A_SIDE = 8192
_SCAN, _COMMENT, _APPS = 0xDA, 0xFE, range(0xE0, 0xF0)


class PictureError(CellError):
    """A picture cannot be taken in, or is not what was taken in."""

    code = "picture"


@dataclass(frozen=True, slots=True)
class RunPhoto:
    """One photo of a run, as the journal names it."""

    sha256: str
    media_type: str
    bytes: int
    what: str
    who: str
    at_utc: str


def store_picture(config: CellConfig, run_id: str, raw: bytes, *, what: str, who: str) -> RunPhoto:
    """Keep a picture beside a run that has not ended; the same one sent twice is kept once.

    Raises
    ------
    PictureError
        No JPEG or PNG, too large, too many, or the run has ended: its certificate may be out.
    StoreError
        There is no such run.
    """
    media_type, plain = plain_picture(raw)
    sha256 = hashlib.sha256(plain).hexdigest()
    with open_journal(config) as journal:
        view = RunStore(journal).find_run(run_id)
        existing = list(pictures_of_run(journal.list_events(run_id)))
        same = next((one for one in existing if one.sha256 == sha256), None)
        if same is not None:
            return same
        if view.state != "interrupted" or len(existing) >= MOST_A_RUN:
            raise PictureError(
                "this run takes no more pictures.", remedy="Take them while the run is under way."
            )
        path = _picture_path(config, run_id, sha256, media_type)
        make_private_folder(path.parent)
        replace_file(path, plain)  # before it is named: what the journal names is there
        body = {"sha256": sha256, "media_type": media_type, "bytes": len(plain), "what": what, "who": who}
        event = journal.append(run_id, EventKind.PICTURE, body, key=f"picture {sha256}", actor=who)
    return RunPhoto(**body, at_utc=event.wall_utc)  # type: ignore[arg-type]


def pictures_of_run(events: Iterable[JournalEvent]) -> Iterator[RunPhoto]:
    """Yield the pictures that the journal names, oldest first."""
    for event in events:
        if event.kind == EventKind.PICTURE:
            yield RunPhoto(**parse_json(event.body), at_utc=event.wall_utc)


def pictures_to_json(events: Iterable[JournalEvent]) -> list[dict[str, object]]:
    """Return the same for a certificate."""
    return [asdict(one) for one in pictures_of_run(events)]


def read_picture(config: CellConfig, run_id: str, picture: RunPhoto) -> bytes:
    """Return a picture's bytes.

    Raises
    ------
    PictureError
        It is gone, or not what was taken in.
    """
    path = _picture_path(config, run_id, picture.sha256, picture.media_type)
    raw = read_plain_bytes(path) if path.is_file() else b""
    if hashlib.sha256(raw).hexdigest() != picture.sha256:
        raise PictureError("the picture is not what was taken in.", remedy="Restore data_dir from a backup.")
    return raw


def plain_picture(raw: bytes) -> tuple[str, bytes]:
    """Return a picture's type by its first bytes, and the picture without place, camera or comments.

    Raises
    ------
    PictureError
        Too large, or no whole JPEG or PNG.
    """
    if len(raw) > MOST_BYTES:
        raise PictureError(
            make_message("a picture has at most {most_bytes} KiB.", most_bytes=MOST_BYTES >> 10),
            remedy="Take a smaller one.",
        )
    try:
        if raw.startswith(_JPEG):
            return "image/jpeg", b"".join(_of_bounded_size(_jpeg_parts(raw)))
        if raw.startswith(_PNG):
            return "image/png", _PNG + b"".join(_of_bounded_size(_png_parts(raw)))
    except (struct.error, IndexError) as error:
        raise PictureError("the picture did not arrive whole.", remedy="Take it again.") from error
    raise PictureError("that is no picture: JPEG and PNG are taken.", remedy="Take it with the camera.")


def _of_bounded_size(parts: Iterator[bytes]) -> list[bytes]:
    """Return the parts of a picture that says, once, a size which a browser can decode."""
    found = list(parts)
    sizes = [size for part in found if (size := _size_in(part)) is not None]
    if len(sizes) != 1:
        raise IndexError
    if min(sizes[0]) < 1 or max(sizes[0]) > MOST_PIXELS_A_SIDE:
        raise PictureError(
            make_message(
                "a picture has 1 to {most_pixels_a_side} pixels a side.",
                most_pixels_a_side=MOST_PIXELS_A_SIDE,
            ),
            remedy="Take a smaller one.",
        )
    return found


def _size_in(part: bytes) -> tuple[int, int] | None:
    """Return width and height where a part tells them: PNG's IHDR, a JPEG's start of frame."""
    if part[4:8] == b"IHDR":
        width, height = struct.unpack_from(">II", part, 8)
        return width, height
    if part[:1] == b"\xff" and len(part) > 1 and part[1] in _FRAMES:
        height, width = struct.unpack_from(">HH", part, 5)
        return width, height
    return None


def _jpeg_parts(raw: bytes) -> Iterator[bytes]:
    yield raw[:2]
    place = 2
    while True:
        lead, marker, length = struct.unpack_from(">BBH", raw, place)
        if lead != 0xFF or length < 2 or place + 2 + length > len(raw):
            raise IndexError
        if marker == _SCAN:
            yield _to_its_end(raw[place:])
            return
        if marker in _KEPT_MARKERS or (marker != _COMMENT and marker not in _APPS):
            yield raw[place : place + 2 + length]
        place += 2 + length


def _to_its_end(scans: bytes) -> bytes:
    """Return what follows up to the end mark: what a camera hangs behind it, such as a preview, goes."""
    end = scans.rfind(b"\xff\xd9")
    if end < 0:
        raise IndexError
    return scans[: end + 2]


def _png_parts(raw: bytes) -> Iterator[bytes]:
    place = len(_PNG)
    while True:
        length, name = struct.unpack_from(">I4s", raw, place)
        end = place + 12 + length
        if end > len(raw):
            raise IndexError
        if name in _KEPT_CHUNKS:
            yield raw[place:end]
        if name == b"IEND":
            return
        place = end


def _picture_path(config: CellConfig, run_id: str, sha256: str, media_type: str) -> Path:
    return config.cell.data_dir / "pictures" / run_id / f"{sha256}{TYPES[media_type]}"
