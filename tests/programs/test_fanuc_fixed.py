"""FANUC listings read and changed together, in columns: the same as one record after another."""

import re
from dataclasses import fields

import numpy as np
import pytest

from cellcal.calibration.geometry import exp_rotation, homogeneous_matrix
from cellcal.drivers.fanuc.program_files.ls_digits import read_digits, written_digits
from cellcal.drivers.fanuc.program_files.ls_numbers import NumberStyle
from cellcal.drivers.fanuc.program_files.ls_program import LsProgram, change_listings, read_listings
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange
from tests.programs import generate_fanuc
from tests.soak.program_lines import DOOR_LINE, line_of_programs


@pytest.fixture(scope="module")
def listing_files(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, bytes]]:
    master, _ = line_of_programs(tmp_path_factory.mktemp("line"), 7, 130)
    paths = [*sorted(master.parent.glob("programs/*")), *sorted(DOOR_LINE.glob("cell_1/programs/*"))]
    generated = [(f"generated{seed}.ls", generate_fanuc.generate(seed)) for seed in range(60)]
    return [*((path.name, path.read_bytes()) for path in paths), *generated]


def parse_listings(files: list[tuple[str, bytes]]) -> list[LsProgram]:
    programs = read_listings(files)
    assert all(isinstance(program, LsProgram) for program in programs)
    return [program for program in programs if isinstance(program, LsProgram)]


def shift_of(program: LsProgram, seed: int) -> PositionChange:
    rng = np.random.default_rng(seed)
    poses = program.positions.frame_tip
    rows = np.flatnonzero(np.isfinite(poses[:, 0, 0]) & (rng.random(len(poses)) < 0.8))
    far, turn = ((0.3, 0.5), (1e-4, 1e-5), (2.0, 3.0))[seed % 3]
    shift = homogeneous_matrix(exp_rotation(rng.normal(size=3) * turn), rng.normal(size=3) * far)
    return PositionChange(rows, frame_tip=shift @ poses[rows])


def test_listings_read_together_say_what_each_says_record_by_record(listing_files):
    together = parse_listings(listing_files)
    assert sum(one.plan_rewrite(shift_of(one, 3)) is not None for one in together) >= 10, (
        "none was of fixed width"
    )
    for program, (name, data) in zip(together, listing_files, strict=True):
        alone = LsProgram(name, data).positions
        for field in fields(alone):
            one, other = getattr(program.positions, field.name), getattr(alone, field.name)
            if isinstance(other, np.ndarray):
                assert one.dtype == other.dtype
                assert np.array_equal(one, other, equal_nan=True), (name, field.name)
            else:
                assert one == other, (name, field.name)


def test_an_odd_record_leaves_its_own_listing_to_be_read_alone(listing_files):
    data = listing_files[0][1]
    numbered = [data.replace(b"UF : 2, UT : 1", b"UF : 2, UT : %d" % tool) for tool in range(1, 10)]
    turned = [
        text.replace(b"'N U T, 0, 0, 0'", b"'N U T, 0, 0, %d'" % turn)
        for text in numbered
        for turn in range(4)
    ]
    odd = re.sub(rb"= +-?\d*\.\d+  mm,", b"= ********  mm,", data, count=1)
    together = parse_listings([("odd.ls", odd), *((f"{i}.ls", text) for i, text in enumerate(turned))])
    fixed = [program.plan_rewrite(shift_of(program, 3)) is not None for program in together]
    assert fixed == [False, *(True for _ in turned)]
    assert together[0].positions.kinds[0] == "untaught"
    assert together[-1].positions.tools[0] == "9"
    assert together[-1].positions.configurations[0] == "N U T, 0, 0, 3"


def test_listings_changed_together_have_the_bytes_of_each_changed_number_by_number(listing_files):
    programs = parse_listings(listing_files)
    for turn in range(3):
        changes = [shift_of(program, 3 * i + turn) for i, program in enumerate(programs)]
        some = [i for i, change in enumerate(changes) if len(change.rows)]
        new = change_listings([programs[i] for i in some], [changes[i] for i in some])
        for after, i in zip(new, some, strict=True):
            assert after.to_bytes() == LsProgram(*listing_files[i]).edit_bytes(changes[i]), listing_files[i][
                0
            ]
            assert programs[i].to_bytes() == listing_files[i][1]


def test_a_number_too_wide_for_its_field_widens_the_line_as_it_does_alone(listing_files):
    program, data = (
        parse_listings(listing_files[:1])[0],
        re.sub(rb"X = +", b"X = ", listing_files[0][1], count=1),
    )
    narrow = parse_listings([("narrow.ls", data)])[0]
    pose = program.positions.frame_tip[:1].copy()
    pose[0, :3, 3] = [-123.4567894, 99.9999, 0.0000004]
    change = PositionChange(np.array([0]), frame_tip=pose)
    for one in (program, narrow):
        assert one.with_changes(change).to_bytes() == one.edit_bytes(change)
    assert (
        b"X = -123456.789  mm,\tY = 99999.900  mm,\tZ =     0.000" in narrow.with_changes(change).to_bytes()
    )


def test_what_is_wrong_with_one_listing_stands_at_its_place(listing_files):
    name, data = listing_files[0]
    twice = data.replace(b"P[2]{", b"P[1]{")
    cut = data[: len(data) // 2]
    found = read_listings([(name, data), ("twice.ls", twice), ("cut.ls", cut), (name, data)])
    assert isinstance(found[0], LsProgram)
    assert isinstance(found[3], LsProgram)
    assert isinstance(found[1], ProgramFileError)
    assert "second time" in str(found[1])
    assert isinstance(found[2], ProgramFileError)
    assert "cut.ls" in str(found[2])
    assert len(found[3].positions) == 130


@pytest.mark.parametrize("damage", [b"12-.345", b"- 2.345", b"1 2.345", b"  .3 45", b"   2.34x", b"2.345  "])
def test_a_field_that_holds_no_right_aligned_number_is_distinguished(damage):
    text = damage.rjust(10)
    fields_of = np.frombuffer(text + b"    -2.345", dtype=np.uint8).reshape(2, 10).T
    assert read_digits(fields_of, 6).plain.tolist() == [False, True]


def test_digits_are_written_and_read_as_printing_and_parsing_do():
    rng = np.random.default_rng(4)
    values = np.concatenate(
        [
            rng.normal(size=3000) * 10.0 ** rng.integers(-5, 5, 3000),
            [0.0, -0.0, 0.0005, -0.0004, 0.9996, -0.9999],
        ]
    )
    ties = np.arange(-2000, 2000) / 2000.0 + rng.integers(-3, 3, 4000)  # x.xxx5 and x.xxx0
    values = np.concatenate([values, ties])
    for leading_zero in (True, False):
        style = NumberStyle(padded=True, leading_zero=leading_zero)
        texts, room = written_digits(values, (11, 7), np.full(len(values), leading_zero))
        assert room.all()
        for value, text in zip(values.tolist(), texts.T, strict=True):
            assert text.tobytes() == style.write_value(b"      0.000", value), value
        read_back = read_digits(texts, 7)
        assert read_back.plain.all()
        assert read_back.values.tolist() == [float(text.tobytes()) for text in texts.T]
    texts, room = written_digits(np.array([np.nan, np.inf, 1e6, 123456.0]), (10, 6), np.zeros(4, dtype=bool))
    assert room.tolist() == [False, False, False, False]
