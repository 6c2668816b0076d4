"""A [[faults]] table is refused for each thing that it says wrongly, by its key."""

from __future__ import annotations

from typing import Any

import pytest

from tunefree_hil.config.fault_check import COUNTER_KINDS, CRC_KINDS, FAULT_KINDS, check_faults
from tunefree_hil.config.schema import FaultSpec

GOOD: dict[str, dict[str, Any]] = {
    **{kind: {"message": "M"} for kind in FAULT_KINDS},
    "driver_override": {"channel": "brake", "value": 0.4},
    "peer_stop": {"channel": "ecu"},
    **{kind: {"message": "M", "value": 1.0} for kind in ("delay", "corrupt", "crc_value", "crc_offset")},
    **{kind: {"message": "M", "value": 1.0} for kind in ("counter_value", "counter_offset", "burst")},
}


def spec(kind: str, **changes: Any) -> FaultSpec:
    return FaultSpec(**{"kind": kind, "from_tick": 10, "to_tick": 20, **GOOD.get(kind, {}), **changes})


def test_every_kind_can_be_scripted() -> None:
    assert list(check_faults([spec(kind) for kind in FAULT_KINDS])) == []
    assert len(CRC_KINDS) == len(COUNTER_KINDS) == 4 and len(FAULT_KINDS) == 16


@pytest.mark.parametrize(
    ("kind", "changes", "key", "words"),
    [
        ("lose", {}, "kind", "no fault kind 'lose'"),
        ("drop", {"from_tick": 20}, "", "from_tick 20, to_tick 20"),
        ("drop", {"from_tick": -1}, "", "from_tick -1"),
        ("drop", {"seed": 65536}, "seed", "does not fit"),
        ("drop", {"message": ""}, "message", "needs it"),
        ("drop", {"channel": "brake"}, "channel", "has no messages"),
        ("drop", {"value": 2.0}, "value", "has no value"),
        ("delay", {"value": 0.0}, "value", "ticks"),
        ("delay", {"value": 1.5}, "value", "ticks"),
        ("corrupt", {"value": 0.0}, "value", "bits"),
        ("crc_value", {"value": 256.0}, "value", "CRC"),
        ("crc_offset", {"value": 0.0}, "value", "CRC"),
        ("counter_offset", {"value": 0.0}, "value", "counter"),
        ("burst", {"value": 201.0}, "value", "copies"),
        ("peer_stop", {"channel": "brake"}, "channel", "no peer"),
        ("peer_stop", {"message": "M"}, "message", "no message"),
        ("driver_override", {"channel": "clutch"}, "channel", "a driver has no"),
        ("driver_override", {"message": "M"}, "message", "no message"),
    ],
)
def test_a_mistake_is_said_by_its_key(kind: str, changes: dict[str, Any], key: str, words: str) -> None:
    found = list(check_faults([spec("drop"), spec(kind, **changes)]))
    assert [one[0] for one in found] == ["faults[1]" + (f".{key}" if key else "")]
    assert words in found[0][1] and found[0][2]


def test_no_more_faults_than_the_bus_can_number() -> None:
    assert list(check_faults([spec("drop")] * 255)) == []
    assert [key for key, _, _ in check_faults([spec("drop")] * 256)] == ["faults"]


def test_all_mistakes_at_once() -> None:
    found = {key for key, _, _ in check_faults([spec("drop", message="", seed=-1), spec("burst", value=0.0)])}
    assert found == {"faults[0].message", "faults[0].seed", "faults[1].value"}
