"""Photos of witness marks: pictures and nothing else, without place, in the journal by hash, on paper by name."""

import base64
import hashlib
import struct
import zlib
from pathlib import Path

import pytest

from cellcal.procedures.run_history import EventKind
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.certificates.printing import html_from, pdf_from
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal_files import open_journal
from cellcal.service.runs.photos import MOST_BYTES, PictureError, plain_picture, store_picture
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import user_frame_scene
from tests.service.printed_documents import HtmlText, PdfReader, squeeze_text, verify_paper
from tests.service.service_client import ServiceClient, open_service_client

RUN = "mastering_recovery-1"
GPS = b"GPS 48.1374 N 11.5755 E"


def png_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png_bytes(*more: bytes, shade: int = 7, side: int = 1) -> bytes:
    head = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    chunks = (
        png_chunk(b"IHDR", head),
        *more,
        png_chunk(b"IDAT", zlib.compress(bytes([0, shade]))),
        png_chunk(b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def jpeg_segment(marker: int, data: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(data) + 2) + data


def jpeg_bytes(*more: bytes, side: int = 8) -> bytes:
    frame = struct.pack(">BHHB", 8, side, side, 1) + bytes((1, 0x11, 0))
    tables = jpeg_segment(0xDB, bytes(65)) + jpeg_segment(0xC0, frame) + jpeg_segment(0xC4, bytes(20))
    scan = jpeg_segment(0xDA, bytes(6)) + b"\x12\x34\xff\x00\x56"
    return b"\xff\xd8" + jpeg_segment(0xE0, b"JFIF\0") + b"".join(more) + tables + scan + b"\xff\xd9"


def under_way(config: CellConfig) -> None:
    with open_journal(config) as journal:
        identity = {"vendor": "FANUC", "model": "M-6iB", "serial": "F-104711", "firmware": "1"}
        cell = {"devices": [{"role": "robot", "identity": identity}]}
        body = {"procedure": "mastering_recovery", "version": 4, "spec": {}, "cell": cell}
        journal.append(RUN, EventKind.STARTED, body, key="started")


def upload_body(raw: bytes) -> dict[str, str]:
    return {"content_base64": base64.b64encode(raw).decode()}


@pytest.mark.parametrize(
    ("raw", "bare"),
    [
        (
            jpeg_bytes(
                jpeg_segment(0xE1, b"Exif\0\0" + GPS), jpeg_segment(0xFE, GPS), jpeg_segment(0xED, GPS)
            ),
            jpeg_bytes(),
        ),
        (jpeg_bytes() + GPS, jpeg_bytes()),
        (png_bytes(png_chunk(b"eXIf", GPS), png_chunk(b"tEXt", GPS), png_chunk(b"iTXt", GPS)), png_bytes()),
        (png_bytes() + GPS, png_bytes()),
    ],
    ids=["jpeg", "jpeg_tail", "png", "png_tail"],
)
def test_where_a_picture_was_taken_is_not_kept(raw: bytes, bare: bytes) -> None:
    assert GPS in raw
    assert plain_picture(raw)[1] == bare


@pytest.mark.parametrize(
    "raw",
    [
        b"<svg xmlns='http://www.w3.org/2000/svg'><script>alert(1)</script></svg>",
        b"GIF89a" + bytes(20),
        b"<html>",
        b"",
        jpeg_bytes()[:40],
        jpeg_bytes()[:-2],
        png_bytes()[:-13],
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff" + bytes(MOST_BYTES),
    ],
)
def test_what_is_no_whole_picture_is_refused(raw: bytes) -> None:
    with pytest.raises(PictureError):
        plain_picture(raw)


async def test_a_photo_is_kept_named_and_served_safely(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        config = service_client.app.state.context.config
        under_way(config)
        await service_client.from_console()
        await _only_runners_take(service_client)
        await service_client.sign_in("Tom")
        at = f"/api/runs/{RUN}/pictures"
        stored_photo = (
            await service_client.post_json(at, upload_body(jpeg_bytes(jpeg_segment(0xE1, GPS))))
        ).json()
        assert stored_photo["sha256"] == hashlib.sha256(jpeg_bytes()).hexdigest()
        assert (stored_photo["who"], stored_photo["what"], stored_photo["media_type"]) == (
            "Tom",
            "witness marks",
            "image/jpeg",
        )
        assert (
            await service_client.post_json(at, upload_body(jpeg_bytes()))
        ).json() == stored_photo  # sent again: kept once
        assert (await service_client.client.get(at)).json() == [stored_photo]
        shown = await service_client.client.get(f"{at}/{stored_photo['sha256']}")
        assert shown.content == jpeg_bytes()
        assert shown.headers["content-type"] == "image/jpeg"
        assert shown.headers["x-content-type-options"] == "nosniff"
        for other in ("0" * 64, "..%2f..%2fcell.toml", stored_photo["sha256"].upper()):
            assert (await service_client.client.get(f"{at}/{other}")).status_code in (400, 404, 422)
        assert (await service_client.post_json(at, upload_body(b"<html>"))).json()["code"] == "picture"
        (path,) = (config.cell.data_dir / "pictures" / RUN).iterdir()
        path.write_bytes(png_bytes())
        altered = await service_client.client.get(f"{at}/{stored_photo['sha256']}")
        assert (altered.status_code, altered.json()["code"]) == (422, "picture")
        with open_journal(config) as journal:
            assert [event.kind for event in journal.list_events(RUN)].count(EventKind.PICTURE) == 1
            assert journal.verify_chain() is None


async def _only_runners_take(service_client: ServiceClient) -> None:
    for name in ("Vera", "Ada"):
        await service_client.sign_in(name)
        refused = await service_client.post_json(f"/api/runs/{RUN}/pictures", upload_body(png_bytes()))
        assert refused.json()["code"] == "people.role", name


async def test_a_run_that_does_not_exist_gets_no_folder(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Tom")
        for name in ("none", "..", "%2e%2e%2fx"):
            assert (
                await service_client.post_json(f"/api/runs/{name}/pictures", upload_body(png_bytes()))
            ).status_code >= 400
        assert not (service_client.app.state.context.config.cell.data_dir / "pictures").exists()


async def test_photos_are_named_on_every_form_and_a_finished_run_takes_none(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), user_frame_scene()
    taken: list[str] = []

    def add_photo() -> None:
        with open_journal(config) as journal:
            run_id = journal.list_events()[-1].run_id
        taken.append(store_picture(config, run_id, png_bytes(), what="witness marks", who="Zoë").sha256)

    touch = made.technician.does["touch_origin"]
    made.technician.does["touch_origin"] = lambda: (touch(), add_photo())[0]
    outcome = await run_in(config, made, "three_point_frame")
    issued = issue_certificate(config, outcome.run_id)
    verify_paper(issued.json_path)
    for form in (
        HtmlText.read_html(html_from(issued.json_path)).text,
        PdfReader(pdf_from(issued.json_path)).read_text(),
        issued.text_path.read_text(),
    ):
        assert taken[0] in squeeze_text(form)
        assert "Zoë" in form
    assert store_picture(config, outcome.run_id, png_bytes(), what="witness marks", who="Ben").who == "Zoë"
    with pytest.raises(PictureError, match="no more"):
        store_picture(config, outcome.run_id, png_bytes(shade=9), what="witness marks", who="Ben")


@pytest.mark.parametrize(
    "raw", [png_bytes(side=60_000), png_bytes(side=0), jpeg_bytes(side=9000), jpeg_bytes(side=0)]
)
def test_a_picture_that_no_browser_should_decode_is_refused(raw: bytes) -> None:
    with pytest.raises(PictureError, match="pixels a side"):
        plain_picture(raw)


def test_a_picture_says_its_size_once() -> None:
    for raw in (png_bytes(png_chunk(b"IHDR", bytes(13))), jpeg_bytes(jpeg_segment(0xC2, bytes(9)))):
        with pytest.raises(PictureError, match="whole"):
            plain_picture(raw)
