"""Who types at a terminal: the user of this computer, also where a container's user has no name."""

import getpass
import os


def terminal_user() -> str:
    """Return the user's name; the number where the system knows no name, or cannot look it up."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user; or no descriptor is left to read the list of users
        return f"user {os.getuid()}"
