"""A cell file for scenes, so that what an ideal cell did can be certified."""

from dataclasses import replace
from pathlib import Path

from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome
from cellcal.service.runs.run_procedure import RunConditions, run_procedure
from tests.procedures.procedure_scenes import ProcedureScene

HOW = RunConditions(free_bytes=0, actor="anna")


def cell_config(folder: Path, *, serial: str = "F-1", more: str = "") -> CellConfig:
    """Write a cell file that names the ideal arm; ``more`` ends its [[gauge]] table."""
    path = write_cell_file(folder, "127.0.0.1", seed=1, time_factor=600.0)
    text = path.read_text().replace("F-104711", serial)
    assert text.count("\n[watch]") == 1  # what comes after the gauge
    path.write_text(text.replace("\n[watch]", f"{more}\n[watch]"))
    return read_cell_file(path)


async def run_in(config: CellConfig, made: ProcedureScene, name: str) -> RunOutcome:
    """Run a procedure in a scene, with the journal of that cell file."""
    cell = replace(made.cell, config_sha256=config.sha256)
    with open_journal(config) as journal:
        return await run_procedure(cell, name, made.spec, journal, how=HOW)
