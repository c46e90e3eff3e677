"""Plots of the pages: an axis ends just above what is drawn, at a line whose figure tells it from its neighbours."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.machine_speed import stretched_s

WEB = Path(__file__).parents[2] / "web"
NODE = shutil.which("node", path=str(Path(sys.executable).parent)) or shutil.which("node")
READ_ALL = """
const {transpileModule} = require("typescript"), {readFileSync} = require("fs");
const source = readFileSync("src/lib/axis_top.ts", "utf8");
const options = {compilerOptions: {module: "CommonJS", target: "ES2022"}};
const exports_ = {};
new Function("exports", transpileModule(source, options).outputText)(exports_);
console.log(JSON.stringify(JSON.parse(readFileSync(0, "utf8")).map((largest) => exports_.axisLines(largest))));
"""
LARGEST = [1.01 * 1.13**k * 1e-5 for k in range(150)] + [0.1, 0.2, 0.3, 0.6, 1.0, 6.0, 7.0, 60.0, 1000.0]

pytestmark = pytest.mark.skipif(
    NODE is None or not (WEB / "node_modules/typescript").is_dir(),
    reason="the pages' tools are not installed",
)


def test_an_axis_ends_just_above_the_largest_value_and_its_lines_have_different_figures() -> None:
    done = subprocess.run(
        [str(NODE), "-e", READ_ALL],
        cwd=WEB,
        input=json.dumps(LARGEST),
        capture_output=True,
        text=True,
        check=True,
        timeout=stretched_s(60.0),
    )
    for largest, axis in zip(LARGEST, json.loads(done.stdout), strict=True):
        lines = axis["lines"]
        assert lines[0] == 0.0
        assert lines[-1] == pytest.approx(axis["top"])
        assert largest * (1 - 1e-9) <= axis["top"] <= largest * 1.34
        assert 3 <= len(lines) - 1 <= 6
        written = [f"{line:.{axis['digits']}f}" for line in lines]
        assert [float(text) for text in written] == pytest.approx(lines, rel=1e-9)
        assert len(set(written)) == len(written)
