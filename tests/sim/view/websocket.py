"""A minimal WebSocket client (RFC 6455) for tests: unfragmented frames, as Foxglove's protocol has them."""

from __future__ import annotations

import json
import socket
import struct
from types import TracebackType
from typing import Any, Self

MASK = b"koord"[:4]


class WebSocket:
    """One connection to a server on loopback that speaks `protocol`."""

    def __init__(self, port: int, protocol: str) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=20)
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: {protocol}\r\n\r\n".encode()
        )
        self._file = self._socket.makefile("rb")
        status = self._file.readline()
        assert b" 101 " in status, status
        while self._file.readline().strip():
            pass

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        self._socket.close()

    def send(self, message: Any) -> None:
        """Send JSON."""
        data = json.dumps(message).encode()
        length = bytes([0x80 | len(data)]) if len(data) < 126 else b"\xfe" + struct.pack(">H", len(data))
        self._socket.sendall(b"\x81" + length + MASK + bytes(b ^ MASK[k % 4] for k, b in enumerate(data)))

    def receive(self) -> Any:
        """The next message: bytes, or the value of a JSON text."""
        kind, length = self._file.read(2)
        if length > 125:
            size = 2 if length == 126 else 8
            length = int.from_bytes(self._file.read(size), "big")
        data = self._file.read(length)
        return json.loads(data) if kind & 0xF == 1 else data
