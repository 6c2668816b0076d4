"""How far a collection has come: a run folder, and what its logs cover. The logs are all the state there is."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.bench import Bench
from tunefree_hil.collect.coverage import Coverage
from tunefree_hil.collect.envelope import Beyond, beyond, envelope_of
from tunefree_hil.collect.gentle_driving import TOGETHER
from tunefree_hil.collect.plan import driven_stretches, driven_targets
from tunefree_hil.jobs.collect.plan import Asked, Start, drive_name
from tunefree_hil.jobs.run_folder import RunFolder, write_json
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.read import read_drives

IDLE_DRIVES = 3  # so many drives one after the other that fill less than LEAST_GAIN of a quota
LEAST_GAIN = 0.05


class Driven(NamedTuple):
    """A drive that lies in logs/: how long, what it left of the envelope, where it began and ended."""

    name: str
    seconds: float
    gained_s: float
    beyond: Beyond
    start: Start
    end: Start


class Collection:
    """A run folder and what its logs cover."""

    def __init__(self, run: RunFolder, bench: Bench, asked: Asked) -> None:
        self.run, self.bench, self.asked = run, bench, asked
        vehicle = bench.vehicle
        self.envelope = envelope_of(vehicle)
        self.coverage = Coverage(vehicle, driven_targets(vehicle, asked.top_mps), asked.quota_s, bench.dt_s)
        self.stretches = driven_stretches(vehicle, asked.quota_s, asked.drive_s, asked.area_m, asked.top_mps)
        self.gentle = 0  # stretches that have been driven
        self.driven: list[Driven] = []

    @property
    def logs(self) -> Path:
        """Folder of the logs."""
        return self.run.path / "logs"

    @property
    def centre(self) -> tuple[float, float] | None:
        """Middle of the area: where the first drive began; None before it."""
        return (self.driven[0].start.x_m, self.driven[0].start.y_m) if self.driven else None

    @property
    def simulated_s(self) -> float:
        """Of all drives."""
        return sum(one.seconds for one in self.driven)

    @property
    def wants_cells(self) -> bool:
        """Whether another drive would fill cells."""
        return self.coverage.counter.missing > 0 and not self.is_stuck

    @property
    def next_stretches(self) -> tuple[int, int]:
        """[first, end) of the gentle stretches of the next drive: one before cells, more where there are none to fill.

        So gentle driving is spread over all drives, and a split by drives leaves some of it on either side.
        """
        more = 1 if self.wants_cells else TOGETHER
        return self.gentle, min(self.gentle + more, len(self.stretches))

    @property
    def wants_more(self) -> bool:
        """Whether another drive is to come."""
        return self.wants_cells or self.gentle < len(self.stretches)

    @property
    def words(self) -> str:
        """How far it has come."""
        full, driven_min = self.coverage.full, self.simulated_s / 60.0
        words = f"{full} of {self.coverage.wanted} cells full after {driven_min:.1f} min of driving"
        wanted = len(self.stretches)
        return f"{words}, {self.gentle} of {wanted} stretches driven gently" if wanted else words

    @property
    def is_stuck(self) -> bool:
        """Whether the last drives filled next to nothing."""
        last = self.driven[-IDLE_DRIVES:]
        least_s = LEAST_GAIN * self.asked.quota_s
        return len(last) == IDLE_DRIVES and all(one.gained_s < least_s for one in last)

    def take_up(self) -> None:
        """Count the logs that are there, as far as they follow one another."""
        while (self.logs / f"{drive_name(len(self.driven) + 1)}.log").is_file():
            self.take(len(self.driven) + 1)

    def take(self, number: int) -> Driven:
        """Count the log of a drive."""
        (drive,) = read_drives([self.logs / f"{drive_name(number)}.log"], self.bench.codec)
        before, self.gentle = self.coverage.had_s, self.next_stretches[1]
        self.coverage.add(drive.get)
        start, end = _pose(drive, 0), _pose(drive, -1)
        centre = self.centre or (start.x_m, start.y_m)
        out = beyond(drive.get, drive.dt_s, self.envelope, centre, self.asked.area_m)
        seconds = drive.ticks * drive.dt_s
        self.driven.append(Driven(drive_name(number), seconds, self.coverage.had_s - before, out, start, end))
        return self.driven[-1]

    def as_dict(self) -> dict[str, Any]:
        """coverage.json."""
        return {
            **self.coverage.as_dict(),
            "simulated_s": round(self.simulated_s, 3),
            "beyond_envelope_s": round(sum(one.beyond.total_s for one in self.driven), 3),
            "area_m": self.asked.area_m,
            "centre_m": self.centre,
            "gentle": [{**one._asdict(), "driven": number < self.gentle} for number, one in enumerate(self.stretches)],
            "drives": [
                {
                    "log": f"logs/{one.name}.log",
                    "seconds": round(one.seconds, 3),
                    "gained_s": round(one.gained_s, 3),
                    "beyond": {key: value if value == value else None for key, value in one.beyond._asdict().items()},
                }
                for one in self.driven
            ],
        }

    def write(self) -> None:
        """coverage.json as it stands."""
        write_json(self.run.path / "coverage.json", self.as_dict())


def _pose(drive: Drive, row: int) -> Start:
    """First (row 0) or last (row -1) pose that was heard."""
    values = [drive.get(f"ins.{name}") for name in ("x_m", "y_m", "heading_rad")]
    known = [value[np.isfinite(value)] if value is not None else np.zeros(0) for value in values]
    return Start(*(round(float(value[row]), 4) if len(value) else 0.0 for value in known))
