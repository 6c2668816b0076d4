"""Connecting to a hub with HELLO; errors for a missing hub or a refusal."""

from __future__ import annotations

import os
import socket
import struct
import sys
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub.address import Address
from tunefree_hil.bus.tfhub.records import (
    END,
    HEAD,
    HELLO,
    PROTOCOL,
    REFUSED,
    WELCOME,
    RecordError,
    body_of,
    pack_control,
    small_buffers,
)

ANSWER_S = 5.0  # how long a hub may take for an answer
USER_MISTAKES = ("duplicate_name", "wrong_token", "owned", "protocol")


class Welcome(NamedTuple):
    """The hub's data of itself and of this peer."""

    protocol: int
    index: int
    name: str
    channel: str
    log_name: str
    session: str
    pid: int
    clock: str
    epoch_offset_ns: int


def default_name() -> str:
    """<program>-<pid>."""
    return f"{Path(sys.argv[0]).stem or 'python'}-{os.getpid()}"


def join(address: Address, hello: dict[str, Any], name: str = "") -> tuple[socket.socket, Welcome]:
    """A connected socket and the hub's answer to our hello. A given name must be free, a default one gets a number.

    InputError or BenchError give the reason of a failure; nothing beyond the welcome has been read from the socket.
    """
    body = {"protocol": PROTOCOL, "name": name or default_name(), "fixed_name": bool(name), "pid": os.getpid()}
    sock = _connect(address)
    try:
        sock.sendall(pack_control(HELLO, {**body, **hello, "token": _token(address)}))
        head = _read(sock, HEAD.size)
        size, kind = struct.unpack_from("<HB", head)
        answer = body_of(head + _read(sock, max(0, size - HEAD.size)))
        if kind in (REFUSED, END):
            raise _refused(address, answer)
        if kind != WELCOME:
            raise RecordError("it does not answer a hello")
        welcome = Welcome(**answer)
    except (InputError, BenchError):
        sock.close()
        raise
    except (RecordError, TypeError) as error:
        sock.close()
        raise BenchError(f"what listens at {address} is no hub: {error}", code="no_hub") from error
    except OSError as error:
        sock.close()
        raise BenchError(f"the hub at {address} gave no answer: {error}", code="no_hub") from error
    return sock, welcome


def _read(sock: socket.socket, size: int) -> bytes:
    """Exactly `size` bytes. OSError when they do not come."""
    data = b""
    while len(data) < size:
        more = sock.recv(size - len(data))
        if not more:
            raise ConnectionError("it closed the connection")
        data += more
    return data


def _refused(address: Address, body: dict[str, Any]) -> InputError | BenchError:
    code, message = str(body.get("code", "")), str(body.get("message") or body.get("why"))
    kind = InputError if code in USER_MISTAKES else BenchError
    return kind(f"the hub at {address} refused: {message}", code=code, hint=str(body.get("hint", "")))


def _connect(address: Address) -> socket.socket:
    if address.path and not hasattr(socket, "AF_UNIX"):
        raise InputError("this system has no unix sockets", key="channel", hint="start the hub with --tcp")
    family = socket.AF_UNIX if address.path else socket.AF_INET
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        if not address.path:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            small_buffers(sock)
        sock.settimeout(ANSWER_S)
        sock.connect(address.path or (address.host, address.port))
    except OSError as error:
        sock.close()
        raise BenchError(
            f"no hub listens at {address}: {error.strerror or error}",
            code="no_hub",
            hint="start one (tunefree-hil hub), or name the session or address of one that runs",
        ) from None
    return sock


def _token(address: Address) -> str:
    """The token for a TCP hub; '' where none is needed or known (the hub then refuses)."""
    if address.path or not address.token_file:
        return ""
    try:
        return Path(address.token_file).read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the token cannot be read: {error}", file=address.token_file, key="token_file") from error
