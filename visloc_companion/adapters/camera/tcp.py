"""A camera that streams frames over TCP (`tcp:HOST:PORT`): the simulator, or a camera process of one's own."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from visloc_companion.adapters.camera.after_stall import WAITED, AfterStall
from visloc_companion.adapters.camera.framing import EncodedFrame, Encoding, FrameDecoder, StreamedFrame, encode_frame
from visloc_companion.adapters.camera.image import HALF_DECODED, require_size, stored
from visloc_companion.errors import CameraError
from visloc_companion.protocols import Clock, FrameSlots
from visloc_companion.types import CameraModel, FrameRef

__all__ = ["Encoding", "FrameDecoder", "StreamedFrame", "TcpCamera", "encode_frame"]

READ_BYTES = 1 << 18
CONNECT_TIMEOUT_S, PATIENCE_S = 2.5, 2.0
"""Together less than what the daemon waits for a frame (5 s), so that it can say why there is none."""


class TcpCamera:
    """Connects to `address` (HOST:PORT) and again, `reconnect_s` later, whenever the connection is refused or lost.

    A frame stamped by the autopilot's clock carries `t_boot_ns`; its `t_ns`, as that of all others, is arrival less `latency_s`.
    Of frames that arrive together only the newest is decoded, the others count in `skipped`; those of another
    clock that waited while the stream stalled are left out and count in `waited`, undecodable ones in `damaged`.
    Raises CameraError for an address that is none.
    """

    def __init__(self, address: str, model: CameraModel, clock: Clock, latency_s: float = 0.0, reconnect_s: float = 0.5) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise CameraError("is not HOST:PORT", where=f"tcp:{address}", remedy="for example camera.url = 'tcp:127.0.0.1:5600'")
        self._host, self._port, self._where = host.strip("[]"), int(port), f"tcp:{address}"
        self._model, self._clock = model, clock
        self._latency_ns, self._reconnect_ns = round(latency_s * 1e9), round(reconnect_s * 1e9)
        self._max_payload = model.width_px * model.height_px * 3 * 5 // 4 + (1 << 16)
        self._writer: asyncio.StreamWriter | None = None
        self._closed = False
        self._refusal = ""
        self._after_stall = AfterStall()
        self._frame_id = 0
        self.connections = self.resyncs = self.damaged = self.skipped = self.waited = 0

    def model(self) -> CameraModel:
        """The configured calibration."""
        return self._model

    async def frames(self, slots: FrameSlots) -> AsyncIterator[FrameRef]:
        """Frames as they come, until `close`; yields nothing while there is no connection.

        Raises CameraError for frames of another size than the calibration's or of another version of the stream, and where
        nobody has answered for `PATIENCE_S`.
        """
        alone_since_ns = self._clock.now_ns()
        while not self._closed:
            reader = await self._connected()
            if reader is None:
                self._complain(self._clock.now_ns() - alone_since_ns)
            else:
                decoder = FrameDecoder(self._max_payload)
                try:
                    while data := await self._read(reader):
                        before = decoder.resyncs
                        frame = await self._newest(decoder.feed(data))
                        self.resyncs += decoder.resyncs - before
                        if frame is None:
                            continue
                        self._frame_id += 1
                        if frame.autopilot_clock or self._after_stall.is_fresh(self._clock.now_ns()):
                            yield self._stored(slots, frame)
                        else:
                            self.waited += 1
                finally:
                    self._disconnect()
                alone_since_ns = self._clock.now_ns()
            if not self._closed:
                await self._clock.sleep_until(self._clock.now_ns() + self._reconnect_ns)

    def left_out(self) -> dict[str, int]:
        """See protocols.Camera."""
        return {WAITED: self.waited, HALF_DECODED: self.damaged}

    async def close(self) -> None:
        """Drop the connection; `frames` ends."""
        self._closed = True
        self._disconnect()

    async def _connected(self) -> asyncio.StreamReader | None:
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                reader, self._writer = await asyncio.open_connection(self._host, self._port)
        except OSError as why:  # TimeoutError is one
            self._refusal = str(why) or "no answer"
            return None
        self.connections += 1
        return reader

    def _complain(self, alone_ns: int) -> None:
        if alone_ns > PATIENCE_S * 1e9:
            raise CameraError(
                f"no camera process answers there: {self._refusal}",
                where=self._where,
                remedy="start the process that sends the frames; it listens, and this program connects to it",
            )

    async def _read(self, reader: asyncio.StreamReader) -> bytes:
        try:
            return b"" if self._closed else await reader.read(READ_BYTES)
        except OSError:
            return b""

    async def _newest(self, frames: list[EncodedFrame]) -> StreamedFrame | None:
        if not frames:
            return None
        self.skipped += len(frames) - 1
        newest = frames[-1]
        require_size(newest.width_px, newest.height_px, self._model, self._where)
        raw = newest.encoding is Encoding.RAW
        decoded = newest.decoded() if raw else await asyncio.to_thread(newest.decoded)
        self.damaged += decoded is None
        return decoded

    def _stored(self, slots: FrameSlots, frame: StreamedFrame) -> FrameRef:
        now_ns = self._clock.now_ns()
        t_boot_ns = frame.t_us * 1000 if frame.autopilot_clock else None
        return stored(slots, frame.pixels, self._frame_id, now_ns, now_ns - self._latency_ns, t_boot_ns)

    def _disconnect(self) -> None:
        if self._writer is not None:
            with contextlib.suppress(OSError):
                self._writer.close()
            self._writer = None
