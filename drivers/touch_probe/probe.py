"""A touch-trigger probe on a digital input, watched by polling."""

import asyncio
import math
import time
from dataclasses import dataclass, field

from cellcal.drivers.errors import BusyError, RefusedError
from cellcal.drivers.interfaces import ContactEdge, ContactReading, ProbeCapabilities
from cellcal.drivers.touch_probe.coupler import Coupler, InputImage
from cellcal.drivers.touch_probe.coupler_device import CouplerDevice
from cellcal.drivers.wire.deadline import answer_deadline

_ECHO_EVERY_S = 0.05
_WORDS_KEPT = 64


@dataclass(frozen=True, slots=True)
class ProbeOptions:
    """The cell file's options of watching this probe."""

    deadline_s: float
    poll_s: float
    bounce_s: float  # the longest bounce of a healthy probe
    debounce_s: float  # closed for that long is closed
    fewest_closed: int  # and in that many images: a few could all fall between two bounces
    silence_s: float  # longest wait for an image while a touch is waited for
    normally_closed: bool = False


@dataclass(slots=True)
class _TouchWatch:
    """The observations of one touch so far."""

    open_asked_s: float  # of the last image before the first closed one
    first_closed_s: float = math.inf
    closed_since_s: float = math.inf
    sprung_s: float = 0.0  # how long after the first closure it was seen open
    images_closed: int = 0  # one after the other
    bounces: int = 0
    words: list[int] = field(default_factory=list)


class CouplerTouchProbe(CouplerDevice):
    """TouchProbe over one input of a coupler."""

    def __init__(self, coupler: Coupler, capabilities: ProbeCapabilities, options: ProbeOptions) -> None:
        super().__init__(coupler, options.deadline_s)
        self._capabilities, self._options = capabilities, options
        self._watching = False

    @property
    def capabilities(self) -> ProbeCapabilities:
        return self._capabilities

    async def read_contact(self) -> ContactReading:
        async with answer_deadline(self.name, self._options.deadline_s, "reading the contact"):
            image = await self._coupler.read_fresh_image()
        return ContactReading(self._is_closed(image), image.answered_s, self._digital_word(image))

    async def wait_for_touch(self) -> ContactEdge:
        if self._watching:
            raise BusyError(self.name, "a touch is being waited for already.")
        self._watching = True
        try:
            return await self._watch_contact()
        finally:
            self._watching = False

    async def _watch_contact(self) -> ContactEdge:
        first = await self._coupler.read_fresh_image()
        if self._is_closed(first):
            raise RefusedError(
                self.name,
                "the probe's contact is closed already.",
                remedy="Move the tip clear of everything; if it stays closed, check probe and cable.",
            )
        watch = _TouchWatch(first.asked_s, words=[self._digital_word(first)])
        echo_s = time.monotonic()
        while (edge := self._confirmed_touch(watch)) is None:
            await asyncio.sleep(self._options.poll_s)
            async with answer_deadline(self.name, self._options.silence_s, "looking at the contact"):
                if time.monotonic() - echo_s > _ECHO_EVERY_S:
                    echo_s = time.monotonic()
                    await self._coupler.turn_echo()
                self._note_image(watch, await self._coupler.read_image())
        return edge

    def _note_image(self, watch: _TouchWatch, image: InputImage) -> None:
        pending, word = watch.first_closed_s < math.inf, self._digital_word(image)
        watch.words = [*watch.words, word][-_WORDS_KEPT:] if pending or self._is_closed(image) else [word]
        if self._is_closed(image):
            watch.first_closed_s = min(watch.first_closed_s, image.answered_s)
            watch.closed_since_s = min(watch.closed_since_s, image.answered_s)
            watch.images_closed += 1
        elif pending:
            watch.sprung_s = image.asked_s - watch.first_closed_s
            watch.bounces += watch.images_closed > 0
            watch.images_closed, watch.closed_since_s = 0, math.inf
        else:
            watch.open_asked_s = image.asked_s

    def _confirmed_touch(self, watch: _TouchWatch) -> ContactEdge | None:
        """Return the touch once its contact stays closed, or has sprung for longer than a healthy one."""
        sound = watch.sprung_s <= self._options.bounce_s
        stays = time.monotonic() - watch.closed_since_s >= self._options.debounce_s
        if sound and not (stays and watch.images_closed >= self._options.fewest_closed):
            return None
        can = self._capabilities
        # an open image may have been taken between two bounces of a touch that was earlier still
        earlier_s = can.delay_s + can.delay_tolerance_s + self._options.bounce_s
        return ContactEdge(
            earliest_s=watch.open_asked_s - earlier_s,
            latest_s=watch.first_closed_s - can.delay_s + can.delay_tolerance_s,
            bounces=watch.bounces,
            steady=sound,
            raw=tuple(watch.words),
        )

    def _is_closed(self, image: InputImage) -> bool:
        return image.digital_input(self._coupler.wiring.digital_input) is not self._options.normally_closed

    def _digital_word(self, image: InputImage) -> int:
        return image.digital_word(self._coupler.wiring.digital_input)
