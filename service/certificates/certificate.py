"""The certificate of a finished run: everything it claims and what it does not, signed by the cell.

A run that was refused gets a refusal record instead: what was measured, why nothing is claimed, what to do next.

The content is a function of the journal and of the cell file of that run, so that the same run gives the same
bytes whenever it is asked for.
"""

from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import join_messages, make_message
from cellcal.procedures.catalogue import definition_named
from cellcal.procedures.procedure_definition import ProcedureDefinition
from cellcal.procedures.run_history import EventKind
from cellcal.service.certificates.points import list_air_states, list_answers, list_readings, raw_data_sha256
from cellcal.service.certificates.sign_offs import list_sign_offs
from cellcal.service.certificates.text import as_text
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.configuration.instrument_tables import InstrumentCertificate
from cellcal.service.files import make_private_folder, replace_file
from cellcal.service.record.journal import Journal, JournalEvent
from cellcal.service.record.journal_files import certificates_folder, open_journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.record.run_store import RunStore, RunView
from cellcal.service.record.signing import CellKey, CheckFinding, check_document, station_key
from cellcal.service.runs.instruments import instruments_behind
from cellcal.service.runs.photos import pictures_to_json

FORMAT, REFUSAL_FORMAT = "cellcal certificate 1", "cellcal refusal record 1"
NO_TRACEABILITY = "No metrological traceability is claimed."
NOTHING_ELSE = "Nothing else is claimed to be traceable."
_CLAIMS = {
    "gauge": "Lengths refer to certificate",
    "tracker": "Places seen by the tracker refer to certificate",
    "probe": "Touches of the probe refer to certificate",
    "dial": "Travels of the dial gauge refer to certificate",
}
_CERTIFICATES = {
    "gauge": "The gauge's certificate",
    "tracker": "The tracker's certificate",
    "probe": "The touch probe's certificate",
    "dial": "The dial gauge's certificate",
}
SAFETY = (
    "This software performs no safety function. Emergency stop, protective stop, enabling device, speed and space "
    "monitoring are functions of the robot controller and the cell. Do not rely on this screen to stop the robot."
)
STATUS = "Signed by the key of the cell; not issued by an accredited laboratory."
REFUSED = frozenset({RunVerdict.REFUSED, RunVerdict.OUT_OF_TOLERANCE})
_NOTHING_CLAIMED: dict[str, Any] = {
    "word": "refused",
    "characteristics": [],
    "not_verified": [
        "Nothing is claimed of this run. What was measured stands below, to help find the cause."
    ],
}
_NO_VERDICT: dict[str, Any] = {
    "word": "undecided",
    "characteristics": [],
    "remarks": ["This procedure states no verdict."],
}


class CertificateError(CellError):
    """A run cannot be certified, or a certificate cannot be kept."""

    code = "certificate"


class NoResultError(CertificateError):
    """A run ended without anything that a certificate could state, such as one that a person declined."""


@dataclass(frozen=True, slots=True)
class IssuedCertificate:
    """A certificate or a refusal record on disk."""

    run_id: str
    word: str  # pass, fail, undecided; refused
    json_path: Path
    text_path: Path
    sha256: str
    key: CellKey


def issue_certificate(config: CellConfig, run_id: str, out: Path | None = None) -> IssuedCertificate:
    """Write the certificate of a finished run (``last`` is the newest), or of a refusal its record; as JSON and text.

    Raises
    ------
    CertificateError
        The run was neither finished nor refused, or the folder cannot be written.
    StoreError
        There is no such run, or the journal is damaged.
    """
    with open_journal(config) as journal:
        content = content_of(config, journal, RunStore(journal).resolve_run_id(run_id))
    key = station_key(config.cell.data_dir)
    refused = "refusal" in content
    signed = key.sign_document(REFUSAL_FORMAT if refused else FORMAT, content)
    sha256 = check_document(signed.encode()).sha256
    folder = out or certificates_folder(config)
    name = content["run"]["run_id"]
    file = f"{name}-refused" if refused else name  # the run may be resumed, and end well
    paths = folder / f"{file}.json", folder / f"{file}.txt"
    try:
        make_private_folder(folder)
        public_key = _write_signed(paths[0], signed, sha256)
        replace_file(paths[1], as_text(content, sha256, public_key))
    except OSError as error:
        raise CertificateError(
            f"the certificate cannot be written to {folder}: {error.strerror}.",
            remedy=f"See that the folder may be written, then `cellcal certificate {name} --cell {config.path}`.",
        ) from error
    return IssuedCertificate(name, content["verdict"]["word"], *paths, sha256, key)


def content_of(config: CellConfig, journal: Journal, run_id: str) -> dict[str, Any]:
    """Return what is certified of a finished run, or recorded of a refused one."""
    damage = journal.verify_chain()
    if damage is not None:
        raise CertificateError(
            make_message(
                "the journal is damaged after event {events}: {flaw}. Nothing is certified from it.",
                events=damage.after_seq,
                flaw=damage.reason,
            ),
            remedy="Restore a backup of data_dir.",
            code="store.damaged",
        )
    view, events = RunStore(journal).find_run(run_id), journal.list_events(run_id)
    refused = view.state in REFUSED
    if view.state != RunVerdict.PASSED and not refused:
        raise NoResultError(
            make_message(
                "run {run_id} has no result to certify. {text}", run_id=run_id, text=view.reason
            ).strip(),
            remedy=f"`cellcal show {run_id} --cell {config.path}` tells what it found; `resume` goes on with it.",
        )
    entry = definition_named(view.procedure)
    verdict: dict[str, Any] = _NOTHING_CLAIMED if refused else view.judgement or _NO_VERDICT
    points = list_readings(events, verdict)
    content = {
        "status": STATUS,
        "run": _run_of(view, entry, events),
        "cell": {"name": view.cell["cell"], "config_sha256": view.cell["config_sha256"]},
        "devices": view.cell["devices"],
        "encoder_epoch_at_start": view.cell["encoder_epoch"],
        "controller_at_start": {
            "active_frames": view.cell.get("active_frames"),
            "motion_level": view.motion_level,
            "controller_mode": view.controller_mode,
        },
        "settings": view.spec,
        "environment": list_air_states(points),
        "points": points,
        "raw_data_sha256": raw_data_sha256(events),
        "result": view.result,
        "verdict": verdict,
        "people": list_answers(events),
        "sign_off": list_sign_offs(events),
        "pictures": pictures_to_json(events),
        "traceability": _describe_traceability(config, view, entry, _end_event(events)),
        "safety": SAFETY,
    }
    return content | {"refusal": _refusal_reason(events)} if refused else content


def _refusal_reason(events: list[JournalEvent]) -> dict[str, str]:
    """Return why a run was refused and what to do next, as its end was journalled."""
    body = parse_json(_end_event(events).body)
    return {key: str(body[key]) for key in ("code", "reason", "remedy")}


def _run_of(view: RunView, entry: ProcedureDefinition, events: list[JournalEvent]) -> dict[str, Any]:
    end = _end_event(events)
    return {
        "run_id": view.run_id,
        "procedure": view.procedure,
        "title": entry.title,
        "procedure_version": view.version,
        "made_with": view.software,
        "started_utc": view.started_utc,
        "ended_utc": end.wall_utc,
        "actor": end.actor,
        "journal_head_sha256": end.hash.hex(),
    }


def _end_event(events: list[JournalEvent]) -> JournalEvent:
    return next(event for event in reversed(events) if event.kind == EventKind.ENDED)


def _describe_traceability(
    config: CellConfig, view: RunView, entry: ProcedureDefinition, end: JournalEvent
) -> str:
    """Return what may be said of the calibration of each instrument that was read, on the day of the run."""
    ways = view.spec.get("method"), view.spec.get("evidence")
    used = instruments_behind(entry, ways, view.past)
    if not used:
        return NO_TRACEABILITY
    if view.cell["config_sha256"] != config.sha256:
        return make_message(
            "{no_traceability} The cell file has been edited since the run.", no_traceability=NO_TRACEABILITY
        )
    serial = view.cell["devices"][0]["identity"]["serial"]
    robot = next((robot.name for robot in config.robots if robot.serial == serial), "")
    there, day = config.instruments_for(robot), date.fromisoformat(end.wall_utc[:10])
    certificates = {role: there[role].setup.certificate for role in used if role in there}
    present = {role: one for role, one in certificates.items() if one is not None}
    claims = [_traceability_claim(role, one) for role, one in present.items() if one.issued <= day <= one.due]
    lapsed = [_not_valid(role, one, day) for role, one in present.items() if not one.issued <= day <= one.due]
    sentences = [*claims, NOTHING_ELSE] if claims else [NO_TRACEABILITY]
    return join_messages(" ", [*sentences, *lapsed])


def _traceability_claim(role: str, certificate: InstrumentCertificate) -> str:
    accredited = f", {certificate.accreditation}" if certificate.accreditation else ""
    return (
        f"{_CLAIMS[role]} {certificate.number} of {certificate.laboratory}{accredited}, issued "
        f"{certificate.issued}, due {certificate.due}, "
        f"U = {certificate.expanded_uncertainty_mm:g} mm."
    )


def _not_valid(role: str, certificate: InstrumentCertificate, day: date) -> str:
    return f"{_CERTIFICATES[role]} {certificate.number} was not valid on {day}: due {certificate.due}."


def _write_signed(path: Path, signed: str, sha256: str) -> str:
    """Leave an intact certificate of the same content alone, also one of an earlier key; return its public key."""
    if path.exists():
        found = check_document(read_plain_bytes(path))
        if found.finding is CheckFinding.INTACT and found.sha256 == sha256:
            return found.public_key
    replace_file(path, signed)
    return check_document(signed.encode()).public_key
