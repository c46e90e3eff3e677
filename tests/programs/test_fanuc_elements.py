"""Elements of a register that holds a position: added along an axis that stays they cost nothing; set, they count."""

from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode

PROJECT = """format = 1
name = "f"
[robot]
serial = "F1"
model = "fanuc_m6ib"
smallest_sigma = 0.001
[tools.1.entered]
position_mm = [0, 0, 100]
"""
LISTING = """/PROG  Z
/ATTR
/APPL
/MN
   1:  UFRAME_NUM=0 ;
   2:  UTOOL_NUM=1 ;
   3:  PR[10]=P[1] ;
   4:  {} ;
   5:L PR[10] 100mm/sec FINE ;
   6:L P[1] 100mm/sec FINE ;
/POS
P[1]{{
   GP1:
\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =   900.000  mm,\tY =     0.000  mm,\tZ =   300.000  mm,
\tW =   180.000 deg,\tP =     0.000 deg,\tR =     0.000 deg
}};
/END
"""
ABOUT_Z, ABOUT_X = "0,0,0,0,0,5", "0,0,0,5,0,0"


@pytest.mark.parametrize(
    ("line", "offset", "counts"),
    [
        ("PR[10,3]=PR[10,3]+20", "0,0,10", False),
        ("PR[10,3]=PR[10,3]+R[5]", ABOUT_Z, False),
        ("PR[10,3]=PR[10,3]-20", "5,6,7,0,0,5", False),
        ("PR[10,3]=PR[10,3]+20", ABOUT_X, True),
        ("PR[10,1]=PR[10,1]+20", ABOUT_Z, True),
        ("PR[10,3]=PR[10,3]*2", "0,0,10", True),
        ("PR[10,3]=PR[10,1]+20", "0,0,10", True),
        ("PR[10,3]=200", "0,0,10", True),
        ("PR[10,3]=200", "10,0,0", False),
        ("PR[10,3]=200", ABOUT_Z, False),
        ("PR[10,3]=R[5]", ABOUT_X, True),
        ("PR[10,1]=200", ABOUT_Z, True),
        ("PR[10,6]=30", ABOUT_Z, True),
        ("PR[10]=PR[10]+PR[11]", ABOUT_Z, True),
    ],
)
def test_only_what_costs_something_is_a_finding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, offset: str, counts: bool
) -> None:
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    (tmp_path / "Z.LS").write_text(LISTING.format(line), encoding="ascii")
    words = ["program", "move", str(tmp_path / "Z.LS"), "--project", str(tmp_path / "project.toml")]
    code = run_command_line([*words, f"--offset={offset}", "--out", str(tmp_path / "out")])
    output = " ".join(capsys.readouterr().out.split())
    assert code == (ExitCode.REFUSED if counts else ExitCode.PASS), output
