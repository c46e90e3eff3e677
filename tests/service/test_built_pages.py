"""The pages as they are built and served: light enough for a slow link, packed beforehand, kept by the browser."""

import gzip
import re
from pathlib import Path

import httpx
import pytest

from cellcal.service.web.pages import DIST, page_paths
from tests.service.service_client import open_service_client

MOST_BYTES = 450_000  # of the first view with its picture, as ux.md has it
SHELL = re.compile(r'(?:src|href)="\./([^"]+)"')
LATER = ("scene-*.js", "de-*.js")  # the picture, and the longest language that is fetched by itself
SMALL = 1000


def first_view() -> list[str]:
    """Return the paths of all that a page loads until the robot's picture stands."""
    assert (DIST / "index.html").is_file(), "The pages are not built: run `make pages`."
    shell = SHELL.findall((DIST / "index.html").read_text(encoding="utf-8"))
    later = [found for pattern in LATER for found in sorted((DIST / "assets").glob(pattern))]
    assert len(later) >= len(LATER)
    return ["/", *(f"/{name}" for name in shell), *(f"/assets/{file.name}" for file in later)]


async def fetch_raw(client: httpx.AsyncClient, path: str, encoding: str) -> tuple[httpx.Response, bytes]:
    """Ask for a file and return the answer with its bytes as they came over the wire."""
    async with client.stream("GET", path, headers={"accept-encoding": encoding}) as answer:
        return answer, b"".join([chunk async for chunk in answer.aiter_raw()])


@pytest.mark.parametrize("encoding", ["gzip", "gzip, deflate, br, zstd"])
async def test_the_first_view_with_its_picture_is_light(tmp_path: Path, encoding: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        sizes = {}
        for path in first_view():
            answer, body = await fetch_raw(service_client.client, path, encoding)
            assert answer.status_code == 200, path
            sizes[path] = len(body) + sum(len(name) + len(value) + 4 for name, value in answer.headers.raw)
    assert 100_000 < sum(sizes.values()) <= MOST_BYTES, sizes


async def test_what_is_packed_is_what_was_built_and_says_so(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        for path in first_view():
            file = DIST / path.removeprefix("/") if path != "/" else DIST / "index.html"
            plain, body = await fetch_raw(service_client.client, path, "identity")
            assert body == file.read_bytes()
            assert "content-encoding" not in plain.headers
            if len(body) < SMALL:
                continue
            packed, short = await fetch_raw(service_client.client, path, "gzip")
            assert packed.headers["content-encoding"] == "gzip"
            assert packed.headers["content-type"] == plain.headers["content-type"]
            assert gzip.decompress(short) == body
            better, shorter = await fetch_raw(service_client.client, path, "gzip, br")
            assert better.headers["content-encoding"] == "br"
            assert len(shorter) < len(short)
            for answer in (plain, packed, better):
                assert answer.headers["vary"] == "Accept-Encoding"


async def test_a_browser_keeps_assets_and_asks_for_the_page_again(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        for path in first_view():
            answer = await service_client.client.get(path)
            cache_control = "no-cache" if "/assets/" not in path else "public, max-age=31536000, immutable"
            assert answer.headers["cache-control"] == cache_control, path
            again = await service_client.client.get(path, headers={"if-none-match": answer.headers["etag"]})
            assert again.status_code == 304
            assert again.content == b""
            if "content-encoding" in answer.headers:  # unpacked it is another file
                other = {"if-none-match": answer.headers["etag"], "accept-encoding": "identity"}
                assert (await service_client.client.get(path, headers=other)).status_code == 200


def test_packed_copies_have_no_address_of_their_own() -> None:
    assert not [path for path in page_paths() if path.endswith((".gz", ".br"))]
    assert "/icon.svg" in page_paths()


def test_sign_in_is_checked_by_a_separate_script_before_the_page_loads() -> None:
    shell = SHELL.findall((DIST / "index.html").read_text(encoding="utf-8"))
    script = (DIST / shell[0]).read_text(encoding="utf-8")
    parts = [f"assets/{name}" for name in re.findall(r'from"\./([^"]+)"', script)]
    assert len(re.findall(r"\bimport\b", script)) == len(parts), "it would wait for another file"
    assert set(parts) <= set(shell), "what it needs must be asked for in the same moment"
    texts = [script, *((DIST / part).read_text(encoding="utf-8") for part in parts)]
    assert "api/sign-in" in script
    assert any("sign-in/challenges" in text for text in texts)
    assert not any(re.search(r"\bimport\b", text) for text in texts[1:]), "it would wait for a third file"
    files = [DIST / name for name in (shell[0], *parts)]
    packed = [DIST / f"{name}.br" for name in (shell[0], *parts)]
    sent = [small if small.is_file() else file for file, small in zip(files, packed, strict=True)]
    assert sum(file.stat().st_size for file in sent) < 2000
    page = next(name for name in shell if "/index-" in name and name.endswith(".js"))
    assert Path(shell[0]).name in (DIST / page).read_text(encoding="utf-8"), "asked twice"
