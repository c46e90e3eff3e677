"""Which session a page shows: the newest, also of a service whose clock was set back while it was started anew."""

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
const source = readFileSync("src/lib/session_order.ts", "utf8");
const options = {compilerOptions: {module: "CommonJS", target: "ES2022"}};
const exports_ = {};
new Function("exports", transpileModule(source, options).outputText)(exports_);
console.log(JSON.stringify(JSON.parse(readFileSync(0, "utf8")).map((what) => exports_.follow(...what))));
"""
# told, shown, due, first of its line: whether it is shown, and what is due then
CASES = (
    ((101, None, 0, True), (True, 0)),
    ((102, 101, 102, False), (True, 102)),
    ((101, 101, 101, False), (True, 101)),
    ((100, 101, 101, False), (False, 101)),  # it was under way for longer
    ((105, 101, 102, True), (True, 102)),  # the line broke, and the service is the same
    ((7, 101, 102, True), (True, 0)),  # started anew with its clock set back: its orders count from there
    ((8, 7, 8, False), (True, 8)),
)

pytestmark = pytest.mark.skipif(
    NODE is None or not (WEB / "node_modules/typescript").is_dir(),
    reason="the pages' tools are not installed",
)


def test_a_page_shows_the_session_of_a_service_whose_clock_was_set_back() -> None:
    done = subprocess.run(
        [str(NODE), "-e", READ_ALL],
        cwd=WEB,
        input=json.dumps([what for what, _ in CASES]),
        capture_output=True,
        text=True,
        check=True,
        timeout=stretched_s(60.0),
    )
    found = [(each["takes"], each["due"]) for each in json.loads(done.stdout)]
    assert found == [expected for _, expected in CASES]
