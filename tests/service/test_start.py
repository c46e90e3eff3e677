"""What the service brings in before it answers: nothing that it does not need for that."""

import subprocess
import sys

HEAVY = (
    "scipy.optimize", "scipy.special", "scipy.spatial", "matplotlib", "pinocchio", "openpyxl", "typst", "zenoh",
    "canopen", "can", "pymodbus", "rtde_control", "rtde_receive",
    "cellcal.procedures.catalogue", "cellcal.calibration.identification.identify",
    "cellcal.service.runs.run_procedure",
    "cellcal.service.certificates.certificate", "cellcal.service.cell_process.cell_controller",
)  # fmt: skip


def test_the_web_process_answers_without_solver_catalogue_and_device_libraries() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", "import sys, cellcal.service.cli.app, cellcal.service.web.app; print(*sys.modules)"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert "fastapi" in completed
    assert [name for name in HEAVY if name in completed] == []
