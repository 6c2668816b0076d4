"""Optional parts of a bench session: the recorder of a SocketCAN link, and a foreign controller."""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.base.own_python import own_python
from tunefree_hil.bench import Bench
from tunefree_hil.bus.open import BusChoice
from tunefree_hil.bus.recording.recorder import RecorderSetup
from tunefree_hil.bus.recording.recorder_owner import MODULE, RecorderOwner
from tunefree_hil.bus.tfhub.address import read_hub
from tunefree_hil.jobs.running.node_links import message_ids, sends_fd
from tunefree_hil.jobs.running.processes import Processes
from tunefree_hil.jobs.scenarios import write_reference_drive

if TYPE_CHECKING:
    from tunefree_hil.jobs.running.session import BenchLaunch


class CommandPlaceholders(NamedTuple):
    """Values for a foreign controller: `{field}` in its command, TUNEFREE_FIELD in its environment.

    bus, bench: `socketcan:NAME` or `tcp:127.0.0.1:PORT` (token_file then contains the hub's token). realtime: '1' or
    '0'. paths: folder with the bench's reference drives (jobs/scenarios.py), '' unless the command contains {paths}.
    """

    vehicle: str
    bus: str
    bench: str
    token_file: str
    session: str
    realtime: str
    paths: str = ""

    def fill(self, words: Sequence[str]) -> list[str]:
        """The command with its placeholders filled in."""
        filled = []
        for word in words:
            for name, value in self._asdict().items():
                word = word.replace(f"{{{name}}}", value)
            filled.append(word)
        return filled

    def environment(self) -> dict[str, str]:
        """The same values as environment variables."""
        return {f"TUNEFREE_{name.upper()}": value for name, value in self._asdict().items()}


def make_placeholders(choice: BusChoice, session: str, vehicle: Path, realtime: bool) -> CommandPlaceholders:
    """Addresses of a bench's channels for a foreign program. Raises BenchError where the hub is missing."""
    hub: Mapping[str, str] = {}
    token_file = ""
    if uses_hub(choice):
        info = read_hub(session)
        hub, token_file = info.addresses, info.token_file
    bus, bench = (
        text if text.startswith("socketcan:") else hub[channel]
        for channel, text in (("vehicle", choice.vehicle_address), ("bench", choice.bench_address))
    )
    return CommandPlaceholders(str(vehicle), bus, bench, token_file, session, "1" if realtime else "0")


def write_reference_paths(command: Sequence[str], bench: Bench, folder: Path) -> str:
    """Write the reference drives of all scenarios where the command contains {paths}. Returns the folder, or ''."""
    if not any("{paths}" in word for word in command):
        return ""
    for scenario in bench.scenarios.values():
        write_reference_drive(bench.course(scenario), scenario.hash, folder)
    return str(folder.resolve())


def uses_hub(choice: BusChoice) -> bool:
    """Whether either channel runs over a hub."""
    return choice.vehicle_address.startswith("tfhub:") or choice.bench_address.startswith("tfhub:")


def socketcan_links(choice: BusChoice) -> list[str]:
    """Names of the SocketCAN links of a bench."""
    texts = (choice.vehicle_address, choice.bench_address)
    return [text.partition(":")[2] for text in texts if text.startswith("socketcan:")]


def start_recorder(
    processes: Processes, choice: BusChoice, bench: Bench, launch: BenchLaunch, patience_s: float
) -> RecorderOwner:
    """Start a recorder of both channels. Raises BenchError where it does not start."""
    reports, commands = message_ids(bench)
    setup = RecorderSetup(
        vehicle=choice.vehicle_address,
        bench=choice.bench_address,
        ids=(sorted(reports), sorted(commands)),
        tick_ns=0 if launch.realtime else round(bench.dt_s * 1e9),
        fd=sends_fd(bench),
    )
    own_end, recorder_end = socket.socketpair()
    with recorder_end:
        command = own_python(MODULE, str(recorder_end.fileno()), launch.session)
        processes.run("recorder", command, pass_fds=(recorder_end.fileno(),))
    try:
        return RecorderOwner(own_end, setup, patience_s)
    except BaseException:
        own_end.close()
        raise
