"""The service's description of itself; that answers are as it says, every client of the tests checks."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import BaseModel

from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from cellcal.service.web.fleet import create_fleet_app
from tests.service.openapi_check import DescribedApi
from tests.service.test_fleet import PlayedFleet


class LengthAnswer(BaseModel):
    """What a route says that it answers."""

    length_m: float
    names: list[str] = []


@pytest.fixture(params=["a cell's service", "the monitor of a site"])
def api_description(request: pytest.FixtureRequest, tmp_path: Path) -> dict[str, Any]:
    if request.param == "the monitor of a site":
        return create_fleet_app(PlayedFleet(tmp_path, 1), tmp_path).openapi()
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    return create_app(ServiceSettings(path, open_access=True)).openapi()


def test_every_route_says_what_a_refusal_is(api_description: dict[str, Any]) -> None:
    for path, methods in api_description["paths"].items():
        for method, operation in methods.items():
            for status in ("422", "default"):
                schema = operation["responses"][status]["content"]["application/json"]["schema"]
                assert schema == {"$ref": "#/components/schemas/RefusalResponse"}, f"{method} {path}"
    assert api_description["components"]["schemas"]["RefusalResponse"]["required"] == [
        "code",
        "message",
        "remedy",
    ]


def test_every_route_says_what_is_in_its_answers(api_description: dict[str, Any]) -> None:
    """An object of anything is one only where a reason stands beside it."""
    vague = []
    for path, methods in api_description["paths"].items():
        for method, operation in methods.items():
            (good,) = (response for status, response in operation["responses"].items() if status[0] == "2")
            assert good["content"], f"{method} {path}"
            schema = good["content"].get("application/json", {}).get("schema")
            if schema is not None:
                vague += [
                    f"{method} {path}: {place}"
                    for place in _vague_schemas(api_description, schema, "answer", frozenset())
                ]
    assert not vague


def _vague_schemas(
    spec: dict[str, Any], schema: dict[str, Any], place: str, visited: frozenset[str]
) -> Iterator[str]:
    """Yield where a schema lets anything pass and does not say why."""
    if (ref := schema.get("$ref")) is not None:
        if ref not in visited:
            named = spec["components"]["schemas"][ref.removeprefix("#/components/schemas/")]
            yield from _vague_schemas(spec, named, f"{place}({named['title']})", visited | {ref})
        return
    others = schema.get("additionalProperties", True)
    open_object = schema.get("type") == "object" and "properties" not in schema and others is True
    anything = not schema.keys() & {"type", "anyOf", "oneOf", "enum", "const"}
    if (anything or open_object) and not schema.get("description"):
        yield place
    inner = [*schema.get("properties", {}).items(), *enumerate(schema.get("prefixItems", ()))]
    inner += [("each", one) for one in (schema.get("items"), others) if isinstance(one, dict)]
    inner += [("or", one) for word in ("anyOf", "oneOf") for one in schema.get(word, ())]
    for name, each in inner:
        yield from _vague_schemas(spec, each, f"{place}.{name}", visited)


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

    async def length_route() -> Any:
        return answer

    app.get("/api/length/{of}", response_model=LengthAnswer)(length_route)
    hooks = {"response": [DescribedApi(app).check_answer]}
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://a", event_hooks=hooks) as client:
        if says is None:
            await client.get("/api/length/wire")
        else:
            with pytest.raises(AssertionError, match=says):
                await client.get("/api/length/wire")
