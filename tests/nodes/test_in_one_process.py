"""ECU, controller and runner as threads over buses in memory: whole episodes, and the same frames as real processes."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import hash_of, write_bench
from tests.jobs.command import tunefree
from tests.nodes.memory import MemoryBus
from tunefree_hil.base.clock import RealClock
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, ControllerFor, VehicleFor, load, needed_messages, parameters_of
from tunefree_hil.bus.link import separate_links
from tunefree_hil.bus.tfhub.owner import HubStats
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.episode.candump import LogFrame
from tunefree_hil.episode.frame_hash import frame_hash
from tunefree_hil.nodes.controller import ControllerPart
from tunefree_hil.nodes.ecu import EcuPart
from tunefree_hil.nodes.exchange import Exchange, can_key
from tunefree_hil.nodes.node import Announcement, Node, Part
from tunefree_hil.nodes.runner import Outcome, Runner
from tunefree_hil.nodes.timing import CycleTimes


class InOneProcess:
    """A bench of threads. `errors`: what ended a node, by name."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.vehicle, self.channel = MemoryBus(), MemoryBus()
        self.errors: dict[str, BaseException] = {}
        self.words: list[str] = []
        codec, quiet = bench.codec, CycleTimes()
        ecu = EcuPart(codec, VehicleFor(bench, bench.spec.model), quiet, self.words.append)
        controller = ControllerPart(
            codec, needed_messages(codec), ControllerFor(bench), CycleTimes(), self.words.append
        )
        self.runner = Runner(self.channel.link("runner"), self)  # type: ignore[arg-type]
        self.threads = [self._node("ecu", ecu), self._node("controller", controller)]

    def _node(self, name: str, part: Part) -> threading.Thread:
        codec = self.bench.codec
        ids = (frozenset(m.key for m in codec.telemetry), frozenset(m.key for m in codec.commands))
        exchange = Exchange(separate_links(self.vehicle.link(name), self.channel.link(name)), ids, self.bench.dt_s)

        def serve() -> None:
            try:
                Node(part, exchange, Announcement(name), RealClock()).serve()
            except Exception as error:
                self.errors[name] = error

        return threading.Thread(target=serve, daemon=True)

    # what the runner asks of a hub's owner

    def start_log(self, paths: Mapping[str, Path]) -> None:
        self.vehicle.log.clear()

    def stop_log(self) -> dict[str, int]:
        return {"vehicle": len(self.vehicle.log)}

    def stats(self) -> HubStats:
        return HubStats({"vehicle": len(self.channel.log)})

    def drive(self, scenario: bytes, seed: int, values: Mapping[str, float]) -> tuple[Outcome, str]:
        """(how it ended, frame hash)."""
        outcome = self.runner.drive(scenario, seed, [values[name] for name in NAMES], {})
        codec = self.bench.codec
        log = [LogFrame(one.time_s, "can0", can_key(one), one.data) for one in self.vehicle.log]
        return outcome, frame_hash(log, self.bench.dt_s, {m.key for m in codec.commands}, codec.by_id.keys()).hex


@contextmanager
def in_one_process(bench: Bench) -> Iterator[InOneProcess]:
    one = InOneProcess(bench)
    for thread in one.threads:
        thread.start()
    one.runner.meet(20.0)
    try:
        yield one
    finally:
        one.runner.end()
        for thread in one.threads:
            thread.join(20.0)
            assert not thread.is_alive()


@pytest.mark.slow
def test_episodes_repeat_bit_for_bit_and_depend_on_seed_and_parameters(bench: Bench, tiny: Path) -> None:
    values = parameters_of(bench)
    with in_one_process(bench) as one:
        first, hash_1 = one.drive(hash_of(tiny), 3, values)
        assert (first.ticks, first.error) == (200, "") and first.logged["vehicle"] > 2000
        _, other_seed = one.drive(hash_of(tiny), 4, values)
        _, other_gain = one.drive(hash_of(tiny), 3, {**values, "lqr.q1": 0.5})
        _, hash_2 = one.drive(hash_of(tiny), 3, values)
    assert hash_1 == hash_2
    assert len({hash_1, other_seed, other_gain}) == 3
    assert one.errors == {}


@pytest.mark.slow
def test_real_processes_send_the_same_frames(bench: Bench, tiny: Path, tmp_path: Path) -> None:
    done = tunefree("drive", tiny / "b.toml", "--out", tmp_path, "--json")
    assert done.status == 0, done.words
    data = done.data
    with in_one_process(bench) as one:
        outcome, found = one.drive(hash_of(tiny), 3, parameters_of(bench))
    assert data["hashes"]["tiny"] == found
    kept = json.loads((Path(data["run"]) / "episodes" / "0" / "episode.json").read_text())
    assert kept["ticks"] == outcome.ticks and kept["frame_hash"] == found


@pytest.mark.slow
def test_an_unknown_scenario_is_refused_by_both_with_the_files_there_are(bench: Bench) -> None:
    refused: list[Any] = []
    with in_one_process(bench) as one, pytest.raises(Exception, match="cannot load this episode: unknown_scenario"):
        one.drive(b"\0" * 6, 1, parameters_of(bench))
    refused += [one.errors["ecu"], one.errors["controller"]]
    for error in refused:
        assert isinstance(error, InputError) and error.code == "unknown_scenario"
        assert "tiny (" in error.message and "left_turn (" in error.message and "000000000000" in error.message


@pytest.mark.slow
def test_a_drive_that_leaves_its_lane_ends_at_once_and_the_next_one_is_whole(tmp_path: Path) -> None:
    write_bench(tmp_path, scenarios=("tiny", "wild"))
    wild = tmp_path / "scenarios" / "wild.toml"
    wild.write_text(wild.read_text().replace("lateral_m = 0.1", "lateral_m = 1.2, heading_rad = 0.35"))
    bench = load(tmp_path / "b.toml")
    values = parameters_of(bench)
    with in_one_process(bench) as one:
        outcome, _ = one.drive(hash_of(tmp_path, "wild"), 3, values)
        again, _ = one.drive(hash_of(tmp_path), 3, values)
    assert outcome.error == "left_lane" and 5 < outcome.ticks < 100
    assert [words for words in one.words if "left_lane" in words and f"tick {outcome.ticks - 1}" in words]
    assert (again.error, again.ticks) == ("", 200)
