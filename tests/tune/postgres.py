"""A PostgreSQL server of Debian's package in a folder of its own, on the loopback, which a test may stop and start."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

USER, PASSWORD = "tuner", "not-to-be-printed"
OWNER = "postgres"  # the package's own account: the server refuses to run as root


def binaries() -> Path | None:
    """The folder of initdb and pg_ctl, None where the package is not installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    on_path = shutil.which("initdb")
    return found[-1].parent if found else Path(on_path).resolve().parent if on_path else None


def needs_server(timeout_s: float) -> list[pytest.MarkDecorator]:
    """The marks of tests that want a server; where driver or package is missing they are skipped, and say so."""
    driver = "the driver is not installed: pip install 'tunefree_hil[postgres]'"
    return [
        pytest.mark.postgres,
        pytest.mark.timeout(timeout_s),
        pytest.mark.skipif(find_spec("psycopg") is None, reason=driver),
        pytest.mark.skipif(binaries() is None, reason="no PostgreSQL server: apt-get install postgresql"),
    ]


@contextlib.contextmanager
def running() -> Iterator[Server]:
    """A server that runs, and is gone afterwards."""
    programs = binaries()
    assert programs is not None
    made = Server(programs)
    try:
        made.start()
        yield made
    finally:
        made.remove()


class Server:
    """Made with initdb; `start` and `stop` as often as a test likes; `remove` in the end."""

    def __init__(self, programs: Path) -> None:
        self.programs = programs
        self.folder = Path(tempfile.mkdtemp(prefix="tunefree-pg-"))
        self.data = self.folder / "data"
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._as = OWNER if os.geteuid() == 0 else None
        (self.folder / "password").write_text(PASSWORD)
        if self._as:
            shutil.chown(self.folder, self._as)
            shutil.chown(self.folder / "password", self._as)
        self._run("initdb", "--no-sync", "-U", USER, "-A", "scram-sha-256", f"--pwfile={self.folder / 'password'}")

    def start(self) -> None:
        """Start it and wait until it listens."""
        options = f"-h 127.0.0.1 -p {self.port} -k {self.folder} -c fsync=off -c shared_buffers=16MB"
        self._run("pg_ctl", "start", "-w", "-t", "30", "-l", str(self.folder / "log"), "-o", options)

    def stop(self) -> None:
        """Stop it at once, as a crash would: connections break."""
        self._run("pg_ctl", "stop", "-w", "-t", "30", "-m", "immediate")

    def remove(self) -> None:
        """Stop what runs, take away the folder."""
        if (self.data / "postmaster.pid").exists():
            self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def url(self, study: str, password: str = PASSWORD) -> str:
        """The address of a study on it."""
        return f"postgresql://{USER}:{password}@127.0.0.1:{self.port}/postgres#{study}"

    def _run(self, program: str, *words: str) -> None:
        done = subprocess.run(
            [str(self.programs / program), "-D", str(self.data), *words],
            user=self._as,
            cwd=self.folder,
            env={**os.environ, "LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # a pipe would stay open as long as the server lives
            stderr=subprocess.PIPE if program == "initdb" else subprocess.DEVNULL,
            text=True,
            timeout=90,
            check=False,
        )
        if done.returncode:
            log = self.folder / "log"
            said = log.read_text(errors="replace")[-2000:] if log.exists() else ""
            raise RuntimeError(f"{program} ended with {done.returncode}: {done.stderr} {said}")
