"""Which bus a bench of processes may use."""

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.open import BusChoice
from tunefree_hil.jobs import node_links
from tunefree_hil.jobs.node_links import require_recorder, usable_bus

VCAN = BusChoice("socketcan", "socketcan:vcan0", "tfhub:default/bench", "SocketCAN vcan0, because it is up")


def test_auto_takes_the_hub_where_vcan0_is_up_and_says_why(monkeypatch):
    real = node_links.resolve_bus
    monkeypatch.setattr(node_links, "resolve_bus", lambda bus, *more: VCAN if bus == "auto" else real(bus, *more))
    choice = usable_bus("auto", "default", "")
    assert choice.kind == "tfhub" and "vcan0 is up" in choice.why
    require_recorder(choice)


def test_socketcan_is_not_recorded_from_yet():
    with pytest.raises(InputError, match="cannot be recorded from socketcan yet") as caught:
        require_recorder(VCAN)
    assert caught.value.key == "--bus" and caught.value.code == "not_built"


def test_one_process_buses_cannot_join_processes():
    with pytest.raises(InputError, match="does not leave a process"):
        usable_bus("virtual", "default", "")
