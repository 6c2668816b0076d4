"""Where an exam keeps what, and how it writes: under a temporary name first, so that a kill leaves whole files only.

RUN/exam.json             domain, numbers of cases and models, the hash over all truths (no truth itself), the program
RUN/vehicles/NN/          vehicle.dbc, vehicle.toml
RUN/models/NAME/          model folders, made by the examined program from the logs that lay in RUN/models/NAME.logs
RUN/models/NAME.part      one that is being made; NAME.lock: by whom
RUN/models/NAME.json      seconds that it took
RUN/models/NAME.refused.json  in how many calls it could not be made, and why
RUN/cases/NNNN/drive.log  the question; removed once it is answered
RUN/sealed/NNNN.json      the truth: commitment, nonce, and the text under a key stream
RUN/answers/NNNN/         gap.json, run.json (exit, seconds, made_s: of the question)
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

WAIT_S = 0.2  # between two looks at a lock that another holds


def write(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.write_text(text)
    part.replace(path)


def write_json(path: Path, data: Any) -> None:
    """As JSON, sorted, one line a key."""
    write(path, json.dumps(data, indent=1, sort_keys=True, allow_nan=False) + "\n")


@contextmanager
def held(path: Path, given_up: Callable[[], bool]) -> Iterator[bool]:
    """Hold a file's lock against other processes and threads; False where it is given up before it is had.

    The lock is the system's: it ends with whoever holds it, kill -9 included. The file stays.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        mine = False
        while not (mine or given_up()):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                mine = True
            except BlockingIOError:
                time.sleep(WAIT_S)
        yield mine


def read_json(path: Path) -> Any:
    """What a JSON file holds."""
    return json.loads(path.read_text())


class Run:
    """The folder of one exam."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def exam(self) -> Path:
        return self.folder / "exam.json"

    def vehicle(self, number: int) -> Path:
        return self.folder / "vehicles" / f"{number:02d}"

    def model(self, name: str) -> Path:
        return self.folder / "models" / name

    def model_time(self, name: str) -> Path:
        return self.folder / "models" / f"{name}.json"

    def refused(self, name: str) -> Path:
        """What a model (of a recording: its name) that could not be made came to, and in how many calls."""
        return self.folder / "models" / f"{name}.refused.json"

    def log(self, number: int) -> Path:
        return self.folder / "cases" / f"{number:04d}" / "drive.log"

    def sealed(self, number: int) -> Path:
        return self.folder / "sealed" / f"{number:04d}.json"

    def answer(self, number: int) -> Path:
        return self.folder / "answers" / f"{number:04d}"

    def is_answered(self, number: int) -> bool:
        """run.json is written last."""
        return (self.answer(number) / "run.json").is_file()
