"""Programs worked on together: one that is refused costs the others nothing."""

from collections.abc import Sequence
from pathlib import Path, PurePath

from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.batches import process_batch, read_batches
from cellcal.service.engineering.programs.files import ProgramSource, RefusedProgram
from tests.soak.program_lines import DOOR_LINE


def _write_sources(folder: Path, count: int) -> list[ProgramSource]:
    text = (DOOR_LINE / "cell_1" / "programs" / "RACK_PICK.LS").read_bytes()
    for number in range(count):
        name = b"PICK%02d" % number
        (folder / f"{name.decode()}.LS").write_bytes(text.replace(b"RACK_PICK", name))
    return [ProgramSource(path, PurePath(path.name)) for path in sorted(folder.iterdir())]


def test_what_one_reader_refuses_is_named_and_the_others_stay_in_order(tmp_path: Path) -> None:
    sources = _write_sources(tmp_path, 9)
    sources[4].path.write_bytes(b"/PROG  BROKEN\n/MN\n")
    sources[6].path.write_bytes(b"no program\n")
    refused: list[RefusedProgram] = []
    (batch,) = read_batches(sources, lambda _: None, refused)
    assert [read.source for read in batch] == [s for i, s in enumerate(sources) if i not in (4, 6)]
    assert [one.file for one in refused] == [str(sources[4].path), str(sources[6].path)]


def test_the_halves_of_a_batch_are_worked_on_where_a_program_is_refused(tmp_path: Path) -> None:
    refused: list[RefusedProgram] = []
    (batch,) = read_batches(_write_sources(tmp_path, 64), lambda _: None, refused)
    batch_sizes: list[int] = []

    def record_batch(programs: Sequence[ProgramFile]) -> Sequence[str]:
        batch_sizes.append(len(programs))
        names = [program.name for program in programs]
        if "PICK37" in names:
            raise ProgramFileError("PICK37", "is not for this cell.")
        return names

    found = list(process_batch(batch, record_batch, refused))
    assert [name for _, name in found] == [f"PICK{i:02d}" for i in range(64) if i != 37]
    assert all(read.program.name == name for read, name in found)
    assert [Path(one.file).name for one in refused] == ["PICK37.LS"]
    assert len(batch_sizes) == 13, "each half once: six times two, and the whole"
