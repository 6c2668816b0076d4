"""What a session starts beside hub, ECU and our controller: the recorder of a SocketCAN link, a foreign controller."""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.own_python import own_python
from tunefree_hil.bench import Bench
from tunefree_hil.bus.open import BusChoice
from tunefree_hil.bus.recording.recorder import Setup
from tunefree_hil.bus.recording.recorder_owner import MODULE, RecorderOwner
from tunefree_hil.bus.tfhub.address import read_hub
from tunefree_hil.jobs.running.node_links import ids_of, sends_fd
from tunefree_hil.jobs.running.processes import Processes
from tunefree_hil.jobs.scenarios import write_drive


class Places(NamedTuple):
    """What a controller of the user's own needs to know: `{field}` in its command, TUNEFREE_FIELD in its environment.

    bus, bench: `socketcan:NAME` or `tcp:127.0.0.1:PORT` (then token_file holds the hub's token). realtime: '1' or '0'.
    paths: folder with the bench's reference drives (jobs/scenarios.py), '' unless the command asks for it.
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
        """The same for whoever prefers it."""
        return {f"TUNEFREE_{name.upper()}": value for name, value in self._asdict().items()}


def places_of(choice: BusChoice, session: str, vehicle: Path, realtime: bool) -> Places:
    """Where a bench's channels are, as a program of any language opens them. BenchError where its hub is not there."""
    hub: Mapping[str, str] = {}
    token_file = ""
    if uses_hub(choice):
        info = read_hub(session)
        hub, token_file = info.addresses, info.token_file
    bus, bench = (
        text if text.startswith("socketcan:") else hub[channel]
        for channel, text in (("vehicle", choice.vehicle_address), ("bench", choice.bench_address))
    )
    return Places(str(vehicle), bus, bench, token_file, session, "1" if realtime else "0")


def paths_for(command: Sequence[str], bench: Bench, folder: Path) -> str:
    """`folder` with the reference drives of all the bench's scenarios, where the command asks for {paths}; else ''."""
    if not any("{paths}" in word for word in command):
        return ""
    for scenario in bench.scenarios.values():
        write_drive(bench.course(scenario), scenario.hash, folder)
    return str(folder.resolve())


def uses_hub(choice: BusChoice) -> bool:
    """Whether either channel runs over a hub of ours."""
    return choice.vehicle_address.startswith("tfhub:") or choice.bench_address.startswith("tfhub:")


def links_of(choice: BusChoice) -> list[str]:
    """Names of the SocketCAN links that a bench takes."""
    texts = (choice.vehicle_address, choice.bench_address)
    return [text.partition(":")[2] for text in texts if text.startswith("socketcan:")]


def start_recorder(
    processes: Processes, choice: BusChoice, bench: Bench, session: str, *, realtime: bool, patience_s: float
) -> RecorderOwner:
    """A recorder of both channels as a process of this bench. BenchError where it does not come up."""
    reports, commands = ids_of(bench)
    setup = Setup(
        vehicle=choice.vehicle_address,
        bench=choice.bench_address,
        ids=(sorted(reports), sorted(commands)),
        tick_ns=0 if realtime else round(bench.dt_s * 1e9),
        fd=sends_fd(bench),
    )
    ours, theirs = socket.socketpair()
    with theirs:
        command = own_python(MODULE, str(theirs.fileno()), session)
        processes.run("recorder", command, pass_fds=(theirs.fileno(),))
    try:
        return RecorderOwner(ours, setup, patience_s)
    except BaseException:
        ours.close()
        raise
