"""Starts a hub as a process of its own, and owns it: for measures and tests (a bench starts `tunefree-hil hub`)."""

from __future__ import annotations

import os
import subprocess
import tempfile
from typing import BinaryIO, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.own_python import own_python
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.address import DEFAULT_TRANSPORT, Transport
from tunefree_hil.bus.tfhub.owner import Owner

READY = b"ready"
END_S = 5.0


class HubProcess(NamedTuple):
    """A hub that runs for us. `vehicle`, `bench`: addresses for HubBus and open_link."""

    process: subprocess.Popen[bytes]
    owner: Owner
    session: str
    words: BinaryIO  # its stderr

    @property
    def vehicle(self) -> str:
        """Address of the vehicle channel."""
        return address.endpoint(self.session, "vehicle")

    @property
    def bench(self) -> str:
        """Address of the bench channel."""
        return address.endpoint(self.session, "bench")

    def messages(self) -> str:
        """Its output so far: losses, refusals, connections it dropped."""
        self.words.seek(0)
        return self.words.read().decode(errors="replace")

    def close(self) -> None:
        """End it. BenchError when it does not end."""
        self.owner.close()
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(END_S)
            raise BenchError(f"hub {self.session} did not end when its owner went", code="hub_stuck") from None
        finally:
            self.words.close()

    def __enter__(self) -> HubProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def start_hub(
    session: str,
    *,
    clock: str = "real",
    transport: Transport = DEFAULT_TRANSPORT,
) -> HubProcess:
    """A hub in its own process with us as owner. InputError when one runs in that session, BenchError when it fails."""
    command = own_python("tunefree_hil.bus.tfhub", "--session", session, "--clock", clock, "--say-ready")
    command += ["--tcp"] if transport == "tcp" else []
    words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process; a pipe could fill and block it
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=words)
    try:
        _wait_until_ready(process, words)
        return HubProcess(process, Owner(session, name=f"owner-{os.getpid()}"), session, words)
    except BaseException:
        process.kill()
        process.wait(END_S)
        words.close()
        raise


def _wait_until_ready(process: subprocess.Popen[bytes], words: BinaryIO) -> None:
    """Read the line that the hub writes when it listens; its stderr becomes the error when it ends instead."""
    assert process.stdout is not None
    with process.stdout as stdout:
        if stdout.readline().strip() == READY:
            return
    status = process.wait(END_S)
    words.seek(0)
    message = words.read().decode(errors="replace").strip() or f"exit status {status}"
    kind = InputError if status == InputError.exit_status else BenchError
    raise kind(f"the hub could not be started: {message}", code="hub_failed")
