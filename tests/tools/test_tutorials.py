"""Every command that README and docs give to paste is run: page by page, in a fresh copy of the checkout, in order.

A new command of a page is run as it stands, so a page with a command that does not work fails here. The tables below
are the only exceptions: what is not run, what is shortened, and what a page leaves to its reader to fill in.
"""

from __future__ import annotations

import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.house import ROOT, TEXT_FOLDERS
from tests.test_documents import PAGES, commands
from tunefree_hil.config.load import load_bench

STEER, TUNED = "bench_configs/mkz_steer.toml", "runs/*-tune-mkz_steer"

# The vehicle that `docs/how-to/vehicle.md` stands for: the shipped one which was added last, and a bench of its own.
LATER_BENCH = max((ROOT / "bench_configs").glob("*_steer.toml")).stem
LATER_VEHICLE = load_bench(ROOT / "bench_configs" / f"{LATER_BENCH}.toml").vehicle
LATER_ENVELOPE = f"bench_configs/{LATER_BENCH.removesuffix('_steer')}_envelope.toml"


class NotRun(NamedTuple):
    """Why a command is not run here, and the test which runs it elsewhere ("" where there is none)."""

    reason: str
    elsewhere: str = ""


class Shortened(NamedTuple):
    """What is run in place of a command that takes too long or needs a partner, and why."""

    command: str
    reason: str


# In the copies every bench drives this one scenario of 3 s (tests/vcan/scenarios) in place of six or seven of 20 s:
# the same commands with the same options, 40 times shorter. The van keeps its first scenario. Of made roads, two stay.
SHORT_SCENARIO = "turn_3s"

VCAN_LINKS = NotRun(
    "sudo, and a kernel with CAN", "tests/vcan/test_kernel_links.py::test_what_doctor_says_creates_the_links"
)
POSTGRES = NotRun(
    "PostgreSQL on another host", "tests/tune/test_postgres.py::test_two_workers_of_tune_one_of_them_killed"
)
NO_COMMAND = NotRun("the form of a command, no command: its parse is tested by tests/test_documents.py")
NOT_RUN = {
    "make test": NotRun("all tests: .ci/run runs it as a stage of its own"),
    "sudo apt-get install postgresql": NotRun("sudo; .ci/run installs the package, where it is missing, as root"),
    "sudo -u postgres createuser --pwprompt tuner": POSTGRES,
    "sudo -u postgres createdb --owner tuner tuning": POSTGRES,
    "tunefree-hil tune bench_configs/mkz_complete.toml --trials 800"
    " --study 'postgresql://tuner@HOST/tuning#mkz-complete'": POSTGRES,
    "sudo modprobe vcan": VCAN_LINKS,
    "sudo ip link add dev vcan0 type vcan && sudo ip link set dev vcan0 mtu 72 up": VCAN_LINKS,
    "sudo ip link add dev vcan1 type vcan && sudo ip link set dev vcan1 mtu 72 up": VCAN_LINKS,
    "candump vcan0": NotRun("needs vcan", "tests/vcan/test_drives.py::test_candump_of_our_bus_is_our_log"),
    "tunefree-hil ecu BENCH.toml --bus socketcan:vcan0 --scenario left_turn": NotRun(
        "needs vcan", "tests/vcan/test_ecu_by_hand.py::test_canplayer_drives_our_vehicle"
    ),
    "tunefree-hil tune BENCH --bus socketcan:vcan0 --bench-bus socketcan:vcan1": NotRun(
        "needs vcan", "tests/vcan/test_tune.py::test_killed_and_resumed_over_the_kernels_links_it_ends_the_same"
    ),
    "tools/vcan_vm -- ip -d link show vcan0": NotRun(
        "boots an emulated machine", "tests/tools/test_vcan_vm.py::test_a_command_in_a_kernel_with_can"
    ),
    "tools/vcan_vm -- tunefree-hil drive tests/vcan/bench.toml --scenario turn_3s --bus socketcan:vcan0": NotRun(
        "boots an emulated machine",
        "tests/vcan/test_drives.py::test_each_family_has_the_same_frames_over_hub_and_kernel",
    ),
    "tools/measure vcan": NotRun(
        "boots an emulated machine for ten minutes",
        "tests/tools/test_vcan_measure.py::test_cut_off_it_goes_on_with_what_is_missing",
    ),
    "tunefree-hil weights pairs.toml --out weights/my.toml": NotRun(
        "it needs drives of a person",
        "tests/jobs/weights/test_weights.py::test_weights_of_a_file_of_pairs_are_used_by_a_bench",
    ),
    "tunefree-hil COMMAND": NO_COMMAND,
    "tunefree-hil gap LOG... --vehicle DIR --model MODEL --out OUT [--older LOG]..."
    " [--until locate|name|repair|verify] [--workers N] [--drive --bench BENCH [--bus BUS]]": NO_COMMAND,
}

PIP = "it would install the copy in place of the checkout: pip resolves only, and every requirement must be there"
SWEEP = "--roads families:12 --cars 2 --allowed 12"
SHORTENED = {
    "tunefree-hil robustness RUN --public": Shortened(f"tunefree-hil robustness RUN {SWEEP}", "1,229 roads"),
    "tunefree-hil robustness RUN --scheduler tcp://ADDRESS:8786": Shortened(
        f"tunefree-hil robustness RUN {SWEEP} --scheduler tcp://ADDRESS:8786", "1,000 roads"
    ),
    "tunefree-hil weights --bench bench_configs/mkz_learned.toml --out weights/my.toml": Shortened(
        "tunefree-hil weights --bench bench_configs/mkz_learned.toml --out weights/my.toml --roads 4 --force",
        "40 roads take minutes; of four, held-out pairs may be ranked no better than by chance",
    ),
    "tunefree-hil tune BENCH --sampler NAME": Shortened(
        "tunefree-hil tune BENCH --sampler NAME --trials 2 --no-verify", "30 trials"
    ),
    "make tune": Shortened('make tune ARGS="--trials 8 --confirm 1"', "400 trials take minutes"),
    "tunefree-hil tune bench_configs/mkz_complete.toml --backend batch --trials 400": Shortened(
        "tunefree-hil tune bench_configs/mkz_complete.toml --backend batch --trials 40 --confirm 1 --no-verify",
        "400 trials, three of them over the bus; `make tune` of the same page verifies",
    ),
    f"tunefree-hil tune {LATER_ENVELOPE}": Shortened(
        f"tunefree-hil tune {LATER_ENVELOPE} --trials 8 --confirm 1 --no-verify",
        "400 trials; `make tune` is the same job with the other vehicle",
    ),
    "tunefree-hil commission dbc/mkz_bywire --bench bench_configs/mkz_complete.toml --out runs/commission": Shortened(
        "tunefree-hil commission dbc/mkz_bywire --bench bench_configs/mkz_complete.toml --out runs/commission"
        " --only collect --quota-s 3 --top-mps 5 --area-m 120",
        "43 minutes; tests/jobs/commission/test_kill.py goes through all six stages on a small bench",
    ),
    "tunefree-hil tune bench_configs/mkz_pursuit.toml": Shortened(
        "tunefree-hil tune bench_configs/mkz_pursuit.toml --trials 2", "40 trials"
    ),
    "tunefree-hil tune BENCH --benches 4": Shortened(
        f"tunefree-hil tune {STEER} --benches 4 --trials 2 --no-verify", "30 trials"
    ),
    "tunefree-hil drive BENCH --session S --join": Shortened(
        f"tunefree-hil controller {STEER} --session S >controller.txt 2>&1 &"
        f" tunefree-hil drive {STEER} --session S --join",
        "'your program' of the page is our controller here; tests/tools/test_foreign_controller.py joins the C program",
    ),
    "pip install -e '.[learn]'": Shortened("pip install --dry-run --no-index --no-build-isolation -e '.[learn]'", PIP),
    "pip install -e '.[postgres]'": Shortened(
        "pip install --dry-run --no-index --no-build-isolation -e '.[postgres]'", PIP
    ),
    "cantools monitor -i tfhub -c default/veh dbc/mkz_bywire/vehicle.dbc": Shortened(
        f"tunefree-hil drive {STEER} --scenario left_turn --scenario u_turn --join >drive.txt 2>&1 &"
        " cantools monitor -i tfhub -c default/veh dbc/mkz_bywire/vehicle.dbc && wait $!",
        "it looks on while `drive` runs, which has ended when the page comes to this line",
    ),
}

# Commands which go on until their reader stops them: they run while the rest of their page does.
STAYS = ("tunefree-hil hub", "tunefree-hil ecu", "tunefree-hil controller", "dask scheduler", "dask worker")
# Commands which want a terminal: what is typed there to end them, as soon as SEEN is there.
TERMINAL = {"cantools monitor": b"q"}
TERMINAL_S = 60.0  # typed by then in any case

# What a page leaves to its reader to fill in, as this test fills it in.
FILLED_IN = {
    "docs/how-to/logs.md": {"DIR": "dbc/mkz_bywire", "--format NAME": "--format blf", "PATH": "rav4_drive"},
    "docs/how-to/machines.md": {"RUN": TUNED, "ADDRESS": "127.0.0.1"},
    "docs/how-to/robustness.md": {"RUN": TUNED},
    "docs/reference/samplers.md": {"BENCH": STEER, "NAME": "trust_region"},
    "docs/how-to/own_controller.md": {"BENCH": STEER},
    "docs/how-to/vehicle.md": {
        "dbc/NAME": f"dbc/{LATER_VEHICLE}",
        "NAME_steer": LATER_BENCH,
        "LOG": f"runs/*-drive-{LATER_BENCH}/episodes/0/vehicle.log",
    },
    "docs/reference/files.md": {
        "--roads SET": "--roads families:4",
        "--vehicle NAME": "--vehicle mkz_bywire",
        "--out DIR": "--out made_roads",
        "NAME": "bench",
    },
}

RECORD = f"tunefree-hil drive {STEER} --out made && cp made/*/episodes/0/vehicle.log"
# What a page takes as given, made before its commands.
GIVEN = {
    "docs/how-to/export.md": (
        f"tunefree-hil tune {STEER} --trials 1 --no-verify --out made",
        "mkdir runs && mv made/* runs/20260101-120000-mkz_steer",
    ),
    "docs/how-to/robustness.md": (f"tunefree-hil tune {STEER} --trials 1 --no-verify",),
    "docs/how-to/logs.md": (f"{RECORD} LOG && cp LOG IN",),
    "docs/reference/grading.md": (
        f"tunefree-hil tune {STEER} --trials 1 --no-verify --out made && mkdir -p runs path/to && mv made/* runs/x",
        f"{RECORD} made/drive.log && tunefree-hil log convert made/drive.log drive.blf",
        "cp -r dbc/mkz_bywire path/to/folder && tunefree-hil scenarios --export made/csv",
        "cp made/csv/$(sha256sum bench_configs/scenarios/turn_3s.toml | head -c 12).csv reference.csv",
        f"tunefree-hil drive {STEER} --scenario u_turn --out made/before && mv made/before/* runs/before",
        "cp -r runs/before runs/after",
    ),
}

# What a page says that one sees: in the output (stdout and stderr) of a command as the page has it, and as files.
SEEN = {
    "make tune": (
        r"trial in the batch 8/8; \S+ .*at .*best \S+, manual \S+ .*s left",
        r"confirm \d+/\d+; trial .*, equal",
        r"before_after\.png",
        r"margins",
        r"\nnext:\n",
        r"On mkz_reference, unseen",
    ),
    "tunefree-hil tune bench_configs/mkz_complete.toml --backend batch --trials 400": (
        r"trial in the batch 40/40",
        r"speed\.ki_high",
        r"confirm \d+/\d+; trial .*, equal",
    ),
    "tunefree-hil explain runs/*-tune-mkz_envelope": (r"slices through the winner", r"mrac\.t_ref_s"),
    "tunefree-hil drive bench_configs/mkz_steer.toml": (r"bus: (tfhub|socketcan:vcan0)", r"1 scenario driven"),
    "tunefree-hil drive bench_configs/mkz_steer.toml --join": (r"1 scenario driven, score",),
    "cantools monitor -i tfhub -c default/veh dbc/mkz_bywire/vehicle.dbc": (r"BRAKE_REPORT\(",),
    "tunefree-hil commission dbc/mkz_bywire --bench bench_configs/mkz_complete.toml --out runs/commission": (
        r"collect: 42 of 42 cells full",
    ),
    "tunefree-hil tune BENCH --benches 4": (r"4 benches side by side",),
    "tunefree-hil replay RUN --verify": (r"all frames equal",),
    "make -C tools/foreign_controller": (r"build/foreign_controller",),
    "tunefree-hil tune bench_configs/mkz_pursuit.toml": (r"pursuit\.look_ahead_s", r"\bgiven\b"),
    "tunefree-hil scenarios --export DIR": (r"\d+ reference drives in",),
    "tunefree-hil drive BENCH --session S --join": (r"1 scenario driven, score",),
    "tunefree-hil doctor": (r"--bus auto",),
    "tunefree-hil log check LOG [--vehicle DIR]": (r"STEERING_CMD", r"frames in .* s: no faults"),
    "tunefree-hil log convert IN OUT [--channel can0] [--format NAME]": (r"(\d+) of \1 frames in OUT",),
    "tunefree-hil grade runs/x": (r"42 metrics available",),
    "tunefree-hil grade runs/x/episodes/2": (r"42 metrics available",),
    "tunefree-hil explain runs/x": (r"slices through the winner",),
    "python -m tools.gap_exam open --out Q --answer answer/gap.json": (
        r'"outcome": ?"(right|in_set|silent|wrong|cannot_test)"',
    ),
}
LEFT = {
    "docs/tutorials/tune.md": (
        *(
            f"runs/*-tune-mkz_envelope/{name}"
            for name in ("study.db", "best.toml", "figures/*", "episodes/*/vehicle.log")
        ),
    ),
    "docs/tutorials/commission.md": (
        *(f"runs/commission/{name}" for name in ("report.md", "collect/logs/*.log", "collect/coverage.json")),
    ),
    "docs/tutorials/gap.md": (
        *(f"Q/{name}" for name in ("clean_*.log", "drive.log", "vehicle/vehicle.toml")),
        *(f"answer/{name}" for name in ("gap.json", "gap.md")),
    ),
    "docs/how-to/logs.md": ("FILE.png", "FOLDER/drive.log", "FOLDER/vehicle.toml"),
    "docs/how-to/own_controller.md": ("build/foreign_controller/controller", "DIR/*.csv"),
}


def write_drive_to_import(folder: Path) -> None:
    """The mapping as docs/how-to/logs.md has it, and a drive at 20 m/s in the columns which that names."""
    page = (ROOT / "docs" / "how-to" / "logs.md").read_text("utf-8")
    found = re.search(r"^```toml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert found
    (folder / "MAP.toml").write_text(found[1], "utf-8")
    rows = [f"{100 * k};72.0;{k};1" for k in range(520)]
    (folder / "DRIVE.csv").write_text("\n".join(["time;Speed;gps_count;cruise_active", *rows, ""]), "utf-8")


def write_rav4_log(folder: Path) -> None:
    """A log of a car which reports its speed alone, as the scenario rav4_drive begins; CHECKSUM as Toyota sums it."""
    lines = []
    for k in range(2100):
        data = bytes(5) + round(20.095 * 3.6 * 100).to_bytes(2, "big")
        checksum = (sum(data) + 8 + 0xB4) % 256
        lines.append(f"({k * 0.024:.6f}) can0 0B4#{data.hex().upper()}{checksum:02X}\n")
    (folder / "drive.log").write_text("".join(lines), "utf-8")


# Files that a page takes as given and no command makes.
WRITTEN: dict[str, Callable[[Path], None]] = {
    "docs/how-to/logs.md": write_drive_to_import,
    "docs/reference/grading.md": write_rav4_log,
}


def bare(command: str) -> str:
    """A command as the tables have it: without the folder of the programs."""
    return re.sub(r"(^|\s)\.venv/bin/", r"\1", command)


def commands_by_page() -> dict[str, list[str]]:
    """Page -> its commands in order; of README those that no other page has."""
    found = {str(page.relative_to(ROOT)): list(commands(page.read_text("utf-8"))) for page in PAGES}
    others = {bare(line) for page, lines in found.items() if page != "README.md" for line in lines}
    found["README.md"] = [line for line in found["README.md"] if bare(line) not in others]
    return found


BY_PAGE = commands_by_page()
RUN = {page: lines for page, lines in BY_PAGE.items() if any(bare(line) not in NOT_RUN for line in lines)}


class Desk:
    """A fresh copy of the checkout, with its programs in .venv, in which commands are typed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "checkout"
        self.sessions = tempfile.mkdtemp(prefix="tf-")  # of the hubs: the path of a socket has to be short
        self.staying: list[subprocess.Popen[bytes]] = []
        for name in TEXT_FOLDERS:
            shutil.copytree(ROOT / name, self.folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        for path in ROOT.iterdir():
            if path.is_file():
                shutil.copy2(path, self.folder)
        self._use_environment(Path(sys.executable).parent.parent)
        self._shorten_benches()
        self.environment = {
            **os.environ,
            "PATH": f"{self.folder / '.venv' / 'bin'}:{os.environ['PATH']}",
            "PYTHONPATH": str(self.folder),
            "XDG_RUNTIME_DIR": self.sessions,
            "TERM": "xterm",
        }
        self.environment.pop("TUNEFREE_JIT", None)  # the tests run without compiled kernels; a reader does not

    def _use_environment(self, environment: Path) -> None:
        """Link the programs, and copy the stamps of make: nothing is installed, and none is written into ours."""
        (self.folder / ".venv").mkdir()
        for path in environment.iterdir():
            if path.name.startswith(".") and path.is_file():
                shutil.copy2(path, self.folder / ".venv" / path.name)
            else:
                (self.folder / ".venv" / path.name).symlink_to(path)

    def _shorten_benches(self) -> None:
        configs = self.folder / "bench_configs"
        shutil.copy(self.folder / "tests" / "vcan" / "scenarios" / f"{SHORT_SCENARIO}.toml", configs / "scenarios")
        for path in configs.glob("*.toml"):
            kept = r'"\2"' if path.name.startswith("van") else f'"{SHORT_SCENARIO}"'
            text = re.sub(r'(?m)^((?:verify_)?scenarios = )\["(\w+)".*\]', rf"\1[{kept}]", path.read_text("utf-8"))
            path.write_text(re.sub(r'"families:\d+"', '"families:2"', text), "utf-8")

    def type(self, command: str, page: str = "") -> str:
        """Run a command of a page to its end. Returns what it printed; an AssertionError where its status is not 0."""
        line = self._line(command, page)
        keys = next((keys for start, keys in TERMINAL.items() if bare(command).startswith(start)), b"")
        if bare(command).startswith(STAYS):
            self._start(line)
            return ""
        if keys:
            return self._type_on_a_terminal(line, keys, SEEN[bare(command)])
        done = subprocess.run(
            ["bash", "-c", line], cwd=self.folder, env=self.environment, capture_output=True, text=True,
            stdin=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        printed = done.stdout + done.stderr
        assert done.returncode == 0, f"{page}: {command}\n{line}\n{printed[-3000:]}"
        return printed

    def _line(self, command: str, page: str) -> str:
        """What is typed for a command of a page: shortened, brackets off, placeholders filled in."""
        name = bare(command)
        line = SHORTENED[name].command if name in SHORTENED else re.sub(r"[][]", "", command)
        for placeholder, text in FILLED_IN.get(page, {}).items():
            line = re.sub(rf"(?<!\w){re.escape(placeholder)}(?![A-Za-z])", lambda _, text=text: text, line)
        return line

    def _start(self, line: str) -> None:
        with (self.folder / f"staying-{len(self.staying)}.txt").open("wb") as output:
            process = subprocess.Popen(
                ["bash", "-c", f"exec {line}"], cwd=self.folder, env=self.environment, stdin=subprocess.DEVNULL,
                stdout=output, stderr=subprocess.STDOUT,
            )  # fmt: skip
        self.staying.append(process)
        time.sleep(1.0)  # what the reader takes to the next terminal

    def _type_on_a_terminal(self, line: str, keys: bytes, awaited: tuple[str, ...]) -> str:
        ours, its = pty.openpty()
        os.set_blocking(ours, False)
        words = ["bash", "-c", f"stty rows 50 cols 160; {line}"]
        process = subprocess.Popen(words, cwd=self.folder, env=self.environment, stdin=its, stdout=its, stderr=its)
        os.close(its)
        printed, begun_s = "", time.monotonic()
        while process.poll() is None:
            time.sleep(0.2)
            printed += _read(ours)
            waited_s = time.monotonic() - begun_s
            if waited_s > TERMINAL_S or all(re.search(pattern, printed) for pattern in awaited):
                os.write(ours, keys)
            if waited_s > 2 * TERMINAL_S:
                process.kill()
        printed += _read(ours)
        os.close(ours)
        assert process.returncode == 0, f"{line}\n{printed[-2000:]}"
        return printed

    def still_running(self) -> list[bool]:
        """Whether each command which stays is still there."""
        return [process.poll() is None for process in self.staying]

    def leave(self) -> None:
        """End what still runs, as Ctrl-C would, the last one first."""
        for process in reversed(self.staying):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        shutil.rmtree(self.sessions, ignore_errors=True)


def _read(terminal: int) -> str:
    """What a terminal holds, "" where nothing, or no program on its other end, is there."""
    try:
        return os.read(terminal, 1 << 20).decode("utf-8", "replace")
    except OSError:
        return ""


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.leave()


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", RUN)
def test_the_commands_of_a_page_work_one_after_the_other(page: str, desk: Desk) -> None:
    if page in WRITTEN:
        WRITTEN[page](desk.folder)
    for given in GIVEN.get(page, ()):
        desk.type(given)
    for command in RUN[page]:
        if bare(command) in NOT_RUN:
            continue
        printed = desk.type(command, page)
        for pattern in SEEN.get(bare(command), ()):
            assert re.search(pattern, printed), f"{page}: {command}\ndoes not print {pattern}\n{printed[-3000:]}"
    assert all(desk.still_running()), f"{page}: a command which stays has ended"
    missing = [name for name in LEFT.get(page, ()) if not any(desk.folder.glob(name))]
    assert missing == [], page


@pytest.mark.slow
def test_a_command_that_does_not_work_is_found(desk: Desk) -> None:
    with pytest.raises(AssertionError, match="no such"):
        desk.type("tunefree-hil explain runs/nothing", "docs/tutorials/tune.md")


def test_the_tables_name_commands_that_pages_have() -> None:
    pasted = {bare(line) for page in PAGES for line in commands(page.read_text("utf-8"))}
    assert {*NOT_RUN, *SHORTENED, *SEEN} - pasted == set()
    assert NOT_RUN.keys() & SHORTENED.keys() == set()
    assert {*FILLED_IN, *GIVEN, *LEFT} - RUN.keys() == set()


@pytest.mark.parametrize("test", sorted({row.elsewhere for row in NOT_RUN.values()} - {""}))
def test_the_test_which_runs_it_elsewhere_is_there(test: str) -> None:
    path, _, name = test.partition("::")
    assert re.search(rf"^def {name}\(", (ROOT / path).read_text("utf-8"), re.MULTILINE)
