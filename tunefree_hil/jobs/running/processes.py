"""Starts the bench's processes, notices when one dies, ends them all. They also end when the hub is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import BenchError, InputError, PeerGone
from tunefree_hil.base.own_python import own_python

TAIL_LINES = 12
END_S = 3.0
LOOK_S = 0.01
ONLY_ASK = 0  # a signal that nobody feels
LOST = 3  # exit status of a node that ends because of the others (interfaces 1)
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
STARTER_VARIABLE = "TUNEFREE_STARTER"  # process id of whoever started a node and will end it


def starter_is_gone() -> bool:
    """Whether this process was started by `Processes` whose own process is gone."""
    starter = os.environ.get(STARTER_VARIABLE, "")
    return bool(starter) and os.getppid() != int(starter)


def _how_late(status: int) -> int:
    """Place of an exit status in a chain of ends: killed, failed, left without a word, lost the others."""
    if status < 0:
        return 0
    return {0: 2, LOST: 3}.get(status, 1)


class _Child(NamedTuple):
    name: str
    process: subprocess.Popen[bytes]
    words: Path
    said_before: int  # bytes in `words` when it was started


class Processes:
    """The nodes of one bench. What each says goes to `folder/<name>.txt`. core: the one they share, None for any."""

    def __init__(self, folder: Path, core: int | None = None) -> None:
        self.folder = folder
        self.core = core
        self.children: list[_Child] = []
        folder.mkdir(parents=True, exist_ok=True)

    def start(self, name: str, arguments: Sequence[str], environment: dict[str, str] | None = None) -> int:
        """Start `tunefree-hil ARGUMENTS`; its process id."""
        return self.run(name, own_python("tunefree_hil", *arguments), environment)

    def run(
        self,
        name: str,
        command: Sequence[str],
        environment: dict[str, str] | None = None,
        pass_fds: Sequence[int] = (),
    ) -> int:
        """Start any command as a node; its process id. In a session of its own, so Ctrl-C reaches only us.

        Raises InputError for a command that is not there.
        """
        own = {**ONE_THREAD, STARTER_VARIABLE: str(os.getpid())}
        words = self.folder / f"{name}.txt"
        said_before = words.stat().st_size if words.exists() else 0
        try:
            with words.open("ab") as file:
                process = subprocess.Popen(
                    list(command),
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    env={**os.environ, **own, **(environment or {})},
                    start_new_session=True,
                    pass_fds=pass_fds,
                )
        except (FileNotFoundError, PermissionError) as error:
            raise InputError(
                f"the {name} {command[0]} does not start: {error.strerror}",
                code="no_command",
                hint="build it first, or give its path",
            ) from error
        if self.core is not None:
            os.sched_setaffinity(process.pid, {self.core})
        self.children.append(_Child(name, process, words, said_before))
        return process.pid

    def check(self) -> None:
        """Raise PeerGone that quotes the last words of a process that has ended."""
        if any(child.process.poll() is not None for child in self.children):
            raise self.explain(BenchError("a process of the bench has ended", code="node_lost"))

    def _gone(self, child: _Child, status: int) -> BenchError:
        text = child.words.read_bytes()[child.said_before :].decode(errors="replace")
        said = text.strip().splitlines()[-TAIL_LINES:]
        how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
        tail = "\n    ".join(said) or "(it said nothing)"
        return PeerGone(
            child.name,
            f"the {child.name} process {how}; its last words:\n    {tail}",
            code="node_lost",
            hint=f"all it said: {child.words}",
        )

    def explain(self, error: BenchError) -> BenchError:
        """The better of two reports of one loss: that of the process which ended first, as far as its status shows."""
        time.sleep(0.2)
        ended = [(child, status) for child in self.children if (status := child.process.poll()) is not None]
        return self._gone(*min(ended, key=lambda one: _how_late(one[1]))) if ended else error

    def memory_mb(self) -> dict[str, float]:
        """Largest resident size so far of each living process."""
        sizes = {}
        for child in self.children:
            status = Path(f"/proc/{child.process.pid}/status")
            if status.exists():
                lines = [line for line in status.read_text().splitlines() if line.startswith("VmHWM")]
                if lines:
                    sizes[child.name] = float(lines[0].split()[1]) / 1024.0
        return sizes

    def stop(self) -> None:
        """End all, and what they started themselves: ask, wait, kill."""
        for child in self.children:
            _signal(child, signal.SIGTERM)
            _signal(child, signal.SIGCONT)  # one that is stopped would not hear it
        limit = time.monotonic() + END_S
        for child in self.children:
            while _signal(child, ONLY_ASK) and time.monotonic() < limit:
                time.sleep(LOOK_S)
            _signal(child, signal.SIGKILL)
            child.process.wait()
        self.children.clear()


def _signal(child: _Child, number: int) -> bool:
    """Whether the child, or what it started and left behind (a shell its program), was there to be signalled."""
    pid = child.process.pid  # of the group too: each child has a session of its own
    if child.process.poll() is not None and _exists(pid):
        return False  # a group keeps its number from being given away: nobody is left, and this is a stranger
    try:
        os.killpg(pid, number)
    except ProcessLookupError:
        return False
    return True


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, ONLY_ASK)
    except OSError as error:
        return isinstance(error, PermissionError)  # somebody else's
    return True
