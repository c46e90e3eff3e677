"""What customers see: page and PDF say what was signed, figure by figure, and fetch nothing from anywhere."""

import json
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Pose
from cellcal.procedures.cell import MotionLevel
from cellcal.service.certificates.blocks import CertificatePage
from cellcal.service.certificates.certificate import FORMAT, IssuedCertificate, issue_certificate
from cellcal.service.certificates.html import as_html
from cellcal.service.certificates.page_sections import page_of
from cellcal.service.certificates.pdf import PdfError, as_pdf
from cellcal.service.certificates.pictures import (
    PointErrors,
    against_limits,
    errors_by_point,
    pictures_of,
    scatter_of,
)
from cellcal.service.certificates.printing import PrintingError, page_from, print_beside
from cellcal.service.certificates.qr import code_of, code_text
from cellcal.service.cli.certificate import write_certificate
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, ParameterValue
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.record.signing import CheckFinding, check_document, station_key
from cellcal.service.runs.run_procedure import NO_MODE
from cellcal.service.translation import Locale, Translations, writes_commas
from cellcal.service.web import history
from cellcal.service.web.dependencies import Person, person_of
from cellcal.service.web.error_responses import respond_to_error
from cellcal.service.web.response_models import MessageJsonResponse
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import user_frame_scene
from tests.service.printed_documents import HtmlText, PdfReader, squeeze_text, verify_paper
from tests.service.qr_code_reader import read_svg

HOSTILE = '<script>alert(1)</script> #image("/etc/passwd") *bold* $x$ \\ "quoted" & \'done\' {{7*7}}'


async def certified_frame_cell(folder: Path) -> tuple[CellConfig, IssuedCertificate]:
    """Return a cell whose last run taught a frame, and its certificate."""
    config = cell_config(folder)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    return config, issue_certificate(config, outcome.run_id)


def content_of(issued: IssuedCertificate) -> dict[str, Any]:
    content = json.loads(issued.json_path.read_text())["content"]
    assert isinstance(content, dict)
    return content


def paper_of(content: dict[str, Any]) -> CertificatePage:
    return page_of(content, "ab" * 32, "cd" * 32)


async def test_page_and_pdf_lie_beside_the_signed_file_and_are_the_same_each_time(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    verify_paper(issued.json_path)
    first = print_beside(issued.json_path)
    assert first.trouble == ""
    assert first.html_path == issued.json_path.with_suffix(".html")
    assert first.pdf_path == issued.json_path.with_suffix(".pdf")
    sheets = [path.read_bytes() for path in (first.html_path, first.pdf_path)]
    print_beside(issued.json_path)
    assert [path.read_bytes() for path in (first.html_path, first.pdf_path)] == sheets


async def test_the_command_prints_to_the_requested_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, issued = await certified_frame_cell(tmp_path)
    html, pdf = tmp_path / "for the customer" / "page.html", tmp_path / "for the customer" / "paper.pdf"
    assert write_certificate("last", cell=config.path, html=html, pdf=pdf) == 0
    assert capsys.readouterr().out == issued.text_path.read_text()
    beside = print_beside(issued.json_path)
    assert beside.html_path is not None
    assert beside.pdf_path is not None
    assert html.read_bytes() == beside.html_path.read_bytes()
    assert pdf.read_bytes() == beside.pdf_path.read_bytes()
    with pytest.raises(PrintingError, match="cannot be written"):
        write_certificate("last", cell=config.path, pdf=html / "under a file.pdf")


async def test_nothing_is_printed_of_a_file_with_a_flipped_byte(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    raw = bytearray(issued.json_path.read_bytes())
    place = raw.index(b'"pass"') + 1
    raw[place] ^= 1
    issued.json_path.write_bytes(raw)
    assert check_document(bytes(raw)).finding is CheckFinding.TAMPERED
    with pytest.raises(PrintingError, match="Nothing is printed"):
        page_from(issued.json_path)
    printed = print_beside(issued.json_path)
    assert (printed.html_path, printed.pdf_path) == (None, None)
    assert "Nothing is printed" in printed.trouble


async def test_the_code_on_page_and_paper_says_run_and_hash(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    page = page_from(issued.json_path)
    expected_code = f"cellcal {issued.run_id} sha256:{issued.sha256}"
    assert read_svg(page.qr.svg) == expected_code
    html = as_html(page)
    drawn = re.search(r"<header.*?(<svg.*?</svg>)", html, re.DOTALL)
    assert drawn
    assert read_svg(drawn[1]) == expected_code


@pytest.mark.parametrize("name", ["end_effector_points", "base_to_base", "a_procedure_with_a_long_name"])
def test_codes_of_all_lengths_are_read(name: str) -> None:
    stem = f"{name}-0123456789ab-refused"
    assert read_svg(code_of(stem, "5e" * 32).svg) == code_text(stem, "5e" * 32)


async def test_what_people_typed_is_text_and_nothing_else(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    content = content_of(issued)
    content["people"] = [{"who": HOSTILE, "step": "accept the frame", "at_utc": content["run"]["ended_utc"]}]
    content["cell"]["name"] = HOSTILE
    figure = content["verdict"]["characteristics"][0]
    figure["name"] = HOSTILE
    page = paper_of(content)
    html = HtmlText.read_html(as_html(page))
    assert html.asks_for == []
    times = 3 + len(figure["budget"])
    assert squeeze_text(html.text).count(squeeze_text(HOSTILE)) == times
    assert squeeze_text(PdfReader(as_pdf(page)).read_text()).count(squeeze_text(HOSTILE)) == times


async def test_a_page_allows_itself_no_script_and_no_other_host(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    html = as_html(page_from(issued.json_path))
    assert "default-src 'none'" in html
    assert "script" not in html
    assert html.count("<table>") == len(re.findall(r'</caption>(?:<col width="\d+%">)+<thead>', html)), (
        "names break"
    )
    hosts = set(re.findall(r"https?://[^\"'\s<]+", html))
    assert hosts == {"http://www.w3.org/2000/svg"}  # a name, never asked


async def test_names_in_other_scripts_are_set_or_refused_with_the_cure(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    content = content_of(issued)
    content["people"] = [{"who": "李工", "step": "accept", "at_utc": content["run"]["ended_utc"]}]
    page = paper_of(content)
    assert "李工" in as_html(page)
    outcome = set_or_cure(page)
    if isinstance(outcome, str):  # this computer has no such font
        assert "fonts-noto-cjk" in outcome
        return
    assert "李工" in outcome.read_text()
    assert len(outcome.list_fonts()) == 3
    assert all(outcome.list_fonts().values())


def set_or_cure(page: CertificatePage) -> PdfReader | str:
    try:
        return PdfReader(as_pdf(page))
    except PdfError as refused:
        return refused.remedy


async def test_characters_that_no_font_has_are_refused_and_the_page_is_kept(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    content = content_of(issued)
    content["cell"]["name"] = "\U0010fffd"
    with pytest.raises(PdfError) as refused:
        as_pdf(paper_of(content))
    assert "fonts-noto-cjk" in refused.value.remedy
    path = tmp_path / "odd.json"
    path.write_text(station_key(tmp_path).sign_document(FORMAT, content))
    printed = print_beside(path)
    assert printed.pdf_path is None
    assert "no font" in printed.trouble
    assert printed.html_path is not None
    assert "\U0010fffd" in printed.html_path.read_text()


async def test_a_refusal_is_printed_as_one(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), user_frame_scene()
    made.technician.does["touch_above"] = made.technician.does["touch_origin"]
    outcome = await run_in(config, made, "three_point_frame")
    issued = issue_certificate(config, outcome.run_id)
    assert issued.word == "refused"
    verify_paper(issued.json_path)
    page = page_from(issued.json_path)
    assert page.heading == "Refusal record"
    assert read_svg(page.qr.svg).split()[1] == f"{outcome.run_id}-refused"
    assert "PASS" not in PdfReader(as_pdf(page)).read_text()


async def test_words_without_a_blank_stay_on_the_sheet(tmp_path: Path) -> None:
    _, issued = await certified_frame_cell(tmp_path)
    content = content_of(issued)
    word = "".join(f"{k:04d}" for k in range(100))
    content["verdict"]["characteristics"][0]["name"] = word
    content["cell"]["name"] = word
    pdf = PdfReader(as_pdf(paper_of(content)))
    assert squeeze_text(pdf.read_text()).count(word) >= 2
    assert word not in pdf.read_text()  # in one piece it would be three sheets wide


def figure_of(value: float, u: float, limit: float | None, decision: str | None = "pass") -> dict[str, Any]:
    return {
        "name": f"figure {value}",
        "value": value,
        "unit": "m",
        "standard_uncertainty": u / 2,
        "expanded_uncertainty": u,
        "coverage": 2.0,
        "limit": limit,
        "decision": decision,
        "rule": "",
        "budget": [],
    }


def dots_of(svg: str) -> list[tuple[float, float]]:
    found = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="3.4" fill="#0072b2"', svg)
    return [(float(x), float(y)) for x, y in found]


def words_at(svg: str) -> dict[str, tuple[float, float]]:
    found = re.findall(r'<text x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]*)</text>', svg)
    return {words: (float(x), float(y)) for x, y, words in found}


def test_dots_stand_where_their_figures_are() -> None:
    figures = [figure_of(0.0002, 0.0001, 0.001), figure_of(-0.0015, 0.0002, 0.001, "fail")]
    drawn = against_limits([*figures, figure_of(0.5, 0.1, None), figure_of(0.9, 0.0, 0.5)])
    assert drawn is not None
    words = words_at(drawn.svg)
    zero, limit = words["0"][0], words["limit"][0]
    shares = [(x - zero) / (limit - zero) for x, _ in dots_of(drawn.svg)]
    assert shares == pytest.approx(
        [0.2, 1.5], abs=1e-3
    )  # what has no limit or no U has no place on this axis
    assert words["100"][0] == pytest.approx(limit, abs=0.11)


@pytest.mark.parametrize(("locale", "expected"), [("en", "0.2 %; "), ("de", "0,2 %; ")])
def test_a_share_below_one_percent_is_written_as_its_language_writes_numbers(
    locale: Locale, expected: str
) -> None:
    figures = [figure_of(0.000002, 0.0001, 0.001), figure_of(0.0005, 0.0001, 0.001)]
    drawn = against_limits(figures, Translations(locale, {}, writes_commas(locale)))
    assert drawn is not None
    assert expected in drawn.alt


def test_errors_stand_on_a_linear_axis_from_zero() -> None:
    values = (0.0001, 0.0004, 0.0, 0.0008)
    drawn = errors_by_point(PointErrors("what each point misses by", values))
    assert drawn is not None
    words = words_at(drawn.svg)
    zero, tick = words["0"][1] - 3.5, words["0.2"][1] - 3.5
    heights = [0.0002 * (zero - y) / (zero - tick) for _, y in dots_of(drawn.svg)]
    assert heights == pytest.approx(values, abs=2e-6)
    assert "0.800 mm at 4" in drawn.alt


def test_samples_that_agree_are_not_drawn_and_those_that_differ_are() -> None:
    def capture_data(*samples: float, used: bool = True) -> dict[str, Any]:
        return {"used": used, "value": {"readings_m": list(samples)}}

    assert scatter_of([capture_data(1.0, 1.0), capture_data(2.0)]) is None
    drawn = scatter_of([capture_data(1.0, 1.00002), capture_data(1.0, 1.0001, used=False)])
    assert drawn is not None
    assert len(dots_of(drawn.svg)) == 2 + 1  # two samples, and the key
    assert "0.050 mm" in drawn.alt


def test_check_poses_are_distinguished_from_fitted_ones() -> None:
    out = {
        "captures": 9,
        "before_rms_m": 0.002,
        "before_max_m": 0.004,
        "after_rms_m": 1e-4,
        "after_max_m": 2e-4,
    }
    content = {
        "result": {"identified": {"hold_out": out}},
        "verdict": {"characteristics": [], "changes": []},
        "points": [],
    }
    (drawn,) = pictures_of(content)
    assert "9 check poses that took no part in the fit" in drawn.caption
    assert "RMS error at check poses: 2.000 mm before, 0.100 mm after" in drawn.alt


@asynccontextmanager
async def viewer_client(config: CellConfig) -> AsyncIterator[httpx.AsyncClient]:
    """Open the routes to a viewer: they allow reading only."""
    app = FastAPI(default_response_class=MessageJsonResponse)
    app.include_router(history.router, prefix="/api")
    app.add_exception_handler(CellError, respond_to_error)
    app.dependency_overrides[person_of] = lambda: Person("vera", "viewer")
    app.state.context = SimpleNamespace(config=config)
    transport = httpx.ASGITransport(app=app)
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
        yield client


async def test_a_certificate_is_read_in_every_form(tmp_path: Path) -> None:
    config, issued = await certified_frame_cell(tmp_path)
    async with viewer_client(config) as client:
        answers = {
            form: await client.get(f"/api/runs/{issued.run_id}/certificate.{form}")
            for form in ("json", "pdf", "html", "txt")
        }
        lost = await client.get("/api/runs/three_point_frame-none/certificate.pdf")
    assert {form: answer.status_code for form, answer in answers.items()} == dict.fromkeys(answers, 200)
    assert check_document(answers["json"].content).finding is CheckFinding.INTACT
    assert issued.sha256 in squeeze_text(PdfReader(answers["pdf"].content).read_text())
    assert issued.run_id in answers["pdf"].headers["content-disposition"]
    assert issued.sha256 in answers["html"].text
    assert answers["html"].headers["content-security-policy"].startswith("default-src 'none'")
    assert answers["txt"].text == issued.text_path.read_text()
    assert lost.status_code == 422
    assert lost.json()["remedy"]


def store_twice(config: CellConfig) -> None:
    first = ParameterSet(
        robot_serial="F-1",
        model="fanuc_m6ib",
        nominal_sha256="0" * 64,
        made_at="2026-01-01T00:00:00+00:00",
        made_by="anna",
        source=f"identification: cell_7.csv, sha256 {'ab' * 32}",
        values=(ParameterValue("J1 offset", "rad", 0.001, 0.0001), ParameterValue("J2 offset", "rad", 0.002)),
    )
    sets = ParameterSets(config.path.parent / "parameter_sets")
    sets.save_draft(first)
    sets.save_draft(
        replace(
            first,
            made_by="bert",
            values=(ParameterValue("J1 offset", "rad", 0.0015, 0.0001), first.values[1]),
        )
    )


async def test_parameter_sets_and_what_changed_between_them(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    async with viewer_client(config) as client:
        assert (await client.get("/api/parameters")).json() == []
        store_twice(config)
        listed = (await client.get("/api/parameters")).json()
        changed = (await client.get("/api/parameters/diff", params={"robot_serial": "F-1"})).json()
        whole = (await client.get("/api/parameters/F-1", params={"version": 1})).json()
        wrong = [
            await client.get("/api/parameters/diff", params={"robot_serial": "F-1", "after": 1}),
            await client.get("/api/parameters/diff", params={"robot_serial": "../../etc"}),
            await client.get("/api/parameters/F-1", params={"version": 9}),
            await client.get("/api/parameters/none"),
            await client.get("/api/parameters/diff"),
        ]
    template = "identification: {file}, sha256 {sha256}"  # the set's own file holds English alone
    assert {message["template"] for each in listed for message in each["messages"].values()} == {template}
    assert [(each["version"], each["made_by"]) for each in listed] == [(1, "anna"), (2, "bert")]
    (change,) = changed["changes"]
    assert (change["name"], change["before"], change["after"]) == ("J1 offset", 0.001, 0.0015)
    assert change["deviations"] == pytest.approx(0.0005 / (2**0.5 * 0.0001))
    assert whole["parameters"][1] == {
        "name": "J2 offset",
        "unit": "rad",
        "value": 0.002,
        "standard_uncertainty": None,
        "determined": True,
    }
    assert [answer.status_code for answer in wrong] == [422] * 5


async def test_a_trend_goes_through_all_finished_runs_of_a_robot(tmp_path: Path) -> None:
    config, first = await certified_frame_cell(tmp_path)
    second = await run_in(config, user_frame_scene(), "three_point_frame")
    query = {"robot_serial": "F-1", "procedure": "three_point_frame"}
    async with viewer_client(config) as client:
        trend_answer = (await client.get("/api/trend", params=query)).json()
        other = (await client.get("/api/trend", params=query | {"robot_serial": "F-2"})).json()
    figures = content_of(first)["verdict"]["characteristics"]
    assert [trend["name"] for trend in trend_answer] == [figure["name"] for figure in figures]
    for trend, figure in zip(trend_answer, figures, strict=True):
        assert [point["run_id"] for point in trend["points"]] == [first.run_id, second.run_id]
        assert trend["points"][0]["value"] == figure["value"]
        assert trend["points"][0]["expanded_uncertainty"] == figure["expanded_uncertainty"]
        assert trend["points"][0]["started_utc"] == content_of(first)["run"]["started_utc"]
    assert other == []


def controller_of(page: CertificatePage) -> dict[str, str]:
    """Return the rows of what was selected on the controller; none where the page does not say it."""
    sections = [section for section in page.sections if section.title == "The controller when the run began"]
    return {name: value for section in sections for block in section.blocks for name, value in block.rows}  # type: ignore[union-attr]


async def test_tool_frame_payload_level_and_mode_are_signed_and_on_every_sheet(tmp_path: Path) -> None:
    made = user_frame_scene()
    made.arm.payload_kg, made.arm.user_frame, made.arm.active_tool = 4.25, 2, 3
    made.arm.tools[3] = Pose((0.01, -0.02, 0.3))
    config = cell_config(tmp_path)
    outcome = await run_in(config, made, "three_point_frame")
    issued = issue_certificate(config, outcome.run_id)
    signed = content_of(issued)["controller_at_start"]
    assert signed["motion_level"] == "commanded"
    assert signed["controller_mode"] == "AUTO"
    assert signed["active_frames"]["tool_number"] == 3
    assert signed["active_frames"]["payload_kg"] == 4.25
    rows = controller_of(page_from(issued.json_path))
    assert rows["active tool"].startswith("number 3: x 10.000, y -20.000, z 300.000 mm")
    assert rows["user frame"] == "number 2"
    assert rows["payload"] == "4.250 kg"
    assert rows["controller mode"] == "AUTO"
    assert rows["moved by"] == "this software"
    sheets = (
        issued.text_path.read_text(),
        HtmlText.read_html(as_html(page_from(issued.json_path))).text,
        PdfReader(as_pdf(page_from(issued.json_path))).read_text(),
    )
    for sheet in map(squeeze_text, sheets):
        for value in rows.values():
            assert squeeze_text(value) in sheet
    assert not any("mode the controller" in line for line in content_of(issued)["verdict"]["not_verified"])


async def test_what_a_robot_does_not_tell_stays_not_verified(tmp_path: Path) -> None:
    made = user_frame_scene()
    made.cell = replace(made.cell, frames=None, mode=None, level=MotionLevel.OBSERVE)
    config = cell_config(tmp_path)
    outcome = await run_in(config, made, "three_point_frame")
    content = content_of(issue_certificate(config, outcome.run_id))
    rows = controller_of(paper_of(content))
    item_names = ("active tool", "user frame", "payload", "controller mode")
    assert {rows[name] for name in item_names} == {"not verified, this robot does not tell it"}
    assert rows["moved by"] == "a person with the pendant"
    assert NO_MODE in content["verdict"]["not_verified"]


async def test_a_certificate_from_before_verifies_and_is_printed_without_what_it_does_not_say(
    tmp_path: Path,
) -> None:
    config, issued = await certified_frame_cell(tmp_path)
    content = content_of(issued)
    del content["controller_at_start"]
    issued.json_path.write_text(station_key(config.cell.data_dir).sign_document(FORMAT, content))
    assert check_document(issued.json_path.read_bytes()).finding is CheckFinding.INTACT
    assert controller_of(page_from(issued.json_path)) == {}
    assert print_beside(issued.json_path).trouble == ""
