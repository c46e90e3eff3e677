"""The right to write: Robot Web Services 2 gives it to one client at a time.

Source: ABB OmniCore App SDK 1.5.0, which asks for it before it writes RAPID data and gives it back after.
"""

import logging

from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import DeviceError, RefusedError

_LOG = logging.getLogger(__name__)
_EDIT = "/rw/mastership/edit"


class EditMastership:
    """The mastership of a motion, from its first write to its end: no other client can bar a stop meanwhile."""

    def __init__(self, link: WebLink) -> None:
        self._link, self._has_mastership, self._may_have_mastership = link, False, False

    async def acquire(self) -> None:
        """Request it where the controller knows it and we lack it; RefusedError where another client has it."""
        if self._has_mastership or not self._link.dialect.needs_mastership:
            return
        self._may_have_mastership = True  # the answer may get lost
        await self._link.post_action(_EDIT, "request")
        self._has_mastership = True

    def note_loss(self) -> None:
        """Take it for lost after a write that was refused: the next call asks for it again."""
        self._has_mastership = False

    async def release(self) -> None:
        """Give it back. Where the controller is out of reach, the next call tries again."""
        if not self._may_have_mastership:
            return
        self._has_mastership = False
        try:
            await self._link.post_action(_EDIT, "release")
        except RefusedError as error:
            _LOG.info("%s: there was no mastership to give back: %s", self._link.device, error)
        except DeviceError as error:
            _LOG.warning("%s: mastership was not given back: %s", self._link.device, error)
            return
        self._may_have_mastership = False
