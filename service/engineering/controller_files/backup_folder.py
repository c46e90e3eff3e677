"""A folder or file in place of an address: what it is, where it is no backup of a FANUC controller."""

from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.controller_files import AXES, POSITION, VERSION
from cellcal.drivers.fanuc.controller_files.file_sources import FolderSource
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, FRAMES, MASTERING

_NEEDED = frozenset(name.lower() for name in (AXES, POSITION, VERSION, MASTERING, DRIVES, FRAMES))
_MOST_FOLDERS = 5
_SIGNS = (  # names in a backup of another maker's controller, and the maker
    ("syspar", "ABB"),
    ("backinfo", "ABB"),
    ("krc", "KUKA"),
    ("all.prm", "Yaskawa"),
    ("cmosbk.bin", "Yaskawa"),
    ("calibration.conf", "Universal Robots"),
    ("urcontrol", "Universal Robots"),
)


def refuse_file(path: Path) -> None:
    """Refuse a file: a record is made of a whole backup, unpacked.

    Raises
    ------
    CellError
        There is a file of that name.
    """
    if not path.is_file():
        return
    raise CellError(
        make_message("{path} is a file, and a backup is a folder of files.", path=path),
        remedy="Unpack it where it is an archive, and give the folder that holds SYSMAST.VA and SYMOTN.VA.",
        code="usage",
    )


def open_backup_folder(folder: Path) -> FolderSource:
    """Open a folder with a backup of a FANUC controller.

    Raises
    ------
    CellError
        It holds no file of one: it is another maker's, or the backup lies in a folder below.
    """
    source = FolderSource(folder)
    if _NEEDED.intersection(source.list_names()):
        return source
    below = _folders_with_backup(folder)
    if below:
        raise CellError(
            make_message("{folder} holds no backup; folders below it do.", folder=folder),
            remedy=make_message("Give one of them: {below}.", below=", ".join(below[:_MOST_FOLDERS])),
            code="usage",
        )
    maker = _find_maker(folder)
    if maker:
        raise CellError(
            make_message("{folder} is a backup of {maker}, and not of FANUC.", folder=folder, maker=maker),
            remedy="Only a FANUC controller's files hold its encoder counts. Of others record what they show, while "
            "they are healthy: cellcal run position_record --cell cell.toml.",
            code="usage",
        )
    return source


def _folders_with_backup(folder: Path) -> list[str]:
    try:
        below = sorted(entry for entry in folder.iterdir() if entry.is_dir())
        return [str(entry) for entry in below if _holds_mastering(entry)]
    except OSError:
        return []


def _holds_mastering(folder: Path) -> bool:
    return any(entry.name.lower() == MASTERING.lower() for entry in folder.iterdir())


def _find_maker(folder: Path) -> str:
    names = {entry.name.lower() for entry in folder.iterdir()}
    return next((maker for sign, maker in _SIGNS if sign in names), "")
