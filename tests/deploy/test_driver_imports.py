"""Imports of device packages, found by their folders: a new driver needs no entry in an import contract."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DRIVERS = ROOT / "drivers"
SHARED = frozenset(
    ("errors", "interfaces", "programs", "supervision", "wire")
)  # device packages may import these
REGISTRIES = frozenset(("program_registry", "registry"))  # these import device packages
FOR_PROCEDURES = frozenset(("errors", "interfaces"))


def device_packages() -> frozenset[str]:
    """Return the names of the packages of drivers that are a brand's or a device's."""
    found = {file.parent.name for file in DRIVERS.glob("*/__init__.py")}
    return frozenset(found - SHARED - REGISTRIES)


def imported_drivers(file: Path) -> Iterator[str]:
    """Yield the name below ``cellcal.drivers`` of each import of a file, also of imports inside functions."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            modules = [f"{node.module}.{alias.name}" for alias in node.names]
        for module in modules:
            parts = module.split(".")
            if parts[:2] == ["cellcal", "drivers"] and len(parts) > 2:
                yield parts[2]


def faults(files: Iterator[Path], allowed: frozenset[str]) -> list[str]:
    """Return the imports of files from other parts of drivers than the allowed ones."""
    return [
        f"{file.relative_to(ROOT)} imports {name}"
        for file in files
        for name in imported_drivers(file)
        if name not in allowed
    ]


@pytest.mark.parametrize("package", sorted(device_packages()))
def test_a_device_package_imports_no_other_device(package: str) -> None:
    assert not faults((DRIVERS / package).rglob("*.py"), SHARED | {package})


def test_what_devices_share_imports_no_device() -> None:
    files = [
        file for name in SHARED for file in (*DRIVERS.glob(f"{name}.py"), *(DRIVERS / name).rglob("*.py"))
    ]
    assert len(files) > len(SHARED)
    assert not faults(iter(files), SHARED)


def test_procedures_import_interfaces_and_errors_only() -> None:
    assert not faults((ROOT / "procedures").rglob("*.py"), FOR_PROCEDURES)
