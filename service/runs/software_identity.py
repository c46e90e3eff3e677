"""Which software made a run: what its journal and its certificate say of procedures and mathematics."""

import hashlib
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable

_ROOMS = ("procedures", "calibration")


def software_versions() -> dict[str, str]:
    """Return version, solver and definition of what runs here, for the journal."""
    return {
        "software": version("cellcal"),
        "solver": f"numpy {version('numpy')}, scipy {version('scipy')}",
        "definition_sha256": definition_sha256(),
    }


@cache
def definition_sha256() -> str:
    """Return the SHA-256 of every line of procedures and mathematics, in the order of their names."""
    digest = hashlib.sha256()
    for room in _ROOMS:
        for name, text in _source_files(files("cellcal").joinpath(room), room):
            digest.update(f"{name}\n{len(text)}\n".encode() + text)
    return digest.hexdigest()


def _source_files(folder: Traversable, path: str) -> list[tuple[str, bytes]]:
    found: list[tuple[str, bytes]] = []
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        name = f"{path}/{entry.name}"
        if entry.is_dir():
            found += _source_files(entry, name)
        elif entry.name.endswith((".py", ".toml")):
            found.append((name, entry.read_bytes()))
    return found
