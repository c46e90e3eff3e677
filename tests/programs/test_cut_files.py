"""Files that a transfer cut off: the points behind the cut are missing, and nothing else would say so."""

import pytest

from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.errors import ProgramFileError
from tests.programs.test_abb_passed_targets import REST
from tests.programs.test_controller_tasks import MOVING

DATA = "DEFDAT A PUBLIC\r\nDECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}\r\nENDDAT\r\n"
SOURCE = "DEF first()\r\nPTP XP1\r\nEND\r\n\r\nDEF second()\r\n;ENDFOLD\r\nIF $IN[1] THEN\r\nENDIF\r\nEND\r\n"
MODULE = MOVING.format(name="A", rest=REST.replace("-1", "0"))


@pytest.mark.parametrize(
    ("brand", "name", "text", "end"),
    [
        ("kuka", "a.dat", DATA, "ENDDAT"),
        ("kuka", "a.src", SOURCE, "END"),
        ("abb", "A.mod", MODULE, "ENDMODULE"),
        ("abb", "A.mod", MODULE.lower(), "endmodule"),
    ],
)
def test_a_file_without_its_end_is_refused(brand: str, name: str, text: str, end: str) -> None:
    read = brand_named(brand).read
    assert read(name, text.encode("ascii")).to_bytes() == text.encode("ascii")
    cut = text[: text.rindex(end)]
    with pytest.raises(ProgramFileError, match="cut short") as refused:
        read(name, cut.encode("ascii"))
    assert "Fetch it from the controller again" in refused.value.remedy


def test_a_piece_of_a_program_that_begins_nothing_is_read() -> None:
    piece = DATA.splitlines()[1].encode("ascii") + b"\r\n"
    assert len(brand_named("kuka").read("a.dat", piece).positions) == 1
