"""Start a hub as a process of its own, and own it."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from typing import BinaryIO, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.records import LOG_NAMES

START_S = 20.0  # patience with a slow machine; a hub that fails is noticed at once
END_S = 5.0


class HubProcess(NamedTuple):
    """A hub that runs for us. `vehicle`, `bench`: what HubBus and open_link take as address."""

    process: subprocess.Popen[bytes]
    owner: Owner
    session: str
    words: BinaryIO  # what it says on stderr

    @property
    def vehicle(self) -> str:
        """Address of the vehicle channel."""
        return address.endpoint(self.session, "vehicle")

    @property
    def bench(self) -> str:
        """Address of the bench channel."""
        return address.endpoint(self.session, "bench")

    def said(self) -> str:
        """What it has told a person so far: losses, refusals, connections it dropped."""
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
    session: str, *, clock: str = "real", transport: str = "unix", vehicle_log_name: str = LOG_NAMES["vehicle"]
) -> HubProcess:
    """A hub in its own process with us as owner. InputError when one runs in that session, BenchError when it fails."""
    command = [sys.executable, "-m", "tunefree_hil.bus.tfhub", "--session", session, "--clock", clock]
    command += ["--vehicle-log-name", vehicle_log_name] + (["--tcp"] if transport == "tcp" else [])
    words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process; a pipe could fill and block it
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=words)
    try:
        return HubProcess(process, _own(process, session), session, words)
    except BenchError as error:
        process.kill()
        status = process.wait(END_S)
        words.seek(0)
        said = words.read().decode(errors="replace").strip()
        words.close()
        kind = InputError if status == InputError.exit_status else BenchError
        raise kind(f"the hub could not be started: {said or error}", code="hub_failed", key="--session") from None


def _own(process: subprocess.Popen[bytes], session: str) -> Owner:
    """Wait for our own hub, not for another one that may run in the session."""
    waited_s = 0.0
    while waited_s < START_S:
        if process.poll() is not None:
            break
        try:
            owner = Owner(session, name=f"owner-{process.pid}", wait_s=0.05)
        except BenchError as error:
            if error.code != "no_hub":
                raise
            waited_s += 0.05
            continue
        except InputError:  # another hub with its owner: ours is about to say so and end
            process.wait(END_S)
            break
        if owner.pid == process.pid:
            return owner
        owner.close()
    raise BenchError(f"no hub came up in session {session}", code="no_hub")
