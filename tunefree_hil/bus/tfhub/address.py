"""Addresses of hubs as text: `unix:PATH`, `tcp:127.0.0.1:PORT`, or `SESSION/veh` and `SESSION/bench`.

SESSION is a name, or a directory, which holds the sockets and `hub.json`. Options may follow as in a URL, because stock
tools cannot pass keywords everywhere: `default/veh?role=member&name=player`. Only loopback addresses are accepted.
"""

from __future__ import annotations

import ipaddress
import json
import os
import socket
import tempfile
from pathlib import Path
from typing import Literal, NamedTuple
from urllib.parse import parse_qsl

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub.records import CHANNELS, ENDPOINTS

Transport = Literal["unix", "tcp"]
HUB_FILE = "hub.json"
DEFAULT_TRANSPORT: Transport = "unix" if hasattr(socket, "AF_UNIX") else "tcp"
TOKEN_FILE = "token"
OPTIONS = ("role", "name", "token_file", "listen", "echo", "stamps")


class Address(NamedTuple):
    """An address: a unix path, or host and port with the file that holds the token."""

    path: str = ""
    host: str = ""
    port: int = 0
    token_file: str = ""

    def __str__(self) -> str:
        return f"unix:{self.path}" if self.path else f"tcp:{self.host}:{self.port}"


class HubInfo(NamedTuple):
    """A running hub by its `hub.json`. `addresses`: channel -> address text."""

    session: str
    pid: int
    clock: str
    addresses: dict[str, str]
    token_file: str = ""


def user_id() -> str:
    """The user's part of the name of a session directory."""
    return str(os.getuid()) if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")


def runtime_dir() -> Path:
    """The folder of sessions without a path of their own."""
    return Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())


def session_dir(session: str) -> Path:
    """The directory of a session: the given one when `session` is a path, else tfhub-<user>-<name>."""
    if not session:
        raise InputError("a session needs a name or a directory", key="--session")
    if os.sep in session or "/" in session or session in (".", ".."):
        return Path(session).absolute()
    return runtime_dir() / f"tfhub-{user_id()}-{session.removeprefix('tfhub-')}"


def split_options(text: str) -> tuple[str, dict[str, str]]:
    """The address and its `?key=value&...` options. InputError names an unknown option."""
    address, _, query = text.partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    for key in options:
        if key not in OPTIONS:
            raise InputError(f"unknown option {key!r} in {text!r}", key="channel", hint=f"known: {', '.join(OPTIONS)}")
    return address, options


def loopback(host: str) -> str:
    """`host` as an IPv4 loopback address; InputError for every other address (docs/reference/design.md)."""
    literal = "127.0.0.1" if host in ("", "localhost") else host
    try:
        allowed = ipaddress.IPv4Address(literal).is_loopback
    except ValueError:
        allowed = False
    if not allowed:
        raise InputError(
            f"{host!r} is not a loopback address: a hub never leaves its machine",
            code="not_loopback",
            hint="use tcp:127.0.0.1:PORT, or unix:PATH",
        )
    return literal


def parse(text: str, token_file: str = "") -> Address:
    """The address that `text` (without options) names; a session is looked up in its hub.json.

    InputError for no address or one that is not loopback, BenchError where no hub runs in the session.
    """
    if text.startswith("unix:"):
        return Address(path=text.removeprefix("unix:").removeprefix("//"))
    if text.startswith("tcp:"):
        host, _, port = text.removeprefix("tcp:").removeprefix("//").rpartition(":")
        if not port.isdigit() or not 0 < int(port) < 65536:
            raise InputError(f"{text!r} has no port", key="channel", hint="tcp:127.0.0.1:PORT")
        return Address(host=loopback(host), port=int(port), token_file=token_file or _token_of_port(int(port)))
    session, _, endpoint = text.rpartition("/")
    channel = {"veh": "vehicle", "vehicle": "vehicle", "bench": "bench"}.get(endpoint)
    if not session or channel is None:
        raise InputError(
            f"{text!r} is no address of a hub",
            key="channel",
            hint="SESSION/veh, SESSION/bench, unix:PATH or tcp:127.0.0.1:PORT",
        )
    info = read_hub(session)
    return parse(info.addresses[channel], token_file or info.token_file)


def endpoint(session: str, channel: str) -> str:
    """The address of a channel of a session, whether or not its hub runs already: 'DIR/veh'."""
    if channel not in CHANNELS:
        raise InputError(f"no channel {channel!r}", key="channel", hint=f"one of {', '.join(CHANNELS)}")
    return f"{session_dir(session)}/{ENDPOINTS[channel]}"


def read_hub(session: str) -> HubInfo:
    """The hub that runs in a session. BenchError where none runs."""
    file = session_dir(session) / HUB_FILE
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return HubInfo(**content)
    except FileNotFoundError:
        raise BenchError(
            f"no hub runs in session {session!r}",
            code="no_hub",
            file=str(file),
            hint=f"start one: tunefree-hil hub --session {session}",
        ) from None
    except (ValueError, TypeError, OSError) as error:
        raise BenchError(f"cannot be read: {error}", code="no_hub", file=str(file)) from error


def running_hubs() -> list[HubInfo]:
    """The hubs of this user in the default folder, as their hub.json say (one may have been killed since)."""
    hubs = []
    for file in sorted(runtime_dir().glob(f"tfhub-{user_id()}-*/{HUB_FILE}")):
        try:
            hubs.append(read_hub(str(file.parent)))
        except BenchError:  # a file of another user or of another version: not ours to list
            continue
    return hubs


def _token_of_port(port: int) -> str:
    """The token file of the hub of this user that listens on `port`; '' when none is known."""
    for info in running_hubs():
        if any(address.endswith(f":{port}") for address in info.addresses.values()):
            return info.token_file
    return ""
