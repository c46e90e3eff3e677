"""Targets as the controller writes them are read and changed as the same targets with blanks between their tokens."""

import numpy as np
import pytest

from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.abb.program_files.programs import BRAND, AbbFile
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import UNTAUGHT, PositionChange

E = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
COUNT = 60


def module_text(rng: np.random.Generator, mark: str) -> str:
    """Return a module; ``mark`` stands where blanks may."""
    lines, moves = [f"MODULE Teil{mark}"], []
    for number in range(COUNT):
        turn = rng.normal(size=4)
        turn /= np.linalg.norm(turn)
        if number == 7:
            turn[:] = 0.0
        places = ",".join(f"{v:.{rng.integers(0, 5)}f}" for v in rng.uniform(-2000, 2000, 3))
        turns = ",".join(f"{v:.{rng.integers(4, 9)}f}" for v in turn)
        axes = E if number % 9 else "[12.5,9E+09,9E+09,9E+09,9E+09,9E+09]"
        local = "LOCAL " if number % 5 == 0 else ""
        kind = ("CONST", "PERS")[number % 2]
        lines.append(f"  {local}{kind} robtarget p{number}:={mark}[[{places}],[{turns}],[0,-1,1,0],{axes}];")
        frame = ("", "\\WObj:=wA", "\\WObj:=wB")[number % 3]
        moves.append(f"    MoveL {mark}p{number},v100,z10,tGrip{frame};")
        if number % 11 == 0:
            moves.append(f"    MoveJ {mark}P{number},v100,z10,tOther;")
    return "\r\n".join([*lines, "  PROC main()", *moves, "  ENDPROC", "ENDMODULE", ""])


def read_both(seed: int) -> tuple[AbbFile, AbbFile]:
    def read_with_mark(mark: str) -> AbbFile:
        file = BRAND.read("a.mod", module_text(np.random.default_rng(seed), mark).encode())
        assert isinstance(file, AbbFile)
        return file

    return read_with_mark(""), read_with_mark(" ")


@pytest.mark.parametrize("seed", range(5))
def test_they_say_the_same(seed):
    usual, other = read_both(seed)
    assert (usual.written.widths[:, 0] > 0).sum() > COUNT - 5  # of the first of a kind the axes are not known
    assert not other.written.widths.any()
    for name in ("names", "kinds", "lines", "user_frames", "tools", "configurations", "barred"):
        assert str(getattr(usual.positions, name)) == str(getattr(other.positions, name)), name
    for name in ("frame_tip", "external", "resolution_m", "resolution_rad"):
        ours, theirs = getattr(usual.positions, name), getattr(other.positions, name)
        assert np.allclose(ours, theirs, rtol=0, atol=1e-14, equal_nan=True), name
    assert (usual.fixed, usual.keys, usual.used, usual.declarations) == (
        other.fixed,
        other.keys,
        other.used,
        other.declarations,
    )
    assert usual.positions.kinds[7] == UNTAUGHT
    remark_lists = [
        [(remark.line, remark.code, remark.text) for remark in file.remarks] for file in (usual, other)
    ]
    assert sorted(remark_lists[0]) == sorted(remark_lists[1])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("shift_m", "turn_rad"), [(0.0, 0.0), (0.01, 0.0), (0.0, 0.02), (0.02, 2.5), (2e-7, 2e-8), (6e-7, 1e-6)]
)
def test_they_are_written_the_same(seed, shift_m, turn_rad):
    usual, other = read_both(seed)
    rng = np.random.default_rng(seed)
    rows = np.array([k for k in range(COUNT) if k != 7 and k not in usual.positions.barred])
    turned = rotation_from("kuka_abc", rng.uniform(-1, 1, (1, 3)) * turn_rad)[0]
    base_change = homogeneous_matrix(turned, rng.uniform(-1, 1, 3) * shift_m)
    change = PositionChange(rows, frame_tip=base_change @ usual.positions.frame_tip[rows])
    written = [file.with_changes(change).to_bytes().replace(b" ", b"") for file in (usual, other)]
    assert written[0] == written[1]
    assert (written[0] == usual.to_bytes().replace(b" ", b"")) == (shift_m + turn_rad == 0.0)


def test_a_quaternion_that_is_none_is_refused_with_its_place():
    text = module_text(np.random.default_rng(1), "")
    lines = text.splitlines()
    place, _, rest = lines[9].partition("],[")
    lines[9] = f"{place}],[0.9,0.9,0,0],{rest.partition('],')[2]}"
    with pytest.raises(ProgramFileError, match=r"length 1\.2728") as caught:
        BRAND.read("a.mod", "\r\n".join(lines).encode())
    assert (caught.value.line, caught.value.column) == (10, len(place) + 4)
