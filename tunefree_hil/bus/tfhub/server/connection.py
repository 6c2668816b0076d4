"""A peer's side of a connection to a hub: hello, bytes out, records in. Used by `plugin.py` and `owner.py`."""

from __future__ import annotations

import select
import socket
import threading
import time
from typing import Any

from tunefree_hil.bus.tfhub.address import Address
from tunefree_hil.bus.tfhub.handshake import join
from tunefree_hil.bus.tfhub.records import BYE, CLASSIC, HEAD, pack_control

GOODBYE_S = 0.5
READ_BYTES = 1 << 16


class ConnectionGone(Exception):
    """The hub is gone; the text says why. Callers turn it into their own errors."""


class Connection:
    """One socket to a hub, after the hello. `buffer[position:]` holds received records that are not taken yet.

    One thread may send while another receives. InputError or BenchError from the constructor give the reason of a
    failure.
    """

    def __init__(self, address: Address, hello: dict[str, Any], name: str = "") -> None:
        self.address = address
        self.buffer = bytearray()
        self.position = 0
        self.gone = ""  # why the hub is gone
        self.careful = False  # never keep a whole record in the buffer: callers wait on fileno()
        self._unsent = b""
        self.reading = threading.Lock()  # taken to change `buffer` or `position`
        self._sending = threading.Lock()
        self.sock, self.welcome = join(address, hello, name)
        self.sock.setblocking(False)

    def __str__(self) -> str:
        return f"hub {self.welcome.session} (pid {self.welcome.pid}) at {self.address}"

    # --- out -----------------------------------------------------------------------------------------------------

    def send(self, data: bytes, timeout_s: float | None) -> bool:
        """Write whole records; False when the hub did not take all of them in time (the rest of a record is kept).

        Meanwhile the records of the hub are read, so that two full sides cannot wait for each other.
        """
        with self._sending:
            if self.gone:
                raise ConnectionGone(self.gone)
            if self._unsent:
                data, self._unsent = self._unsent + data, b""
            try:
                sent = self.sock.send(data)
            except BlockingIOError:
                sent = 0
            except OSError as error:
                raise self._lost(error) from None
            if sent == len(data):
                return True
            return self._send_rest(data, sent, timeout_s)

    def _send_rest(self, data: bytes, sent: int, timeout_s: float | None) -> bool:
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        view = memoryview(data)
        while sent < len(data):
            rest_s = None if deadline_s is None else deadline_s - time.monotonic()
            if rest_s is not None and rest_s <= 0.0:
                self._unsent = data[sent : _end_of_record(data, sent)]
                return False
            readable, writable, _ = select.select(
                [self.sock], [self.sock], [], 0.1 if rest_s is None else min(rest_s, 0.1)
            )
            if readable and self.reading.acquire(blocking=False):
                try:
                    self._read(READ_BYTES)
                finally:
                    self.reading.release()
            if writable:
                try:
                    sent += self.sock.send(view[sent : sent + READ_BYTES])
                except BlockingIOError:
                    continue
                except OSError as error:
                    raise self._lost(error) from None
        return True

    # --- in ------------------------------------------------------------------------------------------------------

    def fill(self, timeout_s: float | None) -> bool:
        """Wait up to timeout_s (None: for ever) until at least one whole record is in the buffer; True when one is."""
        if self.whole_record():
            return True
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            rest_s = None if deadline_s is None else max(0.0, deadline_s - time.monotonic())
            if select.select([self.sock], [], [], rest_s)[0]:
                with self.reading:
                    self._read(self._wanted() if self.careful else READ_BYTES)
            if self.whole_record():
                return True
            if rest_s == 0.0:
                return False

    def fresh(self, timeout_s: float) -> bytes:
        """Bytes straight from the socket, for a reader that takes all of them; b'' when records wait in the buffer.

        Waits up to timeout_s. It returns other records with `put_back`.
        """
        if self.buffer or self.careful or self.gone or not select.select([self.sock], [], [], timeout_s)[0]:
            return b""
        with self.reading:
            return b"" if self.buffer else self._receive(READ_BYTES)

    def put_back(self, data: bytes) -> None:
        """Return bytes to the beginning of the buffer."""
        with self.reading:
            self.buffer[:0] = data

    def whole_record(self) -> int:
        """The size of the record at `position` when all of it is there, else 0. ConnectionGone after the last one."""
        have = len(self.buffer) - self.position
        if have >= HEAD.size:
            size = self.buffer[self.position] | self.buffer[self.position + 1] << 8
            if size <= have:
                return size
        if self.gone:
            raise ConnectionGone(self.gone)
        return 0

    def kind(self) -> int:
        """The type of the record at `position`."""
        return self.buffer[self.position + 2]

    def take(self) -> bytes:
        """Take out the record at `position`."""
        with self.reading:
            size = self.buffer[self.position] | self.buffer[self.position + 1] << 8
            record = bytes(self.buffer[self.position : self.position + size])
            self.skip(size)
        return record

    def skip(self, size: int) -> None:
        """Take `size` bytes out; the caller holds `reading`."""
        self.position += size
        if self.position == len(self.buffer):
            self.buffer.clear()
            self.position = 0

    def _wanted(self) -> int:
        """Bytes to read so that no whole record is left behind in the buffer."""
        have = len(self.buffer) - self.position
        if have < HEAD.size:
            return CLASSIC.size - have
        return (self.buffer[self.position] | self.buffer[self.position + 1] << 8) - have

    def _read(self, most: int) -> None:
        """One read into the buffer."""
        if not self.gone:
            self.buffer += self._receive(most)

    def _receive(self, most: int) -> bytes:
        """One read; sets `gone` when the peer has closed."""
        try:
            data = self.sock.recv(most)
        except BlockingIOError:
            return b""
        except OSError as error:
            self.gone = error.strerror or "connection lost"
            return b""
        if not data:
            self.gone = self.gone or "its connection closed"
        return data

    # --- beginning and end ---------------------------------------------------------------------------------------

    def close(self) -> None:
        """Send BYE and wait a moment for the hub to close its side, so that nothing sent before is lost."""
        if self.sock.fileno() < 0:
            return
        try:
            self.send(pack_control(BYE), GOODBYE_S)
            self.sock.shutdown(socket.SHUT_WR)
            self.sock.settimeout(GOODBYE_S)
            while self.sock.recv(READ_BYTES):
                pass
        except (OSError, ConnectionGone):  # it closed first
            pass
        finally:
            self.sock.close()

    def _lost(self, error: OSError) -> ConnectionGone:
        """The reason of a failed write: the hub's last message when there is one, else the error."""
        self.gone = self.gone or error.strerror or "connection lost"
        return ConnectionGone(self.gone)


def _end_of_record(data: bytes, sent: int) -> int:
    """Where the record ends whose bytes are partly sent; `sent` when none is."""
    offset = 0
    while offset < sent:
        offset += data[offset] | data[offset + 1] << 8
    return offset
