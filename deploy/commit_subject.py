"""Refuse a commit message whose subject is missing or longer than 72 characters (`commit-msg` hook of pre-commit)."""

import sys
from pathlib import Path

LONGEST_SUBJECT = 72


def find_fault(message: str) -> str | None:
    """Return what is wrong with a commit message, or None."""
    lines = [line for line in message.splitlines() if not line.startswith("#")]
    subject = lines[0].strip() if lines else ""
    if not subject:
        return "the commit has no subject line"
    if len(subject) > LONGEST_SUBJECT:
        return f"the subject has {len(subject)} characters; write at most {LONGEST_SUBJECT}"
    if len(lines) > 1 and lines[1].strip():
        return "the second line must be empty: the body starts on the third"
    return None


def main() -> int:
    """Check the file that git names; exit code 1 refuses the commit."""
    fault = find_fault(Path(sys.argv[1]).read_text(encoding="utf-8"))
    if fault:
        sys.stderr.write(f"commit message: {fault}.\n")
    return 1 if fault else 0


if __name__ == "__main__":
    sys.exit(main())
