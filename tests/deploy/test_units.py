"""What is deployed: units that systemd reads without a word and that expose little, a policy, CAN files."""

import configparser
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from cellcal.service.cli.app import app
from cellcal.service.people.pin_hashing import CREDENTIAL

DEPLOY = Path(__file__).parents[2] / "deploy"
UNITS = sorted((*DEPLOY.rglob("*.service"), *DEPLOY.rglob("*.timer")))
SYSTEM = Path("/usr/lib/systemd/system")
MOST_EXPOSED = {"cellcal@": 2.0, "cellcal-site-router": 2.0, "cellcal-backup@": 1.0}
INSTANCE = {"cellcal-can@": "can0"}
ANALYZE = shutil.which("systemd-analyze")
MISSING = "systemd-analyze is not on this computer: the units were read here, and systemd itself did not verify them."


def read_unit_settings(path: Path) -> dict[str, dict[str, list[str]]]:
    """Return a unit's settings; a key may stand more than once."""
    found: dict[str, dict[str, list[str]]] = {}
    section = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if match := re.fullmatch(r"\[(\w+)\]", line):
            section = match[1]
            found[section] = {}
        elif line and not line.startswith("#"):
            key, equals, value = line.partition("=")
            assert equals, f"{path.name}: {line}"
            assert section, f"{path.name}: {line}"
            found[section].setdefault(key, []).append(value)
    return found


def unit_name(path: Path) -> str:
    """Return a unit's name with an instance where it takes one."""
    instance = INSTANCE.get(path.stem, "cell-7")
    return path.name.replace("@.", f"@{instance}.")


def install_units(root: Path) -> Path:
    """Lay the units out as they are installed, with the programs that they start."""
    folder = root / "etc/systemd/system"
    folder.mkdir(parents=True)
    (root / "usr/lib/systemd").mkdir(parents=True)
    shutil.copytree(SYSTEM, root / "usr/lib/systemd/system", symlinks=True, ignore_dangling_symlinks=True)
    for unit in UNITS:
        shutil.copy(unit, folder)
        for command in read_unit_settings(unit).get("Service", {}).get("ExecStart", []):
            program = root / command.split()[0].lstrip("/")
            program.parent.mkdir(parents=True, exist_ok=True)
            program.write_text("#!/bin/sh\n")
            program.chmod(0o755)
    return root


def test_systemd_reads_every_unit_without_a_word(tmp_path: Path) -> None:
    assert len(UNITS) >= 6
    if ANALYZE is None:
        print(MISSING)
        return
    root = install_units(tmp_path)
    verify = [ANALYZE, "verify", f"--root={root}", "--man=no", *(unit_name(unit) for unit in UNITS)]
    completed = subprocess.run(verify, capture_output=True, text=True, check=False)
    own = [line for line in completed.stderr.splitlines() if "cellcal" in line]
    assert (completed.returncode, own) == (0, [])
    broken = root / "etc/systemd/system/cellcal@.service"
    broken.write_text(broken.read_text().replace("ProtectHome=", "ProtectHom="))
    again = subprocess.run(verify, capture_output=True, text=True, check=False)
    assert "Unknown key" in again.stderr, "so the check sees what is wrong"


@pytest.mark.parametrize(
    "unit",
    [unit for unit in UNITS if unit.name.removesuffix(".service") in MOST_EXPOSED],
    ids=lambda unit: unit.name,
)
def test_a_service_exposes_little(unit: Path) -> None:
    if ANALYZE is None:
        print(MISSING)
        return
    completed = subprocess.run(
        [ANALYZE, "security", "--offline=yes", "--no-pager", unit],
        capture_output=True,
        text=True,
        check=False,
    )
    exposure = re.search(r"Overall exposure level for \S+: ([\d.]+)", completed.stdout)
    assert exposure, completed.stderr
    assert float(exposure[1]) <= MOST_EXPOSED[unit.stem], completed.stdout


def test_units_start_commands_that_there_are() -> None:
    for unit in UNITS:
        for command in read_unit_settings(unit).get("Service", {}).get("ExecStart", []):
            words = command.split()
            if words[0] != "/opt/cellcal/bin/cellcal":
                continue
            _, bound, _ = app.parse_args(_without_files(words[1:]), exit_on_error=False, print_error=False)
            assert bound, command


def _without_files(words: list[str]) -> list[str]:
    return [word.replace("%i", "cell-7").replace("%d", "/run/credentials") for word in words]


def test_the_pepper_comes_as_the_credential_that_the_program_looks_for() -> None:
    service = read_unit_settings(DEPLOY / "services/cellcal@.service")["Service"]
    name, _, path = service["LoadCredentialEncrypted"][0].partition(":")
    assert name == CREDENTIAL
    assert path == f"/etc/credstore.encrypted/{CREDENTIAL}-%i"
    for unit in UNITS:
        text = unit.read_text(encoding="utf-8")
        assert "Environment=" not in text or not re.search(r"Environment=.*(PASS|SECRET|TOKEN|KEY)", text)


def test_a_can_interface_does_not_hide_a_bus_off() -> None:
    network = read_unit_settings(DEPLOY / "can_interface/80-cellcal-can.network")
    assert network["CAN"].keys() == {"BitRate", "SamplePoint"}  # no RestartSec: a technician has to look
    rate, point = network["CAN"]["BitRate"][0], network["CAN"]["SamplePoint"][0]
    assert (rate, point) == ("250K", "87.5%")
    service = read_unit_settings(DEPLOY / "can_interface/cellcal-can@.service")["Service"]
    assert "bitrate 250000 sample-point 0.875 restart-ms 0" in service["ExecStart"][0]
    assert service["CapabilityBoundingSet"] == ["CAP_NET_ADMIN"]
    link = read_unit_settings(DEPLOY / "can_interface/80-cellcal-can.link")
    assert link["Link"]["Name"] == network["Match"]["Name"] == ["can0"]


def test_a_tablet_shows_one_address_and_keeps_what_enrolled_it() -> None:
    policy = json.loads((DEPLOY / "tablet/chromium_policy.json").read_text(encoding="utf-8"))
    assert policy["URLBlocklist"] == ["*"]
    (address,) = policy["URLAllowlist"]
    assert re.fullmatch(r"https://[a-z0-9.-]+:\d+", address)
    assert policy["SSLErrorOverrideAllowed"] is False
    assert not {key for key in policy if "Clear" in key}, "the tablet's key would go with it"
    service = read_unit_settings(DEPLOY / "tablet/cellcal-kiosk.service")["Service"]
    (command,) = service["ExecStart"]
    profile = re.search(r"--user-data-dir=(\S+)", command)
    assert profile
    assert profile[1].startswith(f"/var/lib/{service['StateDirectory'][0]}/")
    assert "--no-sandbox" not in command
    assert "--disable-pinch" not in command


def test_every_folder_has_its_page_and_the_page_names_what_is_in_it() -> None:
    for name in ("services", "can_interface", "tablet", "backup"):
        page = (DEPLOY / name / "README.md").read_text(encoding="utf-8")
        missing = [
            path.name for path in (DEPLOY / name).iterdir() if path.name not in page and path.suffix != ".md"
        ]
        assert missing == []
        assert f"`{name}/`" in (DEPLOY / "README.md").read_text(encoding="utf-8")


def test_settings_are_read_as_configparser_reads_them() -> None:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    path = DEPLOY / "backup/cellcal-backup@.timer"
    parser.read(path)
    assert read_unit_settings(path)["Timer"] == {key: [value] for key, value in parser["Timer"].items()}
