"""Start the processes of a bench, detect when one ends, and stop them all."""

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
STOP_LIMIT_S = 3.0
POLL_S = 0.01
PROBE_SIGNAL = 0  # only checks that a process exists
EXIT_PEER_LOST = 3  # exit status of a node that ends because it lost another one
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
STARTER_VARIABLE = "TUNEFREE_STARTER"  # process id of the process that started a node and will end it


def starter_is_gone() -> bool:
    """Whether this process was started by `Processes` in a process that no longer exists."""
    starter = os.environ.get(STARTER_VARIABLE, "")
    return bool(starter) and os.getppid() != int(starter)


def _end_order(status: int) -> int:
    """Rank of an exit status in a chain of failures: killed, failed, ended normally, lost another node."""
    if status < 0:
        return 0
    return {0: 2, EXIT_PEER_LOST: 3}.get(status, 1)


class _ChildProcess(NamedTuple):
    name: str
    process: subprocess.Popen[bytes]
    output: Path
    output_offset: int  # size of the output file when it was started


class Processes:
    """The processes of one bench. Their output goes to `folder/<name>.txt`. core: CPU core, None for any."""

    def __init__(self, folder: Path, core: int | None = None) -> None:
        self.folder = folder
        self.core = core
        self.children: list[_ChildProcess] = []
        folder.mkdir(parents=True, exist_ok=True)

    def start(self, name: str, arguments: Sequence[str], environment: dict[str, str] | None = None) -> int:
        """Start `tunefree-hil ARGUMENTS`. Returns its process id."""
        return self.run(name, own_python("tunefree_hil", *arguments), environment)

    def run(
        self,
        name: str,
        command: Sequence[str],
        environment: dict[str, str] | None = None,
        pass_fds: Sequence[int] = (),
    ) -> int:
        """Start a command as a node, in a new process group so that Ctrl-C does not reach it. Returns its process id.

        Raises InputError for a command that does not exist.
        """
        common = {**ONE_THREAD, STARTER_VARIABLE: str(os.getpid())}
        output = self.folder / f"{name}.txt"
        output_offset = output.stat().st_size if output.exists() else 0
        try:
            with output.open("ab") as file:
                process = subprocess.Popen(
                    list(command),
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    env={**os.environ, **common, **(environment or {})},
                    start_new_session=True,
                    pass_fds=pass_fds,
                )
        except (FileNotFoundError, PermissionError) as error:
            message = f"cannot start the {name} {command[0]}: {error.strerror}"
            raise InputError(message, code="no_command", hint="build it first, or give its path") from error
        if self.core is not None:
            os.sched_setaffinity(process.pid, {self.core})
        self.children.append(_ChildProcess(name, process, output, output_offset))
        return process.pid

    def check(self) -> None:
        """Raise PeerGone with the last output of a process that has ended."""
        if any(child.process.poll() is not None for child in self.children):
            raise self.explain(BenchError("a process of the bench has ended", code="node_lost"))

    def _end_error(self, child: _ChildProcess, status: int) -> BenchError:
        text = child.output.read_bytes()[child.output_offset :].decode(errors="replace")
        lines = text.strip().splitlines()[-TAIL_LINES:]
        how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
        tail = "\n    ".join(lines) or "(no output)"
        return PeerGone(
            child.name,
            f"the {child.name} process {how}; its last output:\n    {tail}",
            code="node_lost",
            hint=f"its complete output: {child.output}",
        )

    def explain(self, error: BenchError) -> BenchError:
        """The error of the process that ended first, as far as exit statuses show; else `error`."""
        time.sleep(0.2)
        ended = [(child, status) for child in self.children if (status := child.process.poll()) is not None]
        return self._end_error(*min(ended, key=lambda one: _end_order(one[1]))) if ended else error

    def stop(self) -> None:
        """End all processes and their children: SIGTERM, wait, SIGKILL."""
        for child in self.children:
            _send_signal(child, signal.SIGTERM)
            _send_signal(child, signal.SIGCONT)  # a stopped process would not handle SIGTERM
        limit = time.monotonic() + STOP_LIMIT_S
        for child in self.children:
            while _send_signal(child, PROBE_SIGNAL) and time.monotonic() < limit:
                time.sleep(POLL_S)
            _send_signal(child, signal.SIGKILL)
            child.process.wait()
        self.children.clear()


def _send_signal(child: _ChildProcess, number: int) -> bool:
    """Signal the process group of a child. Returns whether it existed (a shell may leave its program behind)."""
    pid = child.process.pid  # also the id of the group, as each child has its own session
    if child.process.poll() is not None and _process_exists(pid):
        return False  # ids of living groups are not reused, so the group is empty and this is another process
    try:
        os.killpg(pid, number)
    except ProcessLookupError:
        return False
    return True


def _process_exists(pid: int) -> bool:
    try:
        os.kill(pid, PROBE_SIGNAL)
    except OSError as error:
        return isinstance(error, PermissionError)  # a process of another user
    return True
