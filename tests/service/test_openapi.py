"""The service's description of itself; that answers are as it says, every client of ``doors`` sees to."""

from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import BaseModel

from service.demo.fake_cell import write_cell_file
from service.web.app import Settings, create_app
from tests.service.described import Described

# Routes of which it is only said that they answer with objects: what a run, a session or a review holds is not said.
# This list may become shorter.
VAGUE = {
    "get /api/session",
    "post /api/control",
    "get /api/procedures",
    "post /api/dry-runs",
    "get /api/runs",
    "get /api/runs/{run_id}",
    "get /api/runs/{run_id}/certificate.json",
    "get /api/runs/{run_id}/review",
    "post /api/runs/{run_id}/what-if",
    "get /api/parameters/{robot_serial}/displacement",
    "get /api/models/{robot}/uncertainty",
}


class Length(BaseModel):
    """What a route says that it answers."""

    length_m: float
    names: list[str] = []


@pytest.fixture
def spec(tmp_path: Path) -> dict[str, Any]:
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    return create_app(Settings(path, open_access=True)).openapi()


def test_every_route_says_what_a_refusal_is(spec: dict[str, Any]) -> None:
    for path, methods in spec["paths"].items():
        for method, said in methods.items():
            for status in ("422", "default"):
                schema = said["responses"][status]["content"]["application/json"]["schema"]
                assert schema == {"$ref": "#/components/schemas/Refused"}, f"{method} {path}"
    assert spec["components"]["schemas"]["Refused"]["required"] == ["code", "message", "remedy"]


def test_routes_that_say_only_that_they_answer_objects_become_fewer(spec: dict[str, Any]) -> None:
    found = set()
    for path, methods in spec["paths"].items():
        for method, said in methods.items():
            (good,) = (told for status, told in said["responses"].items() if status[0] == "2")
            assert good["content"], f"{method} {path}"
            schema = good["content"].get("application/json", {"schema": {"$ref": ""}}).get("schema", {})
            inner = schema.get("items", schema)
            if "$ref" not in inner and inner.get("additionalProperties", True) is True:
                found.add(f"{method} {path}")
    assert found == VAGUE


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (JSONResponse({"length_m": 1, "names": ["a"]}), None),
        (JSONResponse({"names": []}), "length_m is missing"),
        (JSONResponse({"length_m": "1"}), "no number"),
        (JSONResponse({"length_m": True}), "no number"),
        (JSONResponse({"length_m": 1.0, "names": ["a", 2]}), r"names\[1\]: 2 is no string"),
        (JSONResponse({"length_m": 1.0}, status_code=418), "not described"),
        (PlainTextResponse("1.0"), "text/plain is not described"),
    ],
)
async def test_an_answer_that_is_not_as_described_is_caught(answer: Any, says: str | None) -> None:
    app = FastAPI()

    async def length() -> Any:
        return answer

    app.get("/api/length/{of}", response_model=Length)(length)
    hooks = {"response": [Described(app).check]}
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://a", event_hooks=hooks) as client:
        if says is None:
            await client.get("/api/length/wire")
        else:
            with pytest.raises(AssertionError, match=says):
                await client.get("/api/length/wire")
