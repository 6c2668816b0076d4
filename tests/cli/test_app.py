"""Every command hands its options to its job by the agreed names; what is wrong with them ends with status 2."""

from __future__ import annotations

import importlib
import inspect
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tunefree_hil import __version__
from tunefree_hil.base.events import Event
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.log.options import (
    LogCheckOptions,
    LogConvertOptions,
    LogImportOptions,
    LogPlotOptions,
    LogShowOptions,
)
from tunefree_hil.jobs.options.nodes import EcuOptions, HubProcessOptions, NodeLink
from tunefree_hil.jobs.options.records import (
    DoctorOptions,
    DriveOptions,
    ReplayOptions,
    ScenariosOptions,
    TuneOptions,
    VerifyOptions,
)

Fake = Callable[..., list[tuple[Any, ...]]]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Fake:
    """Puts a job of the same signature in the place of the real one; the list of the calls it gets."""

    def plant(module: str, function: str) -> list[tuple[Any, ...]]:
        calls: list[tuple[Any, ...]] = []
        loaded = importlib.import_module(f"tunefree_hil.jobs.{module}")
        signature = inspect.signature(getattr(loaded, function))

        def job(*arguments: Any) -> Iterator[Event]:
            signature.bind(*arguments)
            calls.append(arguments)
            yield Event("result", "", {"sentence": "fine"})

        monkeypatch.setattr(loaded, function, job)
        return calls

    return plant


BENCH = Path("b.toml")


@pytest.mark.parametrize(
    ("words", "module", "arguments"),
    [
        ("drive b.toml", "drive", (DriveOptions(BENCH),)),
        (
            "drive b.toml --scenario s --parameter a=1 --parameter b=2 --realtime --join --out runs --seed 3",
            "drive",
            (
                DriveOptions(
                    BENCH,
                    scenario=["s"],
                    parameters=["a=1", "b=2"],
                    realtime=True,
                    join=True,
                    seed=3,
                    session="default",
                    out=Path("runs"),
                ),
            ),
        ),
        ("tune b.toml", "tune.tune", (TuneOptions(BENCH),)),
        (
            "tune b.toml --trials 5 --set lateral --scale linear --no-verify --sampler random --study x --realtime",
            "tune.tune",
            (
                TuneOptions(
                    BENCH,
                    trials=5,
                    set_name="lateral",
                    scale="linear",
                    verify=False,
                    sampler="random",
                    study="x",
                    realtime=True,
                ),
            ),
        ),
        (
            "tune b.toml --backend batch --confirm 5 --in-flight 4 --benches 2 --seed 9 --join --controller ./c",
            "tune.tune",
            (
                TuneOptions(
                    BENCH,
                    backend="batch",
                    confirm=5,
                    in_flight=4,
                    benches=2,
                    seed=9,
                    join=True,
                    session="default",
                    controller="./c",
                ),
            ),
        ),
        ("tune --resume runs/x", "tune.tune", (TuneOptions(resume=Path("runs/x")),)),
        ("verify runs/x --bus tfhub", "tune.verify", (VerifyOptions(Path("runs/x"), bus="tfhub"),)),
        ("replay runs/x --episode 3 --verify", "replay", (ReplayOptions(Path("runs/x"), 3, True),)),
        ("hub --clock real --owned", "hub", (HubProcessOptions(clock="real", owned=True),)),
        ("ecu b.toml --model m --realtime", "ecu", (BENCH, EcuOptions("m"), NodeLink(realtime=True))),
        ("controller b.toml --session s", "controller", (BENCH, NodeLink(session="s"))),
        ("doctor --vehicle dbc/x", "doctor", (DoctorOptions(Path("dbc/x")),)),
        ("doctor --bench b.toml --bus tfhub", "doctor", (DoctorOptions(bench=BENCH, bus="tfhub"),)),
        ("scenarios left_turn --vehicle mkz", "scenarios", (ScenariosOptions("left_turn", "mkz"),)),
        (
            "scenarios --roads families:2 --seed 3 --out r --export e",
            "scenarios",
            (ScenariosOptions(roads="families:2", seed=3, out=Path("r"), export=Path("e")),),
        ),
    ],
)
def test_options_reach_the_job(words: str, module: str, arguments: tuple[Any, ...], fake: Fake) -> None:
    calls = fake(module, module.rpartition(".")[2])
    assert run(words.split()) == 0
    assert calls == [arguments]


LOG = Path("a.log")


@pytest.mark.parametrize(
    ("words", "module", "function", "options"),
    [
        ("check a.log --vehicle mkz", "check", "check", LogCheckOptions(LOG, "mkz")),
        ("show a.log --signal PO --signal speed_mps", "show", "show", LogShowOptions(LOG, signals=["PO", "speed_mps"])),
        ("show a.log", "show", "show", LogShowOptions(LOG)),
        ("plot a.log PO --out a.png", "plot", "plot", LogPlotOptions(LOG, ["PO"], out=Path("a.png"))),
        (
            "convert a.log b.bag --channel can1 --format ros1",
            "convert",
            "convert",
            LogConvertOptions(LOG, Path("b.bag"), ["can1"], "ros1"),
        ),
        (
            "import a.csv --map m.toml --out d",
            "csv_import",
            "import_csv",
            LogImportOptions(Path("a.csv"), Path("m.toml"), Path("d")),
        ),
    ],
)
def test_log_commands(words: str, module: str, function: str, options: Any, fake: Fake) -> None:
    calls = fake(f"log.{module}", function)
    assert run(["log", *words.split()]) == 0
    assert calls == [(options,)]


def test_without_a_command_the_four_jobs(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2:6]] == ["drive", "learn", "tune", "gap"]
    assert all(len(line) <= 80 for line in lines)
    assert "--help" in lines[-1]


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"tunefree-hil {__version__}\n"


@pytest.mark.parametrize(
    "words",
    [
        "drive",
        "nonsense",
        "drive b.toml --nonsense",
        "tune b.toml --trials 0",
        "tune b.toml --set all",
        "log",
        "tune",
        "gap a.log --vehicle v --model m",
        "gap a.log --vehicle v --model m --out o --until all",
    ],
)
def test_usage_mistakes(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*words.split(), "--json"]) == 2
    out, err = capsys.readouterr()
    assert "Traceback" not in err and "what to do:" in err
    found = json.loads(out)
    assert (found["exit"], found["errors"][0]["code"]) == (2, "usage")


@pytest.mark.parametrize(
    "command",
    [
        *("drive", "tune", "verify", "replay", "hub", "ecu", "controller", "scenarios", "doctor"),
        *("learn", "gap", "log", "collect", "collector"),
    ],
)
def test_every_command_has_help_in_80_columns(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command, "--help"]) == 0
    assert all(len(line) <= 80 for line in capsys.readouterr().out.splitlines())


def test_tune_says_what_goes_on_and_what_resume_is_for(capsys: pytest.CaptureFixture[str]) -> None:
    """What tests/jobs/tune/test_kill.py shows."""
    assert run(["tune", "--help"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert "The same command resumes an unfinished run and starts a new one after a finished run" in words
    assert "--resume continues the given run, even a finished one" in words


def test_the_list_of_commands_cuts_no_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    assert "..." not in capsys.readouterr().out.split("Commands:")[1]


def test_starting_imports_little() -> None:
    heavy = "('rich', 'numpy', 'can', 'msgspec')"
    code = f"import tunefree_hil.cli.entry, sys; print(*[n for n in {heavy} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.strip()) == (0, "")


WAITING_JOB = """
import sys, time, types
from tunefree_hil.base.events import Event
def replay(options):
    try:
        yield Event("note", "ready", {"resume": "candump any"})
        time.sleep(60)
    finally:
        print("cleared up", file=sys.stderr)
module = types.ModuleType("tunefree_hil.jobs.replay")
module.replay = replay
sys.modules[module.__name__] = module
from tunefree_hil.cli import main
main(["replay", "x", "--json"])
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_in_order(number: signal.Signals) -> None:
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, "-c", WAITING_JOB], stdout=pipe, stderr=pipe, text=True)
    assert process.stderr is not None
    while "ready" not in process.stderr.readline():
        assert process.poll() is None
    time.sleep(0.05)
    os.kill(process.pid, number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.splitlines() == ["cleared up", "next:", "  candump any", "interrupted, state saved"]
    assert json.loads(out)["status"] == "interrupted"


STARTING = """
import os, signal, sys
class Cut:  # Ctrl-C comes while the command line's own modules are read
    def find_spec(self, name, *_):
        if name == "typer":
            os.kill(os.getpid(), signal.{})
            signal.sigtimedwait([], 5.0)
sys.meta_path.insert(0, Cut())
from tunefree_hil.cli import main
main(["--version"])
"""


def test_ctrl_c_before_a_job_is_said_once(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def cut(*_: Any, **__: Any) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("tunefree_hil.cli.options.present", cut)
    assert run(["scenarios"]) == 130
    assert capsys.readouterr().err == "interrupted\n"
    monkeypatch.undo()
    monkeypatch.setattr("tunefree_hil.jobs.scenarios.scenarios", cut)
    assert run(["scenarios"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_while_it_starts_ends_in_order(name: str) -> None:
    words = [sys.executable, "-c", STARTING.format(name)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


ENDING = """
import os, signal, sys
class Late:  # deleted with the modules, when Python has taken its own handlers away
    def __del__(self, kill=os.kill, process=os.getpid(), number=signal.{}):
        kill(process, number)
late = Late()
sys.argv = ["tunefree-hil", "--version"]
from tunefree_hil.cli import main
main()
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_after_the_end_does_not_change_the_status(name: str) -> None:
    words = [sys.executable, "-c", ENDING.format(name)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        (9999, 141),  # cut off: what it was to check may not hold
        (3, 1),  # all was said and judged, and only then was it seen that nobody reads
    ],
)
def test_a_reader_that_leaves_is_no_error_and_no_success(tmp_path: Path, lines: int, status: int) -> None:
    said = f"yield from (Event('line', 'x' * 100) for _ in range({lines})); time.sleep(0.5)"
    code = WAITING_JOB.replace("time.sleep(60)", f"{said}; yield Event('result', 'done', {{'exit': 1}})")
    code = code.replace('"--json"', '"--plain"')
    script = tmp_path / "many_lines.py"
    script.write_text(code)
    line = f"{sys.executable} {script} | head -n 0; exit ${{PIPESTATUS[0]}}"
    buffered = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60, env=buffered)
    assert done.returncode == status
    assert "Traceback" not in done.stderr and "BrokenPipe" not in done.stderr
