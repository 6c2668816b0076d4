"""A command that goes on is read by the shell and the command line as exactly what was asked, whatever was asked."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tunefree_hil.base.events import Event
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.collect import collect
from tunefree_hil.jobs.command_text import option_arguments, shell_command
from tunefree_hil.jobs.commission import plan
from tunefree_hil.jobs.gap import report_text as gap_words
from tunefree_hil.jobs.gap.options import GapDriveOptions
from tunefree_hil.jobs.gap.options import GapOptions as Gap
from tunefree_hil.jobs.learn import learn
from tunefree_hil.jobs.learn.learn import KINDS
from tunefree_hil.jobs.learn.options import LearnOptions as Learn
from tunefree_hil.jobs.options.records import CollectOptions as Collect
from tunefree_hil.jobs.options.records import CommissionOptions as Commission
from tunefree_hil.jobs.options.records import TuneOptions as Tune
from tunefree_hil.jobs.tune import options

NAMES = st.text("ab /.'\"$*\\;&é", min_size=1, max_size=8).map(lambda text: f"x{text}")
PATHS = NAMES.map(Path)
NUMBERS = st.floats(1e-3, 1e6)
SEEDS = st.integers(0, 9999)


def perhaps(some: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | some


BUSES = {"bus": st.sampled_from(["auto", "tfhub", "socketcan:vcan1"]), "bench_bus": st.just("") | NAMES}
COLLECT = st.builds(
    Collect, bench=perhaps(PATHS), vehicle=perhaps(NAMES), model=perhaps(NAMES), **BUSES, session=st.just("") | NAMES,
    realtime=st.booleans(), out=PATHS, quota_s=st.just(10.0) | NUMBERS, area_m=st.just(400.0) | NUMBERS,
    top_mps=perhaps(NUMBERS), seed=SEEDS, drive_s=st.just(110.0) | NUMBERS,
)  # fmt: skip
LEARN = st.builds(
    Learn, logs=st.lists(PATHS, min_size=1, max_size=3), vehicle=NAMES, out=PATHS, kind=st.sampled_from(KINDS),
    seed=SEEDS, minutes=perhaps(st.floats(0.01, 1e3)), physics=perhaps(PATHS),
    sample_spacing_s=st.just(0.01) | st.floats(0.01, 0.5),
)  # fmt: skip
COMMISSION = st.builds(
    Commission, vehicle=NAMES, bench=perhaps(PATHS), out=perhaps(PATHS), set_name=perhaps(NAMES),
    trials=perhaps(st.integers(1, 99)), kind=NAMES, quota_s=NUMBERS, area_m=NUMBERS, minutes=perhaps(NUMBERS),
    seed=SEEDS, **BUSES, backend=st.sampled_from(["bus", "batch"]), top_mps=perhaps(NUMBERS),
    only=st.just(""), start_at=st.just(""), least_covered=st.just(0.8) | NUMBERS, most_error_m=NUMBERS,
    most_outside=NUMBERS,
)  # fmt: skip
TUNE = st.builds(
    Tune, bench=PATHS, trials=perhaps(st.integers(1, 99)), set_name=perhaps(st.sampled_from(["mrac", "complete"])),
    sampler=perhaps(NAMES), seed=perhaps(SEEDS), scale=perhaps(st.sampled_from(["log", "linear"])), **BUSES,
    join=st.booleans(), session=NAMES, out=perhaps(PATHS), resume=perhaps(PATHS), verify=perhaps(st.booleans()),
    study=perhaps(NAMES), backend=st.sampled_from(["bus", "batch"]), benches=st.integers(0, 4),
    in_flight=st.integers(0, 9), realtime=st.booleans(), controller=st.just("") | NAMES,
    confirm=perhaps(st.integers(1, 9)), objectives=perhaps(st.sampled_from(["score", "tracking,comfort"])),
)  # fmt: skip
GAP = st.builds(
    Gap, logs=st.lists(PATHS, min_size=1, max_size=3), vehicle=NAMES, model=NAMES, out=PATHS,
    older=st.lists(PATHS, max_size=2), until=st.sampled_from(["locate", "name", "repair", "verify"]),
    workers=st.integers(1, 8),
)  # fmt: skip

ALL = {
    "collect": (COLLECT, collect.resume_command),
    "learn": (LEARN, learn.build_command),
    "commission": (COMMISSION, plan.format_command),
    "tune": (TUNE, lambda asked: options.format_command(asked, asked.study or "")),
    "gap": (GAP, gap_words.build_command),
}
JOBS = {
    "collect": "collect.collect.collect",
    "learn": "learn.learn.learn",
    "commission": "commission.commission.commission",
    "tune": "tune.tune.tune",
    "gap": "gap.gap.run_gap",
}


def read_back(command: str, job: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, ...]:
    """What the job is called with where a shell is given the command."""
    heard: list[tuple[Any, ...]] = []

    def stand_in(*arguments: Any) -> list[Event]:
        heard.append(arguments)
        return [Event("result", "", {"sentence": "fine"})]

    monkeypatch.setattr(f"tunefree_hil.jobs.{job}", stand_in)
    program, *words = shlex.split(command)
    assert program == "tunefree-hil" and run(words) == 0, command
    return heard[0]


@pytest.mark.parametrize("name", ALL)
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_command_is_read_back_as_what_was_asked(name: str, data: st.DataObject) -> None:
    some, again = ALL[name]
    asked = data.draw(some)
    with pytest.MonkeyPatch.context() as monkeypatch:
        (heard,) = read_back(again(asked), JOBS[name], monkeypatch)
    if name == "tune":
        heard, asked = options.fill_defaults(heard), options.fill_defaults(asked)  # what is usual need not be said
    assert heard._replace(**plain(heard)) == asked._replace(**plain(asked))


def plain(asked: Any) -> dict[str, Any]:
    """Sequences are compared by what is in them."""
    return {name: list(value) for name, value in asked._asdict().items() if isinstance(value, list | tuple)}


@pytest.mark.parametrize(
    ("again", "asked", "words"),
    [
        (collect.resume_command, Collect(Path("b.toml"), out=Path("runs/x")), "collect b.toml --out runs/x"),
        (learn.build_command, Learn([Path("a.log")], "mkz", Path("m")), "learn a.log --vehicle mkz --out m"),
        (plan.format_command, Commission("mkz", only="learn", start_at="map"), "commission mkz"),
        (gap_words.build_command, Gap([Path("a.log")], "v", "m", Path("o")), "gap a.log --vehicle v --model m --out o"),
    ],
)
def test_what_is_as_usual_is_not_said(again: Callable[[Any], str], asked: Any, words: str) -> None:
    assert again(asked) == f"tunefree-hil {words}"


def test_a_collection_goes_on_over_the_bus_that_it_began_on(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Collect(
        Path("my bench.toml"), bus="socketcan:vcan0", bench_bus="socketcan:vcan1", session="two", out=Path("run 1")
    )
    command = collect.resume_command(asked)
    assert "--bench-bus socketcan:vcan1" in command and "--session two" in command and "'run 1'" in command
    assert read_back(command, "collect.collect.collect", monkeypatch) == (asked,)


def test_a_gap_with_drives_is_read_back(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, drives = Gap([Path("a b.log")], "v", "m", Path("o")), GapDriveOptions(Path("my bench.toml"), "virtual")
    command = gap_words.build_command(asked, drive=drives)
    assert read_back(command, "gap.drive.run_gap_with_drives", monkeypatch) == (asked, drives)


def test_options() -> None:
    assert option_arguments(a=None, b=False, c=True, d_e=[1, 2], f=0.1, g="x y") == [
        *("--c", "--d-e", "1", "--d-e", "2", "--f", "0.1", "--g", "x y")
    ]
    assert shell_command("log check", Path("a b"), None, s=10.0) == "tunefree-hil log check 'a b' --s 10"
    assert shell_command("x", s=0.1 + 0.2) == "tunefree-hil x --s 0.30000000000000004"
