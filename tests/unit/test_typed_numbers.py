"""What a person types into a number field of the pages: comma or point, any keyboard's signs, a unit or none."""

import json
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.machine_speed import stretched_s

WEB = Path(__file__).parents[2] / "web"
NODE = shutil.which("node", path=str(Path(sys.executable).parent)) or shutil.which("node")
READ_ALL = """
const {transpileModule} = require("typescript"), {readFileSync} = require("fs");
const source = readFileSync("src/lib/units.ts", "utf8");
const options = {compilerOptions: {module: "CommonJS", target: "ES2022"}};
const exports_ = {};
new Function("exports", transpileModule(source, options).outputText)(exports_);
const typed = JSON.parse(readFileSync(0, "utf8"));
console.log(JSON.stringify(typed.map(([text, unit]) =>
    [exports_.typedNumber(text, unit), exports_.twoWays(text, "."), exports_.twoWays(text, ",")])));
"""
NUMBERS: dict[tuple[str, str], float | None] = {
    ("5,5", "mm"): 5.5,
    (" .5 ", "mm"): 0.5,
    ("-3", "mm"): -3.0,
    ("\u22123", "mm"): -3.0,
    ("1e5", "mm"): 1e5,
    ("\uff11\uff12\uff0e\uff15", "mm"): 12.5,
    ("5 mm", "mm"): 5.0,
    ("0,5m", "mm"): 500.0,
    ("3 µm", "mm"): 0.003,
    ("30°", "°"): 30.0,
    ("1 000,5", "mm"): 1000.5,
    ("5 0", "mm"): None,
    ("1.234,5", "mm"): None,
    ("5 kg", "mm"): None,
    ("5 mm", "°"): None,
    ("5 m", ""): None,
    ("0x10", "mm"): None,
    ("Infinity", "mm"): None,
    ("1e999", "mm"): None,
    ("", "mm"): None,
}
TWO_WAYS = {
    "1,500": (["1500", "1.5"], None),
    "12.500": (None, ["12500", "12,5"]),
    "0,500": (None, None),
    "1500": (None, None),
    "1,50": (None, None),
}

pytestmark = pytest.mark.skipif(
    NODE is None or not (WEB / "node_modules/typescript").is_dir(),
    reason="the pages' tools are not installed",
)


@cache
def read_all() -> list[Any]:
    """Return what the pages read in each text: one start of node for all."""
    assert NODE is not None
    typed = [*NUMBERS, *((text, "mm") for text in TWO_WAYS)]
    done = subprocess.run(
        [NODE, "-e", READ_ALL],
        input=json.dumps(typed),
        capture_output=True,
        text=True,
        cwd=WEB,
        check=True,
        timeout=stretched_s(60.0),
    )
    return list(json.loads(done.stdout))


def test_a_typed_number_is_read_as_it_is_meant_or_not_at_all() -> None:
    read = dict(zip(NUMBERS, (number for number, _, _ in read_all()), strict=False))
    assert read == NUMBERS


def test_a_mark_that_may_be_one_of_thousands_is_asked_about() -> None:
    found = {
        text: (by_point, by_comma)
        for text, (_, by_point, by_comma) in zip(TWO_WAYS, read_all()[len(NUMBERS) :], strict=True)
    }
    assert found == TWO_WAYS
