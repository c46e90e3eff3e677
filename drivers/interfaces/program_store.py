"""Programs that lie on a controller, as files by name."""

from typing import Protocol, runtime_checkable


class ProgramStore(Protocol):
    """One folder of one controller. Names are plain: no folder, no control character.

    Each call ends within the deadline of the link or raises a DeviceError.
    """

    @property
    def device(self) -> str:
        """Name of the controller in messages."""
        ...

    @property
    def tells_running(self) -> bool:
        """Whether the controller says that a program runs; else a person has to."""
        ...

    async def list_names(self) -> tuple[str, ...]:
        """Return the names of all programs, sorted."""
        ...

    async def read_file(self, name: str) -> bytes | None:
        """Return the bytes of a program; None where there is none of that name."""
        ...

    async def write_file(self, name: str, content: bytes) -> None:
        """Put a program in place, whole; RefusedError where the controller does not take it."""
        ...

    async def delete_file(self, name: str) -> None:
        """Take a program away; one that is not there is no fault."""
        ...

    async def refuse_while_running(self) -> None:
        """Raise RefusedError while a program runs, where the controller tells it."""
        ...

    def is_same(self, sent: bytes, read: bytes) -> bool:
        """Whether what was read back is what was sent, as this controller writes it."""
        ...


@runtime_checkable
class StoreOfFolders(Protocol):
    """A program store whose folder may hold others."""

    async def list_folders(self) -> tuple[str, ...]:
        """Return some folders below this one, as paths from here; their programs are not among the names."""
        ...
