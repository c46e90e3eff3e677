"""An SDO server: one transfer at a time, expedited or in segments.

Imitates
    The default SDO channel of a CiA 301 device.
Source
    CiA 301, SDO protocol: download and upload, initiate and segment, abort.
Modelled
    Expedited and segmented transfers both ways, toggle bits, aborts.
Not modelled
    Block transfer (refused with "command specifier not valid"), time-out of a transfer left half done.
"""

import struct

from cellcal.fake_devices.draw_wire.objects import (
    BAD_COMMAND,
    BAD_LENGTH,
    BAD_TOGGLE,
    AbortError,
    ObjectDictionary,
)


class SdoServer:
    """Answers 8-byte requests with 8-byte responses."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._address = (0, 0)
        self._sending: bytes | None = None
        self._receiving: bytearray | None = None
        self._toggle = 0

    def reset(self) -> None:
        """Forget a transfer under way."""
        self._sending = self._receiving = None

    def answer_request(self, request: bytes) -> bytes | None:
        """Return the response; None to an abort, which is not answered."""
        request = request.ljust(8, b"\0")
        command = request[0] >> 5
        if command == 4:
            self.reset()
            return None
        try:
            return self._dispatch_command(command, request)
        except AbortError as abort:
            self.reset()
            if command in (1, 2):
                self._address = _object_address(request)
            return self.abort_transfer(abort.code)

    def abort_transfer(self, code: int) -> bytes:
        """Return an abort of the present transfer."""
        return struct.pack("<BHBI", 0x80, *self._address, code)

    def _dispatch_command(self, command: int, request: bytes) -> bytes:
        if command == 1:
            return self._begin_download(request)
        if command == 0 and self._receiving is not None:
            return self._download_segment(self._receiving, request)
        if command == 2:
            return self._begin_upload(request)
        if command == 3 and self._sending is not None:
            return self._upload_segment(self._sending, request)
        raise AbortError(BAD_COMMAND)

    def _begin_upload(self, request: bytes) -> bytes:
        self._address = _object_address(request)
        data = self._dictionary.find_entry(*self._address).read_bytes()
        if len(data) <= 4:
            return struct.pack("<BHB", 0x43 | (4 - len(data)) << 2, *self._address) + data.ljust(4, b"\0")
        self._sending, self._toggle = data, 0
        return struct.pack("<BHBI", 0x41, *self._address, len(data))

    def _upload_segment(self, data: bytes, request: bytes) -> bytes:
        self._check_toggle(request)
        part, rest = data[:7], data[7:]
        last = not rest
        head = (self._toggle << 4) | (7 - len(part)) << 1 | last
        self._sending = None if last else rest
        self._toggle ^= 1
        return bytes([head]) + part.ljust(7, b"\0")

    def _begin_download(self, request: bytes) -> bytes:
        self._address = _object_address(request)
        entry = self._dictionary.find_entry(*self._address)
        if request[0] & 0x02:
            size = 4 - (request[0] >> 2 & 3) if request[0] & 0x01 else len(entry.read_bytes())
            entry.write_bytes(request[4 : 4 + size])
        else:
            self._receiving, self._toggle = bytearray(), 0
        return struct.pack("<BHB", 0x60, *self._address) + bytes(4)

    def _download_segment(self, received: bytearray, request: bytes) -> bytes:
        self._check_toggle(request)
        received += request[1 : 8 - (request[0] >> 1 & 7)]
        if len(received) > 256:
            raise AbortError(BAD_LENGTH)
        if request[0] & 1:
            self._receiving = None
            self._dictionary.find_entry(*self._address).write_bytes(bytes(received))
        head = 0x20 | self._toggle << 4
        self._toggle ^= 1
        return bytes([head]) + bytes(7)

    def _check_toggle(self, request: bytes) -> None:
        if request[0] >> 4 & 1 != self._toggle:
            raise AbortError(BAD_TOGGLE)


def _object_address(request: bytes) -> tuple[int, int]:
    index, sub = struct.unpack("<HB", request[1:4])
    return index, sub
