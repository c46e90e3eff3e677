"""What a screen learns of files: their names, never where they are.

Projects are called alike: of ``project.toml`` the name of its own folder is kept, too, which tells two of them apart.
"""

import re

from cellcal.calibration.message import Message, find_message, remember_message

_PART = r"[^\s/:;,'\"()]+"  # of a path
_ABSOLUTE = rf"\.{{0,2}}(?:/{_PART}(?: {_PART})*)+"
_OF_A_JOB = rf"(?:sources|cell|clone|programs)(?:/{_PART})*"
_FOLDER = re.compile(rf"(?<![\w./])(?:{_ABSOLUTE}|{_OF_A_JOB})/(?=[^\s/])")


def _kept_folder(folders: re.Match[str]) -> str:
    is_project = folders.string.startswith("project.toml", folders.end())
    return f"{folders[0].split('/')[-2]}/" if is_project else ""


def without_paths(text: str) -> str:
    """Return a sentence in which every file is named by its last part only: no screen learns where files are."""
    made = find_message(text)
    if made is None:
        return _FOLDER.sub(_kept_folder, text)
    arguments = {name: without_paths(argument) for name, argument in made.arguments.items()}
    redacted = Message.from_template(made.template, arguments)
    remember_message(redacted)
    return redacted
