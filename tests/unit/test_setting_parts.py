"""The parts of a group of settings: which usual value each has, and which of them a form says are needed."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.machine_speed import stretched_s

WEB = Path(__file__).parents[2] / "web"
NODE = shutil.which("node", path=str(Path(sys.executable).parent)) or shutil.which("node")
READ_PARTS = """
const {transpileModule} = require("typescript"), {readFileSync} = require("fs");
const options = {compilerOptions: {module: "CommonJS", target: "ES2022"}};
const read = (name) => {
    const exports_ = {};
    const source = transpileModule(readFileSync(`src/lib/${name}.ts`, "utf8"), options).outputText;
    new Function("exports", "require", source)(exports_, (other) => read(other.replace("./", "")));
    return exports_;
};
const schema = read("schema");
const parts = schema.settingsOf(JSON.parse(readFileSync(0, "utf8"))).map((group) =>
    schema.partsOf(group).map((part) => [part.name, part.field.default ?? null, part.required]));
console.log(JSON.stringify(parts));
"""
LIMITS = {
    "type": "object",
    "properties": {"origin_m": {"type": "number"}, "angle_rad": {"type": "number"}},
    "required": ["origin_m", "angle_rad"],
}
OPTIONAL_LIMITS = [{"$ref": "#/$defs/Limits"}, {"type": "null"}]

pytestmark = pytest.mark.skipif(
    NODE is None or not (WEB / "node_modules/typescript").is_dir(),
    reason="the pages' tools are not installed",
)


def test_a_part_is_usual_as_its_group_is_and_then_not_needed() -> None:
    schema = {
        "$defs": {"Limits": LIMITS},
        "properties": {
            "of_the_cell": {"anyOf": OPTIONAL_LIMITS, "default": {"origin_m": 0.002, "angle_rad": 0.01}},
            "without": {"anyOf": OPTIONAL_LIMITS, "default": None},
        },
    }
    assert NODE is not None
    done = subprocess.run(
        [NODE, "-e", READ_PARTS],
        input=json.dumps(schema),
        capture_output=True,
        text=True,
        cwd=WEB,
        check=True,
        timeout=stretched_s(60.0),
    )
    of_the_cell, without = json.loads(done.stdout)
    assert of_the_cell == [["origin_m", 0.002, False], ["angle_rad", 0.01, False]]
    assert without == [["origin_m", None, True], ["angle_rad", None, True]]
