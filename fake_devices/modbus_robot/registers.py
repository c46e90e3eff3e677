"""The holding registers of the fake controller, block by block as its setup document lists them.

Imitates
    FANUC's HMI device option (Modbus TCP) with the assignments of the setup document.
Source
    deploy/controller_setup/fanuc_hmi.md, "Assignments" and "The handshake program".
Modelled
    Every row of both tables; unused addresses read 0; writes to unused or read-only ones do nothing; half of
    a two-word value cannot be written.
Not modelled
    Coils and input registers (all 0), changing the assignments.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from cellcal.fake_devices.arm_models import COUNTS_PER_TURN
from cellcal.fake_devices.modbus_robot.alarms import alarm_block
from cellcal.fake_devices.modbus_robot.controller import FRAMES, TOOLS, ModbusRobotController
from cellcal.fake_devices.modbus_robot.words import (
    float_words,
    int32_words,
    text_words,
    words_float,
    words_int32,
)

Words = list[int]
Read = Callable[[], Words]
Write = Callable[[Words, range], None]

POSITION, FRAME_WORDS, ALARM_PLACES = 1, 50, 5


class IllegalValueError(Exception):
    """A telegram that covers half of a value."""


@dataclass(frozen=True)
class RegisterAssignment:
    """One assignment: where it starts (1-based), how long it is, what it shows."""

    address: int
    words: int
    read: Read
    write: Write | None = None
    paired: bool = True

    @property
    def end_address(self) -> int:
        """First address behind the block."""
        return self.address + self.words


def blocks_of(controller: ModbusRobotController) -> list[RegisterAssignment]:
    """Return all blocks of a controller."""
    return [
        RegisterAssignment(POSITION, 50, partial(_position_words, controller)),
        RegisterAssignment(1501, 50, partial(_second_group_words, controller)),
        *_mastering_blocks(controller),
        *_constant_blocks(controller),
        *_frame_blocks(controller),
        RegisterAssignment(2001, 500, lambda: alarm_block(controller.active_alarms(), ALARM_PLACES)),
        RegisterAssignment(3001, 24, lambda: list(controller.program.host), controller.program.write_host),
        RegisterAssignment(3041, 14, controller.program.robot_words),
    ]


def _position_words(controller: ModbusRobotController) -> Words:
    controller.catch_up()
    joints = controller.shown_joints()
    words = float_words([*controller.user_tip(), *controller.external])
    flange = controller.arm.believed_flange(joints)[0]
    words += [int(joints[4] > 0.0), 0, 1, int(flange[0, 3] >= 0.0), 0, 0, 0, int(controller.is_mastered)]
    words += float_words([*(float(angle) for angle in np.degrees(joints)), *controller.external])
    return [*words, 1, controller.frame_number, controller.tool_number, 0, 0, 0]


def _second_group_words(controller: ModbusRobotController) -> Words:
    """Show joints alone: a positioner has no tip that the arm's frames know."""
    joints = controller.second_group
    return [0] * 50 if joints is None else [*([0] * 26), *float_words(joints), 1, *([0] * 5)]


def _mastering_blocks(controller: ModbusRobotController) -> list[RegisterAssignment]:
    def counts_at_zero(words: Words, _touched: range) -> None:
        controller.write_counts_at_zero(tuple(words_int32(words)))

    def reference_counts(words: Words, _touched: range) -> None:
        controller.reference_counts = tuple(words_int32(words))

    def reference_rad(words: Words, _touched: range) -> None:
        controller.reference_rad = tuple(words_float(words))

    def reference_done(words: Words, _touched: range) -> None:
        controller.reference_done = words_int32(words)[0] == 1

    return [
        RegisterAssignment(51, 12, lambda: int32_words(controller.counts_at_zero), counts_at_zero),
        RegisterAssignment(63, 12, lambda: int32_words(controller.coders.read_counts())),
        RegisterAssignment(75, 12, lambda: int32_words(controller.reference_counts), reference_counts),
        RegisterAssignment(87, 12, lambda: float_words(controller.reference_rad), reference_rad),
        RegisterAssignment(
            99, 2, lambda: int32_words([controller.master_done]), _single_value(controller.write_master_done)
        ),
        RegisterAssignment(101, 2, lambda: int32_words([controller.reference_done]), reference_done),
        RegisterAssignment(
            103, 2, lambda: int32_words([controller.reset_pending]), _single_value(controller.request_reset)
        ),
        RegisterAssignment(
            105, 2, lambda: int32_words([controller.override_percent]), _single_value(controller.set_override)
        ),
        RegisterAssignment(203, 2, lambda: int32_words([controller.epoch])),
    ]


def _single_value(take: Callable[[int], None]) -> Write:
    return lambda words, _touched: take(words_int32(words)[0])


def _constant_blocks(controller: ModbusRobotController) -> list[RegisterAssignment]:
    gears = controller.arm.model.gears
    ratios = np.abs(np.array(gears.ratios)) if gears else np.ones(6)
    per_degree = float_words(COUNTS_PER_TURN * ratios / 360.0)
    inverse_ratios = float_words(1.0 / ratios)
    interaction = float_words(controller.coders.radians_per_count.ravel())
    texts = ((301, controller.serial), (341, controller.model_title), (381, controller.version))
    speeds = float_words(np.degrees(controller.arm.max_speed_rad_s))
    return [
        RegisterAssignment(205, 12, lambda: speeds),
        RegisterAssignment(107, 12, lambda: per_degree),
        RegisterAssignment(119, 12, lambda: inverse_ratios),
        RegisterAssignment(131, 72, lambda: interaction),
        *(
            RegisterAssignment(address, 40, partial(text_words, text, 40), paired=False)
            for address, text in texts
        ),
    ]


def _frame_blocks(controller: ModbusRobotController) -> list[RegisterAssignment]:
    blocks = []
    for base, store, number in ((501, controller.tools, TOOLS), (1001, controller.frames, FRAMES)):
        for k in range(number):
            read, write = _frame_access(store, k)
            blocks.append(RegisterAssignment(base + FRAME_WORDS * k, FRAME_WORDS, read, write))
    return blocks


def _frame_access(store: list[list[float]], k: int) -> tuple[Read, Write]:
    def read_frame() -> Words:
        return [*float_words(store[k]), *([0] * 13), 1, *([0] * 24)]

    def write_frame(words: Words, _touched: range) -> None:
        values = words_float(words[:12])
        if not np.isfinite(values).all():
            raise IllegalValueError
        store[k] = values

    return read_frame, write_frame


class RegisterMap:
    """All registers; ``corrupt`` lets a fault change what a block shows."""

    def __init__(self, controller: ModbusRobotController) -> None:
        self._blocks = blocks_of(controller)
        self._frozen: dict[int, Words] | None = None
        self.corrupt: Callable[[RegisterAssignment, Words], Words] = lambda _block, words: words

    def freeze_picture(self, frozen: bool) -> None:
        """Show the same picture from now on, as a hung program does; writes still arrive."""
        if frozen and self._frozen is None:
            self._frozen = {block.address: block.read() for block in self._blocks}
        elif not frozen:
            self._frozen = None

    def read(self, address: int, count: int) -> Words:
        """Return registers, 1-based; unused ones are 0."""
        words = [0] * count
        for block in self._blocks:
            first, end = max(address, block.address), min(address + count, block.end_address)
            if first < end:
                shown = self.corrupt(block, self._shown_words(block))
                words[first - address : end - address] = shown[first - block.address : end - block.address]
        return words

    def _shown_words(self, block: RegisterAssignment) -> Words:
        return block.read() if self._frozen is None else self._frozen[block.address]

    def write(self, address: int, values: Words) -> None:
        """Write registers, 1-based; nothing happens unless every value is written whole."""
        hits = [
            (block, range(max(address, block.address), min(address + len(values), block.end_address)))
            for block in self._blocks
            if block.write is not None
            and address < block.end_address
            and block.address < address + len(values)
        ]
        for block, span in hits:
            if block.paired and ((span.start - block.address) % 2 or (span.stop - block.address) % 2):
                raise IllegalValueError
        for block, span in hits:
            words = block.read()
            words[span.start - block.address : span.stop - block.address] = values[
                span.start - address : span.stop - address
            ]
            if block.write is not None:
                block.write(words, range(span.start - block.address, span.stop - block.address))
