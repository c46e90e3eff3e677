"""Only the files that a checkout needs stand in its top folder: no output of a command that was tried there."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ALLOWED_FILES = {
    ".gitignore",
    ".pre-commit-config.yaml",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "DECISIONS.md",
    "LICENSE",
    "Makefile",
    "README.md",
    "SECURITY.md",
    "pyproject.toml",
    "requirements-build.in",
    "requirements-build.lock",
    "requirements-dev.lock",
    "requirements.lock",
}


@pytest.mark.skipif(
    shutil.which("git") is None or not (ROOT / ".git").exists(),
    reason="only a clone knows which files are stored",
)
def test_only_known_files_stand_in_the_top_folder() -> None:
    stored = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert {name for name in stored if "/" not in name} <= ALLOWED_FILES
