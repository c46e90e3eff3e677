"""A FANUC program listing (.LS): its sections, its positions, and the same file with some of them changed.

The bytes are the program. Positions are read from spans of it, and a change writes into those spans; nothing is
printed from a parsed form.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_batch import (
    FixedRead,
    RecordRewrite,
    plan_rewrite,
    read_fixed,
    rewrite_listings,
)
from cellcal.drivers.fanuc.program_files.ls_edit import edit_listing
from cellcal.drivers.fanuc.program_files.ls_fixed import ListingBody
from cellcal.drivers.fanuc.program_files.ls_frames import (
    frames_made_alone,
    frames_set,
    is_made_alone,
    is_run_beside,
    mark_of_setter,
    mark_of_starter,
    routine_effects_of,
    rows_without_frames,
    setters_beside,
    with_chosen_frames,
    with_frames_of_people,
    without_set_frames,
)
from cellcal.drivers.fanuc.program_files.ls_literal_frames import WrittenFrames, written_frames
from cellcal.drivers.fanuc.program_files.ls_missing_places import missing_places
from cellcal.drivers.fanuc.program_files.ls_motions import bar_standing_tools, with_motions
from cellcal.drivers.fanuc.program_files.ls_positions import positions_of
from cellcal.drivers.fanuc.program_files.ls_records import ListingFile
from cellcal.drivers.fanuc.program_files.ls_remarks import remarks_of
from cellcal.drivers.fanuc.program_files.ls_selection import is_told_by_called, with_selections
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations
from cellcal.drivers.programs.positions import PositionChange, Positions, ProgramFile, ProgramFrames, Remark

_SECTION = re.compile(rb"/(PROG|ATTR|APPL|MN|POS|END)\b[^\n]*+")
_INDENT = 40  # a section's name stands at the beginning of its line, behind so many blanks at most
_PROGRAM = re.compile(rb"/PROG[ \t]++([^\s;]{1,80}+)")
_SCHEDULE = re.compile(rb"LINE_TRACK_SCHEDULE_NUMBER[ \t]*+:[ \t]*+0*+[1-9]", re.IGNORECASE)
_TRACK = (
    "This program follows a conveyor: its points stand in its schedule's tracking frame, not in a user frame."
)
_TRACKED = "its program follows a conveyor, whose frame no program file holds"
_AFTER_END = re.compile(rb"[\s\x1a\x00]*+")
_ORDER = (b"PROG", b"ATTR", b"APPL", b"MN", b"POS", b"END")
_SAVE_AGAIN = "Save the program again on the controller, in ASCII."


class LsProgram:
    """One .LS file; `drivers.programs.positions.ProgramFile`."""

    brand = "fanuc"

    def __init__(self, file: str, data: bytes) -> None:
        self._place = ListingFile(file, data)
        self._sections = _find_sections(self._place)
        self._fixed: FixedRead | None = None
        self.external_uses: ExternalUses | None = (
            None  # what the controller's other programs choose; None: they are not known
        )

    @property
    def name(self) -> str:
        found = _PROGRAM.match(self._place.data, self._sections["PROG"])
        return found[1].decode("cp437") if found else ""

    @property
    def file(self) -> str:
        """Return the file's name."""
        return self._place.file

    @cached_property
    def positions(self) -> Positions:
        found = self._read_positions[0]
        if self._conveyor_match:
            return replace(found, barred=dict.fromkeys(range(len(found)), _TRACKED))
        found = with_motions(bar_standing_tools(found), self._place.data, self.external_uses)
        missing = tuple(missing_places(found, self._place.data))
        found = replace(found, shifts=(*found.shifts, *missing)) if missing else found
        left = {} if self.external_uses is None else self.external_uses.surely_left
        found = with_selections(found, self._place.data, left)
        if rows_without_frames(found):
            found = self._with_chosen(found)
        doubtful = frames_set(self.file, self.name, self._place.data)
        found = self._written_frames.rename(found) if doubtful else found
        if self.external_uses is not None and self.external_uses.doubtful:
            found = with_frames_of_people(found, self.file, self.name.upper(), self.external_uses.doubtful)
            doubtful = {**self.external_uses.doubtful, **doubtful}
        return without_set_frames(found, self.file, doubtful) if doubtful else found

    def _with_chosen(self, found: Positions) -> Positions:
        return with_chosen_frames(found, self._place.data, self.name.upper(), self._uses_or_own)

    @property
    def _uses_or_own(self) -> ExternalUses:
        """Return what counts for the listing, of itself alone where no others are known."""
        if self.external_uses is not None:
            return self.external_uses
        own = BatchDeclarations({self.file: self.declarations}).uses_of_file(self.file)
        assert own is not None
        return own

    @cached_property
    def remarks(self) -> tuple[Remark, ...]:
        found = remarks_of(self._place.data, self._sections["MN"], self._sections["POS"], self.positions)
        if self._conveyor_match is None:
            return found
        line = self._place.data.count(b"\n", 0, self._conveyor_match.start()) + 1
        return (Remark(line, "relative", _TRACK), *found)

    @property
    def frames(self) -> ProgramFrames:
        """Return the frames that the program sets to numbers; others it names, and the controller keeps them."""
        return self._written_frames.frames

    @cached_property
    def _written_frames(self) -> WrittenFrames:
        uses = self.external_uses
        setters = () if uses is None else setters_beside(self.file, uses.doubtful)
        others_set = any(name != self.name.upper() for name in setters)
        if self._conveyor_match is not None or (uses is not None and uses.running):
            return WrittenFrames()
        if others_set and uses is not None and is_run_beside(self.file, uses.doubtful):
            return WrittenFrames()
        others_set |= self._uses_or_own.calls_itself
        by_macro = uses is not None and is_made_alone(self.file, self.name.upper(), uses.doubtful)
        positions, data = self._read_positions[0], self._place.data
        return written_frames(positions, data, others_set=others_set, by_macro=by_macro)

    @property
    def declarations(self) -> FileDeclarations:
        """Return what counts for other programs of the controller."""
        return declarations_of(self.file, self._place.data)

    def with_external_uses(self, external_uses: ExternalUses | None) -> "LsProgram":
        """Return the listing with what the controller's other programs choose."""
        tells = external_uses is not None and (
            external_uses.doubtful
            or b"PR[" in self._place.data
            or rows_without_frames(self._read_positions[0])
            or is_told_by_called(self._place.data, external_uses.surely_left)
        )
        if external_uses is self.external_uses or not tells:
            return self
        other = LsProgram(self.file, self._place.data)
        other._fixed, other.external_uses = self._fixed, external_uses
        return other

    def to_bytes(self) -> bytes:
        return self._place.data

    def with_changes(self, change: PositionChange) -> "LsProgram":
        return _change_programs([self], [change])[0]

    def edit_bytes(self, change: PositionChange) -> bytes:
        """Return the file with a change of any kind; `changed` says what it raises."""
        positions, offsets = self._read_positions
        return edit_listing(self._place, self._record_range, positions, offsets, change)

    def plan_rewrite(self, change: PositionChange) -> RecordRewrite | None:
        """Return what a change writes into fields of fixed width; None where it takes more than that."""
        return plan_rewrite(self._place.data, self._fixed, change)

    @property
    def listing_body(self) -> ListingBody:
        """Return the records, between the line /POS and the line /END."""
        return ListingBody(self._place, *self._record_range)

    def take_fixed(self, fixed: FixedRead | None) -> None:
        """Take what was read of fixed width; without it the records are read one by one."""
        self._fixed = fixed

    @property
    def _record_range(self) -> tuple[int, int]:
        """Return where the records begin, after the line /POS, and where they end."""
        return self._sections["RECORDS"], self._sections["END"]

    @cached_property
    def _conveyor_match(self) -> re.Match[bytes] | None:
        """Return where the head says that the program follows a conveyor; a schedule of 0 is none."""
        return _SCHEDULE.search(self._place.data, 0, self._sections["MN"])

    @cached_property
    def _read_positions(self) -> tuple[Positions, NDArray[np.int64]]:
        return positions_of(self._place, *self._record_range) if self._fixed is None else self._fixed[:2]


def declarations_of(file: str, data: bytes) -> FileDeclarations:
    """Return what a listing says that counts for others; it need not be a sound one."""
    found = _PROGRAM.search(data)
    name = found[1].decode("cp437").upper() if found else ""
    routines, doubtful = {name: routine_effects_of(data)}, frames_set(file, name, data)
    alone = frames_made_alone(file, name, doubtful)
    doubtful |= mark_of_setter(file, name) if doubtful else {}
    doubtful |= mark_of_starter(file, name) if routines[name].beside else {}
    return FileDeclarations(
        PurePath(file).stem, routines=routines, doubtful=doubtful, made_alone=alone, flat=True
    )


def read_listings(files: Sequence[tuple[str, bytes]]) -> list[LsProgram | ProgramFileError]:
    """Read listings by their names and bytes, together; what is wrong with one stands at its place."""
    found = [_open_program(file, data) for file, data in files]
    programs = [one for one in found if isinstance(one, LsProgram)]
    for program, fixed in zip(programs, read_fixed([one.listing_body for one in programs]), strict=True):
        program.take_fixed(fixed)
    return [_check_positions(one) for one in found]


def read_ls(file: str, data: bytes) -> LsProgram:
    """Read a listing.

    Raises
    ------
    ProgramFileError
        Not a program, damaged, or not understood in /POS: with line and column.
    """
    return _raise_if_error(read_listings([(file, data)])[0])


def change_listings(programs: Sequence[ProgramFile], changes: Sequence[PositionChange]) -> list[ProgramFile]:
    """Return programs with their changes; listings go together.

    Raises
    ------
    ProgramFileError
        As `ProgramFile.changed`, of the first that cannot take its change.
    """
    listings = [i for i, program in enumerate(programs) if isinstance(program, LsProgram)]
    found = {i: programs[i].with_changes(changes[i]) for i in set(range(len(programs))) - set(listings)}
    chosen = [program for program in programs if isinstance(program, LsProgram)]
    found |= dict(zip(listings, _change_programs(chosen, [changes[i] for i in listings]), strict=True))
    return [found[i] for i in range(len(programs))]


def _change_programs(programs: Sequence[LsProgram], changes: Sequence[PositionChange]) -> list[LsProgram]:
    quick = [one.plan_rewrite(change) for one, change in zip(programs, changes, strict=True)]
    texts = iter(rewrite_listings([one for one in quick if one is not None]))
    new = [None if one is None else next(texts) for one in quick]
    files = [
        (program.file, program.edit_bytes(change) if text is None else text)
        for program, change, text in zip(programs, changes, new, strict=True)
    ]
    changed = [_raise_if_error(one) for one in read_listings(files)]
    return [new.with_external_uses(old.external_uses) for new, old in zip(changed, programs, strict=True)]


def _open_program(file: str, data: bytes) -> LsProgram | ProgramFileError:
    try:
        return LsProgram(file, data)
    except ProgramFileError as error:
        return error


def _check_positions(one: LsProgram | ProgramFileError) -> LsProgram | ProgramFileError:
    try:
        if isinstance(one, LsProgram):
            _ = one.positions
    except ProgramFileError as error:
        return error
    return one


def _raise_if_error(one: LsProgram | ProgramFileError) -> LsProgram:
    if isinstance(one, ProgramFileError):
        raise one
    return one


def _find_sections(place: ListingFile) -> dict[str, int]:
    """Return the offset of each section's line; RECORDS is the first byte after the line /POS."""
    found: dict[str, int] = {}
    last = 0
    for section in filter(
        lambda each: _begins_a_line(place.data, each.start()), _SECTION.finditer(place.data)
    ):
        rank = _ORDER.index(section[1])
        word = section[1].decode()
        if rank < last or (word in found and word != "APPL"):
            raise place.error_at(
                section.start(),
                make_message("/{word} stands at a place where it does not belong.", word=word),
                _SAVE_AGAIN,
            )
        last = rank
        found[word] = section.start()
        if word == "POS":
            found["RECORDS"] = _offset_after(place, section, b"/POS")
        if word == "END":
            _check_end(place, _offset_after(place, section, b"/END"))
    for word in ("PROG", "MN", "POS", "END"):
        if word not in found:
            raise ProgramFileError(
                place.file,
                make_message("the line /{word} is missing: this is no complete program listing.", word=word),
                remedy=_SAVE_AGAIN,
            )
    if place.data[: found["PROG"]].strip() or not _PROGRAM.match(place.data, found["PROG"]):
        raise place.error_at(0, "the file does not begin with /PROG and a name.", _SAVE_AGAIN)
    return found


def _begins_a_line(data: bytes, at: int) -> bool:
    return not data[max(0, at - _INDENT) : at].rpartition(b"\n")[2].strip(b" \t")


def _offset_after(place: ListingFile, section: re.Match[bytes], word: bytes) -> int:
    """Return the offset after the word, which must stand alone on its line."""
    at = section.start() + section[0].index(word) + len(word)
    if place.data[at : section.end()].strip():
        raise place.error_at(
            at, make_message("there is something behind {word}.", word=word.decode()), _SAVE_AGAIN
        )
    return at


def _check_end(place: ListingFile, at: int) -> None:
    rest = _AFTER_END.match(place.data, at)
    if rest is None or rest.end() != len(place.data):
        raise place.error_at(rest.end() if rest else at, "the file goes on behind /END.", _SAVE_AGAIN)
