"""What a controller of the user's own is told, and a bench that runs with one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import new_session, no_orphans
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bus.open import BusChoice
from tunefree_hil.jobs.running import session_parts as bench_parts
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.session_parts import CommandPlaceholders, make_placeholders, socketcan_links, uses_hub

BOTH = BusChoice("socketcan", "socketcan:vcan0", "socketcan:vcan1", "")
HALF = BusChoice("socketcan", "socketcan:vcan0", "tfhub:s/bench", "")
HUB = BusChoice("tfhub", "tfhub:s/veh", "tfhub:s/bench", "")


def test_placeholders_are_filled_wherever_they_stand() -> None:
    places = CommandPlaceholders("dbc/mkz", "socketcan:vcan0", "tcp:127.0.0.1:7", "t", "s", "0")
    words = ["./controller", "{bus}", "--bench={bench}", "{token_file}{token_file}", "{}", "{other}"]
    assert places.fill(words) == ["./controller", "socketcan:vcan0", "--bench=tcp:127.0.0.1:7", "tt", "{}", "{other}"]
    assert places.environment()["TUNEFREE_BUS"] == "socketcan:vcan0"


def test_which_links_and_whether_a_hub() -> None:
    assert [socketcan_links(choice) for choice in (BOTH, HALF, HUB)] == [["vcan0", "vcan1"], ["vcan0"], []]
    assert [uses_hub(choice) for choice in (BOTH, HALF, HUB)] == [False, True, True]


def test_without_a_hub_nobody_asks_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_parts, "read_hub", None)
    assert make_placeholders(BOTH, "s", Path("dbc/mkz"), True) == (
        "dbc/mkz",
        "socketcan:vcan0",
        "socketcan:vcan1",
        "",
        "s",
        "1",
        "",
    )


@pytest.mark.slow
def test_another_command_takes_the_controllers_place(tmp_path: Path) -> None:
    """Our own controller, started as if it were somebody else's, drives the same frames; its addresses are TCP."""
    bench = load(write_bench(tmp_path, duration_s=0.5))
    own = "import os, sys; open(sys.argv[1], 'w').write(' '.join(sys.argv[2:])); "
    own += "os.execv(sys.executable, [sys.executable, '-m', 'tunefree_hil', 'controller', os.environ['BENCH_FILE'],"
    own += " '--session', os.environ['TUNEFREE_SESSION'], '--bus', 'tfhub'])"
    command = [sys.executable, "-c", own, str(tmp_path / "told"), "{vehicle}", "{bus}", "{bench}", "{token_file}"]
    session = new_session()
    with pytest.MonkeyPatch.context() as patch, no_orphans(session):
        patch.setenv("BENCH_FILE", str(tmp_path / "b.toml"))
        words = tmp_path / "words"
        with BenchSession(
            tmp_path / "b.toml", words, BenchLaunch(session=session, bus="tfhub", controller_command=command)
        ) as one:
            outcome = one.drive(bench.scenarios["tiny"], 3, parameters_of(bench), tmp_path)
    assert (outcome.ticks, outcome.error) == (50, "")
    vehicle, bus, channel, token_file = (tmp_path / "told").read_text().split()
    assert (Path(vehicle) / "vehicle.toml").is_file()
    assert bus.startswith("tcp:127.0.0.1:") and channel.startswith("tcp:127.0.0.1:") and bus != channel
    assert token_file.endswith("token")


@pytest.mark.slow
def test_a_command_that_is_not_there_is_the_users(tmp_path: Path) -> None:
    file = write_bench(tmp_path)
    session = new_session()
    with no_orphans(session):
        one = BenchSession(
            file, tmp_path / "w", BenchLaunch(session=session, bus="tfhub", controller_command=["./no_such_controller"])
        )
        with pytest.raises(InputError, match=r"cannot start the controller \./no_such_controller"), one:
            pass
