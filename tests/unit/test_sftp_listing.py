"""What a listing over SFTP says where its server is slow, endless, or names files in other letters."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import asyncssh
import pytest

from cellcal.drivers.errors import DeviceTimeoutError, RefusedError
from cellcal.drivers.wire.sftp_link import SftpLink, SshLogin

FILE, LINK, FOLDER = 0o100644, 0o120777, 0o040755


def entry(name: bytes, mode: int | None = FILE) -> asyncssh.SFTPName:
    kinds = {FILE: asyncssh.FILEXFER_TYPE_REGULAR, LINK: asyncssh.FILEXFER_TYPE_SYMLINK}
    kinds |= {FOLDER: asyncssh.FILEXFER_TYPE_DIRECTORY}
    kind = asyncssh.FILEXFER_TYPE_UNKNOWN if mode is None else kinds[mode]
    return asyncssh.SFTPName(name, attrs=asyncssh.SFTPAttrs(type=kind))


def link_to(listing: Callable[[], AsyncIterator[asyncssh.SFTPName]], *, deadline_s: float = 60.0) -> SftpLink:
    """Return a link whose server lists that."""

    class Listing:
        def scandir(self, folder: bytes) -> AsyncIterator[asyncssh.SFTPName]:
            return listing()

    link: Any = SftpLink("ur", ("127.0.0.1", 22), SshLogin("root", ""), deadline_s=deadline_s)
    link._open_sftp = Listing()
    return link  # type: ignore[no-any-return]


async def test_a_listing_that_takes_too_long_is_no_lost_connection() -> None:
    async def never() -> AsyncIterator[asyncssh.SFTPName]:
        await asyncio.Event().wait()
        yield entry(b"a.urp")

    with pytest.raises(DeviceTimeoutError, match="reading the list of files took longer"):
        await link_to(never, deadline_s=0.01).list_files("/programs")


async def test_a_listing_without_an_end_is_refused() -> None:
    async def endless() -> AsyncIterator[asyncssh.SFTPName]:
        while True:
            yield entry(b"a.urp")

    with pytest.raises(RefusedError, match="holds more than 10000 files"):
        await link_to(endless).list_files("/programs")


async def test_links_and_names_in_other_letters_are_listed() -> None:
    async def several() -> AsyncIterator[asyncssh.SFTPName]:
        for one in (entry(b"b\xff.urp"), entry(b"a.urp", LINK), entry(b"c.urp", None), entry(b"d", FOLDER)):
            yield one

    assert await link_to(several).list_files("/programs") == ("a.urp", "b\ufffd.urp", "c.urp")
    assert await link_to(several).list_folders("/programs") == ("d",)
