"""The links of this folder's tests, and programs of can-utils beside our bench."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.house import ROOT
from tunefree_hil.episode.candump import LogFrame, read_candump

HERE = Path(__file__).resolve().parent
PATIENCE_S = 1200.0
QUEUE_BYTES = 16 << 20  # candump's own queue of 208 kB loses frames at the speed of lockstep
SETTLE_S = 1.0
LISTENERS = Path("/proc/net/can/rcvlist_all")  # a line for each socket without filters


# The C controller of tools/: what it drives, and how it is started.
SCENARIO = "turn_3s"
PROGRAM = "{program} {{bus}} {{bench}} {{paths}} {{token_file}}"


class Links(NamedTuple):
    """Names of two vcan links that are up and carry CAN FD."""

    vehicle: str = "vcan0"
    bench: str = "vcan1"

    def addresses(self) -> list[str]:
        """For a command: both channels on links of the kernel, no hub."""
        return ["--bus", f"socketcan:{self.vehicle}", "--bench-bus", f"socketcan:{self.bench}"]


def ip(*words: str) -> None:
    """One command of iproute2; an AssertionError with what it said when it fails."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@contextmanager
def program(words: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A program that runs for the time of a `with`."""
    process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


class Candump:
    """`candump -L` of one link into a file, from now on until `frames` is asked for."""

    def __init__(self, link: str, file: Path) -> None:
        self.file = file
        before = _listeners(link)
        words = ["candump", "-L", "-r", str(QUEUE_BYTES), link]
        with file.open("wb") as out:
            self._process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=out)
        eventually(lambda: _listeners(link) > before, "candump's socket")

    def frames(self) -> list[LogFrame]:
        """End it when nothing more comes; what it wrote."""
        size = -1
        while size != self.file.stat().st_size:
            size = self.file.stat().st_size
            time.sleep(SETTLE_S)
        self.close()
        return read_candump(self.file)

    def close(self) -> None:
        """End it."""
        self._process.send_signal(signal.SIGINT)
        self._process.wait(PATIENCE_S)


def eventually(true: Callable[[], object], what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait until something holds; an AssertionError when it never does."""
    deadline_s = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < deadline_s, f"{what} never came true"
        time.sleep(0.05)


def controller_of() -> Path | None:
    """The C controller's program in the checkout's build folder; made where it is not there yet, which takes long in a
    machine that is emulated. None where nobody compiles.
    """
    if shutil.which("cc") is None or shutil.which("make") is None:
        return None
    words = ["make", "-C", str(ROOT / "tools" / "foreign_controller"), f"PYTHON={sys.executable}"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ROOT / "build" / "foreign_controller" / "controller"


def _listeners(link: str) -> int:
    return sum(line.split()[:1] == [link] for line in LISTENERS.read_text().splitlines())
