"""The right to write: Robot Web Services 2 gives it to one client at a time.

Source: ABB OmniCore App SDK 1.5.0, which asks for it before it writes RAPID data and gives it back after.
"""

import logging

from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import DeviceError, RefusedError

_LOG = logging.getLogger(__name__)
_EDIT = "/rw/mastership/edit"


class EditMastership:
    """Held from the first write of a motion to its end, so that no other client can come between and bar a stop."""

    def __init__(self, link: WebLink) -> None:
        self._link, self._is_held, self._was_asked = link, False, False

    async def acquire(self) -> None:
        """Ask for it, where the controller knows it and it is not held yet; RefusedError where another has it."""
        if self._is_held or not self._link.dialect.needs_mastership:
            return
        self._was_asked = True  # the answer may get lost
        await self._link.post_action(_EDIT, "request")
        self._is_held = True

    async def release(self) -> None:
        """Give it back. Where the controller is out of reach, the next call tries again."""
        if not self._was_asked:
            return
        self._is_held = False
        try:
            await self._link.post_action(_EDIT, "release")
        except RefusedError as error:
            _LOG.info("%s: there was no mastership to give back: %s", self._link.device, error)
        except DeviceError as error:
            _LOG.warning("%s: mastership was not given back: %s", self._link.device, error)
            return
        self._was_asked = False
