"""A CAN bus of python-can over UDP on loopback, between processes; the folder beside it makes it an interface.

The end that waits passes the frames of each end on to the others.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
from typing import Any

import can

FRAME = struct.Struct("<IBB8s")  # id, flags, length, data
ERROR, FD = 1, 2
COMES, LEAVES = b"+", b"-"


class LoopbackBus(can.BusABC):
    """One end of the bus.

    Args:
        channel: "127.0.0.1:4000", the other end; "" for the end that waits for one, on any port.
    """

    def __init__(
        self, channel: str = "", can_filters: Any = None, *, bitrate: int = 0, fd: bool = False, **_: Any
    ) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.setblocking(False)
        self.bitrate, self.peers = bitrate, set[Any]()
        if channel:
            host, _, port = channel.partition(":")
            self.socket.connect((host, int(port)))
            self._say(COMES)
        else:
            self.socket.bind(("127.0.0.1", 0))
        self.channel = "{}:{}".format(*self.socket.getsockname())
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if msg.is_fd and self._can_protocol is can.CanProtocol.CAN_20:
            raise can.CanOperationError("this bus is for classic frames")
        flags = ERROR * msg.is_error_frame + FD * msg.is_fd
        data = FRAME.pack(msg.arbitration_id, flags, len(msg.data), bytes(msg.data))
        try:
            if self.channel_info != "waits":
                self.socket.send(data)
            for peer in self.peers:
                self.socket.sendto(data, peer)
        except OSError as cause:
            raise can.CanOperationError(str(cause)) from cause

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        for wait in (False, True):  # most often it is there already
            if wait and not select.select([self.socket], [], [], timeout)[0]:
                break
            with contextlib.suppress(BlockingIOError):
                try:
                    data, sender = self.socket.recvfrom(FRAME.size)
                except ConnectionRefusedError as cause:
                    raise can.CanOperationError("nobody is at the other end") from cause
                if self.channel_info == "waits":
                    self.peers = self.peers - {sender} if data == LEAVES else self.peers | {sender}
                    for peer in self.peers - {sender}:
                        self.socket.sendto(data, peer)
                if data in (COMES, LEAVES):
                    continue
                own, flags, length, content = FRAME.unpack(data)
                message = can.Message(
                    arbitration_id=own, data=content[:length], is_extended_id=False,
                    is_error_frame=bool(flags & ERROR), is_fd=bool(flags & FD),
                )  # fmt: skip
                return message, False
        return None, False

    @classmethod
    def waiting(cls) -> LoopbackBus:
        """The end to which others connect; it is heard by all of them."""
        bus = cls(fd=True)
        bus.channel_info = "waits"
        return bus

    def _say(self, word: bytes) -> None:
        with contextlib.suppress(OSError):  # nobody is there
            self.socket.send(word)

    def shutdown(self) -> None:
        super().shutdown()
        if self.channel_info != "waits":
            self._say(LEAVES)
        self.socket.close()
