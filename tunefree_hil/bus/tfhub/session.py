"""A hub's directory: claimed once, mode 0700, holding the sockets (or the token) and `hub.json`; removed at the end."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import socket
import stat
from pathlib import Path

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub.address import HUB_FILE, TOKEN_FILE, HubInfo, read_hub, session_dir
from tunefree_hil.bus.tfhub.records import CHANNELS, ENDPOINTS, small_buffers

LONGEST_PATH = 103  # bytes in sun_path without the final 0, on the system that has least (macOS)
BACKLOG = 32


class Session:
    """The claim of one running hub on its directory.

    `listeners`: channel -> listening socket. InputError when a hub runs there already, when the directory is not
    private, or when its path is too long for a socket.
    """

    def __init__(self, session: str, transport: str, clock: str) -> None:
        self.folder = session_dir(session)
        self.session = session
        self.made_folder = _make_private(self.folder)
        self._lock_fd = self._lock()
        self.listeners: dict[str, socket.socket] = {}
        self.token = secrets.token_hex(32) if transport == "tcp" else ""
        try:
            for channel in CHANNELS:
                self.listeners[channel] = self._listen(channel, transport)
            for name in (HUB_FILE, TOKEN_FILE):  # of a hub that was killed
                (self.folder / name).unlink(missing_ok=True)
            self.info = self._describe(transport, clock)
        except BaseException:
            self._let_go()
            raise
        self._write(HUB_FILE, json.dumps(self.info._asdict(), indent=1) + "\n")

    def close(self) -> None:
        """Stop listening and remove what was made."""
        for channel, listener in self.listeners.items():
            listener.close()
            (self.folder / ENDPOINTS[channel]).unlink(missing_ok=True)
        for name in (HUB_FILE, TOKEN_FILE):
            (self.folder / name).unlink(missing_ok=True)
        self._let_go()

    def _let_go(self) -> None:
        for listener in self.listeners.values():
            listener.close()
        if self.made_folder:
            with contextlib.suppress(OSError):  # it holds other files: then it stays
                self.folder.rmdir()
        if self._lock_fd >= 0:
            os.close(self._lock_fd)

    def _lock(self) -> int:
        """Hold the directory itself for the life of this process; -1 where the system has no flock."""
        try:
            import fcntl
        except ImportError:
            return -1
        fd = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(fd)
            raise self._taken() from None
        return fd

    def _taken(self) -> InputError:
        pid = "unknown"
        with contextlib.suppress(BenchError):  # it is starting and has not written its file yet
            pid = str(read_hub(self.session).pid)
        return InputError(
            f"a hub named {self.session} already runs here, pid {pid}",
            code="hub_runs",
            file=str(self.folder),
            key="--session",
            hint=f"join it with --join --session {self.session}, or choose another name: --session OTHER",
        )

    def _listen(self, channel: str, transport: str) -> socket.socket:
        if transport == "tcp":
            listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            small_buffers(listener)
            listener.bind(("127.0.0.1", 0))
        else:
            listener = self._bind_unix(self.folder / ENDPOINTS[channel])
        listener.listen(BACKLOG)
        listener.setblocking(False)
        return listener

    def _bind_unix(self, path: Path) -> socket.socket:
        """A bound socket at `path`; a file that a killed hub left there is replaced."""
        if not hasattr(socket, "AF_UNIX"):
            raise InputError("this system has no unix sockets", key="--tcp", hint="start the hub with --tcp")
        if len(os.fsencode(path)) > LONGEST_PATH:
            raise InputError(
                f"{path} is too long for a socket ({LONGEST_PATH} bytes)",
                key="--session",
                hint="choose a shorter directory, a plain session name, or --tcp",
            )
        if path.exists() and _answers(path):
            raise self._taken()
        path.unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(path))
        return listener

    def _describe(self, transport: str, clock: str) -> HubInfo:
        token_file = ""
        addresses = {channel: f"unix:{self.folder / ENDPOINTS[channel]}" for channel in CHANNELS}
        if transport == "tcp":
            token_file = str(self.folder / TOKEN_FILE)
            self._write(TOKEN_FILE, self.token + "\n")
            addresses = {name: f"tcp:127.0.0.1:{self.listeners[name].getsockname()[1]}" for name in CHANNELS}
        return HubInfo(self.session, os.getpid(), clock, addresses, token_file)

    def _write(self, name: str, text: str) -> None:
        """A file of mode 0600 that appears only when it is complete."""
        part = self.folder / f"{name}.part"
        part.unlink(missing_ok=True)
        fd = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(fd, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(part, self.folder / name)


def _make_private(folder: Path) -> bool:
    """True when the directory was made here; InputError when it is there and others may enter it."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700)
        return True
    except FileExistsError:
        pass
    except OSError as error:
        raise InputError(f"cannot be made: {error}", file=str(folder), key="--session") from error
    status = folder.lstat()
    mine = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    open_to_others = hasattr(os, "getuid") and stat.S_IMODE(status.st_mode) & 0o077
    if not stat.S_ISDIR(status.st_mode) or not mine or open_to_others:
        raise InputError(
            "is not a directory of yours alone (mode 0700)",
            code="not_private",
            file=str(folder),
            key="--session",
            hint=f"chmod 700 {folder}, or name a directory that is not there yet",
        )
    return False


def _answers(path: Path) -> bool:
    """True when a process listens on a unix socket; a file left by a killed hub refuses."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except TimeoutError:
            return True
        except OSError:
            return False
        return True
