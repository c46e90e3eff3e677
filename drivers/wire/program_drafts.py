"""Files that arrive on a controller under another name, are compared, and only then take their place."""

from collections.abc import Awaitable, Callable

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces.program_store import ProgramStore


async def write_through_draft(
    store: ProgramStore,
    name: str,
    draft: str,
    content: bytes,
    *,
    upload: Callable[[str, bytes], Awaitable[None]],
    take_place: Callable[[str, str], Awaitable[None]],
) -> None:
    """Upload a file as ``draft``, read it back, and let it take the place of ``name``; the draft is deleted.

    Raises
    ------
    RefusedError
        It reads back as something else; the old file is untouched.
    """
    try:
        await upload(draft, content)
        if await store.read_file(draft) != content:
            raise RefusedError(
                store.device,
                make_message("{name} did not arrive as it was sent; the old file is untouched.", name=name),
                remedy="Look at the network and the room on the controller's disk, then deliver again.",
            )
        await take_place(draft, name)
    finally:
        await store.delete_file(draft)
