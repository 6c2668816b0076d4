"""What every part of the reproduction gets: sizes, folders, and the progress of the run."""

from __future__ import annotations

import io
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from tools.measures._envelope import Progress, changed_files
from tools.measures._ledger import FOLDER, ROOT, Ledger
from tunefree_hil.figures.style import headline, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")
STEER_BENCH = "bench_configs/mkz_steer.toml"  # two parameters, the paper's seven scenarios
COMPLETE_BENCH = "bench_configs/mkz_complete.toml"  # the same with eleven parameters
UNKNOWN_COMMIT = "unknown"
MOST_BY_TIME = 0.95  # share of a part that time alone can fill
FOUND_S = 2.0  # a part that took less was found in the work folder and says nothing about the pace


class Folders(NamedTuple):
    """records: JSON. figures: PNG. work: what is needed to go on after an interruption."""

    records: Path
    figures: Path
    work: Path


class LineRelay(io.TextIOBase):
    """A text stream that hands every whole line on."""

    def __init__(self, relay: Callable[[str], None]) -> None:
        self._relay, self._rest = relay, ""

    def write(self, text: str) -> int:
        """Take some text."""
        *lines, self._rest = (self._rest + text).split("\n")
        for line in lines:
            if line.strip():
                self._relay(line.strip())
        return len(text)


class PartProgress:
    """Progress of one part inside that of the run.

    expected_s: By name, of all parts of this run, on two cores.
    """

    def __init__(self, expected_s: Mapping[str, float]) -> None:
        self._expected_s = dict(expected_s)
        self._run = Progress("reproduce", sum(expected_s.values()))
        self._name, self._began_s = "", 0.0
        self._shown = sys.stderr  # also while the lines of a job are relayed

    def begin(self, name: str) -> None:
        """The next part."""
        self._name, self._began_s = name, time.monotonic()
        with redirect_stderr(self._shown):
            self._run.finish(0.0, f"{name} begins")

    def update(self, share: float, text: str) -> None:
        """A share (0 to 1) of the present part is done."""
        with redirect_stderr(self._shown):
            self._run.update(share * self._expected_s.get(self._name, 0.0), f"{self._name}, {text}")

    def tell(self, text: str) -> None:
        """Something goes on whose share is not known: the time since the beginning of the part stands for it."""
        expected_s = max(self._expected_s.get(self._name, 0.0), 1.0)
        self.update(min((time.monotonic() - self._began_s) / expected_s, MOST_BY_TIME), text)

    @contextmanager
    def relay_lines(self, label: str) -> Iterator[None]:
        """Lines that jobs write to stderr become the progress of the part, of which one in some seconds is shown."""
        with redirect_stderr(LineRelay(lambda line: self.tell(f"{label}: {line}"))):
            yield

    def finish(self, text: str) -> None:
        """The present part is done."""
        is_known = time.monotonic() - self._began_s < FOUND_S
        with redirect_stderr(self._shown):
            self._run.finish(self._expected_s.get(self._name, 0.0), f"{self._name}: {text}", is_known=is_known)


class Context(NamedTuple):
    """is_quick: Small trials, which show that everything runs and are no result. is_full: See table5."""

    folders: Folders
    progress: PartProgress
    is_quick: bool = False
    is_full: bool = False
    seed: int = 1

    def size(self, full: T, quick: T) -> T:
        """The first in a run that counts, the second in a quick one."""
        return quick if self.is_quick else full

    def ledger(self, name: str) -> Ledger:
        """Rows of a part, kept as they come."""
        return Ledger(self.folders.work / name)

    def save(self, figure: Figure, name: str) -> str:
        """Write a picture; a quick one says so. Returns: its file name."""
        if self.is_quick:
            headline(figure, f"QUICK RUN, NOT A RESULT\n{figure.get_suptitle()}")
        save(figure, self.folders.figures / f"{name}.png")
        return f"{name}.png"


def work_folder(is_quick: bool) -> Path:
    """Where interrupted runs go on."""
    return ROOT / FOLDER / ("reproduction-quick" if is_quick else "reproduction")


class Checkout(NamedTuple):
    """The code that ran. changed_files: Tracked files that differ from the commit."""

    commit: str
    changed_files: int


def read_checkout() -> Checkout:
    """Commit of the working tree; 'unknown' outside a clone."""
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    return Checkout(done.stdout.strip() or UNKNOWN_COMMIT, changed_files() if done.returncode == 0 else 0)
