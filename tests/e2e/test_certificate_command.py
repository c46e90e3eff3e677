"""From a run on a fake cell to a certificate that a stranger checks: the commands as they are typed."""

import json
import signal
from pathlib import Path

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.e2e.test_broken_on_purpose import YES, CommandProcess, fake_cell

GAUGE = """
[gauge.certificate]
number = "C-77"
laboratory = "Lab"
issued = 2000-01-01
due = 2100-01-01
expanded_uncertainty_mm = 0.05

[watch]
"""


async def test_a_redone_run_ends_in_a_certificate_that_verifies_independently(tmp_path: Path, capsys) -> None:
    async with fake_cell(tmp_path) as (path, _, events):
        path.write_text(path.read_text().replace("\n[watch]\n", GAUGE))
        short = ("--set", "poses=14", "--set", "samples=2")
        run = await CommandProcess.start("run", "mastering_record", *events, *short)
        await run.read_until(lambda line: "capture 3" in line)
        run.process.send_signal(signal.SIGINT)
        assert (await run.wait_for_end())[0] == ExitCode.CANCELLED

        redo = ("resume", "last", *events, "--from", "capture 2")
        code, words = await (await CommandProcess.start(*redo)).wait_for_end()
        assert (code, "no answer to 'discard_findings'" in words) == (ExitCode.CANCELLED, True), words
        answers = dict.fromkeys(YES, "yes")
        (tmp_path / "answers.json").write_text(json.dumps(answers | {"discard_findings": "no"}))
        code, words = await (await CommandProcess.start(*redo)).wait_for_end()
        assert (code, "nothing was discarded" in words) == (ExitCode.CANCELLED, True), words
        (tmp_path / "answers.json").write_text(json.dumps(answers | {"discard_findings": "yes"}))
        code, words = await (await CommandProcess.start(*redo)).wait_for_end()
        assert code == ExitCode.PASS, words
        assert "verdict: PASS" in words
        assert "certificate: " in words
        code, words = await (await CommandProcess.start(*redo)).wait_for_end()
        assert (code, "is finished" in words) == (ExitCode.USAGE, True), words
    cell = ("--cell", str(path))

    (signed,) = (tmp_path / "data" / "certificates").glob("*.json")
    text = signed.with_suffix(".txt").read_text()
    assert "capture 2: discarded by script" in " ".join(text.split())
    assert "certificate C-77 of Lab" in " ".join(text.split())
    before = signed.read_bytes()
    assert run_command_line(["certificate", "last", *cell, "--out", str(tmp_path / "again")]) == ExitCode.PASS
    assert capsys.readouterr().out == text
    assert (tmp_path / "again" / signed.name).read_bytes() == before

    key = tmp_path / "key.txt"
    assert run_command_line(["certificate", "key", *cell, "--out", str(key)]) == ExitCode.PASS
    assert "signing_key.pem" in capsys.readouterr().err
    other = tmp_path / "other.toml"
    other.write_text(path.read_text().replace("/data", "/elsewhere"))
    assert run_command_line(["certificate", "key", "--cell", str(other), "--out", f"{key}2"]) == ExitCode.PASS

    changed = tmp_path / "changed.json"
    changed.write_bytes(before.replace(b'"word":"pass"', b'"word":"fail"'))
    verdicts = [
        ((str(signed),), ExitCode.PASS, "who owns that key"),
        ((str(signed), "--key", str(key)), ExitCode.PASS, "It says: PASS"),
        ((str(signed), "--key", f"{key}2"), ExitCode.REFUSED, "another key"),
        ((str(changed),), ExitCode.SIGNATURE, "not the one that was signed"),
        ((str(path),), ExitCode.USAGE, "no document that cellcal signed"),
        ((str(tmp_path / "none"),), ExitCode.USAGE, "cannot be read"),
        ((str(signed), "--key", "nonsense"), ExitCode.USAGE, "no public key"),
    ]
    for words_, code, says in verdicts:
        assert run_command_line(["verify", *words_]) == code
        assert says in " ".join(capsys.readouterr().err.split())

    stick = tmp_path / "stick"
    assert run_command_line(["mastering", "export", *cell, "--out", str(stick)]) == ExitCode.PASS
    (record,) = stick.glob("*.json")
    assert run_command_line(["mastering", "import", str(record), "--cell", str(other)]) == ExitCode.PASS
    capsys.readouterr()
    assert run_command_line(["mastering", "show", "--cell", str(other)]) == ExitCode.PASS
    assert "MASTERING RECORD" in capsys.readouterr().out
    assert run_command_line(["run", "mastering_recovery", "--cell", str(other), "--dry-run"]) == ExitCode.PASS
    assert "capture 1" in capsys.readouterr().out
