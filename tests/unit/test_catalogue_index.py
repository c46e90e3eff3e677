"""The index of procedures says what their definitions say, and lists are made of it alone."""

import subprocess
import sys

from cellcal.procedures.catalogue import DEFINITIONS
from cellcal.procedures.catalogue_index import CATALOGUE_INDEX, ProcedureEntry

_LIST = """
import sys
from cellcal.service.cli.app import run_command_line
code = run_command_line({arguments})
loaded = sorted({{"numpy", "scipy", "pydantic", "fastapi", "cellcal.procedures.catalogue"}} & set(sys.modules))
print(code, loaded, file=sys.stderr)
"""


def loaded_by(*arguments: str) -> str:
    program = _LIST.format(arguments=list(arguments))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    return done.stderr.strip().splitlines()[-1]


def test_the_index_says_what_the_definitions_say() -> None:
    assert tuple(ProcedureEntry(d.name, d.title, d.version) for d in DEFINITIONS) == CATALOGUE_INDEX


def test_a_list_of_procedures_loads_no_mathematics() -> None:
    assert loaded_by("procedures") == "0 []"
    assert loaded_by("procedures", "--json") == "0 []"


def test_a_search_of_robots_loads_no_mathematics() -> None:
    assert loaded_by("models", "kr210") == "0 []"


def test_help_loads_no_mathematics() -> None:
    assert loaded_by("--help") == "0 []"
