"""Which bus a bench of processes may use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tests.bus.tfhub_help import thread_hub
from tests.jobs.command import (
    Ended,
    eventually,
    finish,
    new_session,
    no_orphans,
    one_message,
    processes_of,
    start,
    tunefree,
)
from tests.nodes.memory import FakeLink
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus import open as bus_open
from tunefree_hil.bus.socketcan.kernel_link import KernelLinkState
from tunefree_hil.jobs.running import node_links
from tunefree_hil.jobs.running.node_links import (
    NodeLink,
    message_ids,
    open_exchange,
    require_unique_node,
    resolve_process_bus,
    resolve_vehicle_bus,
    send_patience_s,
)


def links(monkeypatch: pytest.MonkeyPatch, **states: KernelLinkState) -> None:
    monkeypatch.setattr(bus_open, "kernel_has_can", lambda: True)
    monkeypatch.setattr(bus_open, "link_state", lambda name: states.get(name, KernelLinkState(False, False, "")))


def test_auto_takes_vcan0_where_it_is_up_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    links(monkeypatch, vcan0=KernelLinkState(True, True, "vcan"))
    choice = resolve_process_bus("auto", "default", "")
    assert choice.kind == "socketcan" and "vcan0, because it is up" in choice.why
    links(monkeypatch)
    assert resolve_process_bus("auto", "default", "").kind == "tfhub"


def test_auto_leaves_a_link_alone_that_carries_another_bench(monkeypatch: pytest.MonkeyPatch) -> None:
    links(monkeypatch, vcan0=KernelLinkState(True, True, "vcan"))
    monkeypatch.setattr(bus_open, "holder", lambda name: 4711)
    choice = resolve_process_bus("auto", "default", "")
    assert choice.kind == "tfhub" and "vcan0 carries another bench, pid 4711" in choice.why


def test_one_process_buses_cannot_join_processes() -> None:
    with pytest.raises(InputError, match="inside one process only"):
        resolve_process_bus("virtual", "default", "")


def test_the_bench_channel_never_shares_the_vehicles_link(monkeypatch: pytest.MonkeyPatch) -> None:
    links(monkeypatch, vcan0=KernelLinkState(True, True, "vcan"), vcan1=KernelLinkState(True, True, "vcan"))
    with pytest.raises(InputError, match="never shares it") as caught:
        resolve_process_bus("socketcan:vcan0", "s", "socketcan:vcan0")
    assert caught.value.key == "--bench-bus"
    choice = resolve_process_bus("socketcan:vcan0", "s", "socketcan:vcan1")
    assert (choice.vehicle_address, choice.bench_address) == ("socketcan:vcan0", "socketcan:vcan1")
    assert "vcan1" in choice.why and "tfhub" not in choice.why


def test_a_classic_link_is_refused_for_an_fd_vehicle_only(monkeypatch: pytest.MonkeyPatch) -> None:
    links(monkeypatch, vcan0=KernelLinkState(True, True, "vcan", mtu=16))
    bench = load("bench_configs/mkz_steer.toml")
    assert resolve_vehicle_bus(bench, "socketcan:vcan0", "s", "").kind == "socketcan"
    monkeypatch.setattr(node_links, "sends_fd", lambda bench: True)
    with pytest.raises(InputError, match=r"vcan0 is a classic CAN link \(mtu 16\)") as caught:
        resolve_vehicle_bus(bench, "socketcan:vcan0", "s", "")
    assert caught.value.code == "classic_link"
    assert "ip link set vcan0 mtu 72" in caught.value.hint


def test_ids_of_the_phases_have_nothing_in_common() -> None:
    reports, commands = message_ids(load("bench_configs/mkz_steer.toml"))
    assert reports and commands and not reports & commands


def test_a_late_command_is_worse_than_none() -> None:
    assert send_patience_s("ecu", 0.01, realtime=True) == 0.005
    assert send_patience_s("controller", 0.01, realtime=True) == 0.0
    assert send_patience_s("controller", 0.01, realtime=False) == 5.0


@pytest.mark.parametrize("realtime", [True, False])
def test_a_hub_of_the_other_kind_of_bench_is_refused_by_name(tmp_path: Path, realtime: bool) -> None:
    """Else its stamps are taken for times that they are not."""
    right, wrong = ("real", "sender") if realtime else ("sender", "real")
    bench = load("bench_configs/mkz_steer.toml")
    with thread_hub(tmp_path, clock=wrong) as hub:
        link = NodeLink("tfhub", "", hub.session, realtime)
        with pytest.raises(InputError) as caught, open_exchange(bench, "ecu", link):
            pass
        assert caught.value.code == "hub_clock"
        assert f"hub --session {hub.session} --clock {right}" in caught.value.hint
        with hub.member("ecu"):  # it has left: its name is free
            pass
        with open_exchange(bench, "ecu", link._replace(realtime=not realtime)):
            pass


@pytest.mark.slow
@pytest.mark.parametrize(("hub_words", "drive_words"), [(("--clock", "real"), ()), ((), ("--realtime",))])
def test_a_drive_that_joins_a_hub_of_the_other_kind_says_so_at_once(
    tmp_path: Path, hub_words: tuple[str, ...], drive_words: tuple[str, ...]
) -> None:
    session, bench = new_session(), write_bench(tmp_path)
    with no_orphans(session):
        hub = start("hub", "--session", session, "--owned", *hub_words)
        eventually(lambda: processes_of(session))
        words = ("--join", "--session", session, "--bus", "tfhub", *drive_words)
        done = eventually(
            lambda: _unless_no_hub(tunefree("drive", bench, *words, "--out", tmp_path / "runs", "--json"))
        )
        finish(hub)
    assert done.status == 2
    one_message(done, "stamps frames", f"hub --session {session} --clock")


def _unless_no_hub(done: Ended) -> Ended | None:
    return None if [error["code"] for error in done.errors] == ["no_hub"] else done


@pytest.mark.parametrize(("who", "refused"), [(bc.Role.CONTROLLER, True), (bc.Role.ECU, False)])
def test_a_second_node_of_a_name_is_refused_without_a_hub(who: bc.Role, refused: bool) -> None:
    link: Any = FakeLink()
    link.arrive(*bc.hello_frames(who, "somebody", []))
    if refused:
        with pytest.raises(InputError, match="controller is on the bus already") as caught:
            require_unique_node(link, "controller", 0.05)
        assert caught.value.code == "duplicate_name"
    else:
        require_unique_node(link, "controller", 0.05)
    asked = [bc.decode(frame) for frame in link.frames()]
    assert all(isinstance(one, bc.Hello) and one.role == bc.Role.RUNNER for one in asked)
