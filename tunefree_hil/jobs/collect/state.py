"""State of a collection: a run folder and the coverage of its logs, which are the only state."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.bench import Bench
from tunefree_hil.collect.coverage import Coverage
from tunefree_hil.collect.envelope import EnvelopeExcess, envelope_from_vehicle, measure_excess
from tunefree_hil.collect.gentle_driving import MAX_STRETCHES_A_DRIVE, GentleStretch
from tunefree_hil.collect.plan import DrivePlan, plan_as_dict, plannable_cells, plannable_stretches
from tunefree_hil.jobs.collect.plan import StartPose, drive_name, write_scenario
from tunefree_hil.jobs.options.records import CollectOptions
from tunefree_hil.jobs.run_folder import RunFolder, write_json
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.read import read_drives

HOLD_NUMBERS_A_DRIVE = 7  # so that the first hold of each drive differs
IDLE_DRIVES = 3  # consecutive drives with less than MIN_GAIN after which the collection ends
MIN_GAIN = 0.05  # gained seconds of a drive, as a share of the quota of a cell


class CollectedDrive(NamedTuple):
    """A drive in logs/: duration, gained seconds, envelope excess, start and end pose."""

    name: str
    seconds: float
    gained_s: float
    beyond: EnvelopeExcess
    start: StartPose
    end: StartPose


class Collection:
    """A run folder and the coverage of its logs."""

    def __init__(self, run: RunFolder, bench: Bench, options: CollectOptions) -> None:
        self.run, self.bench, self.options = run, bench, options
        vehicle = bench.vehicle
        self.envelope = envelope_from_vehicle(vehicle)
        self.coverage = Coverage(vehicle, plannable_cells(vehicle, options.top_mps), options.quota_s, bench.dt_s)
        self.stretches = plannable_stretches(vehicle, options.quota_s, options.drive_s, options.area_m, options.top_mps)
        self.gentle_count = 0  # number of stretches driven
        self.driven: list[CollectedDrive] = []

    @property
    def logs(self) -> Path:
        """Folder of the logs."""
        return self.run.path / "logs"

    @property
    def centre(self) -> tuple[float, float] | None:
        """Middle of the area: the start of the first drive; None before it."""
        return (self.driven[0].start.x_m, self.driven[0].start.y_m) if self.driven else None

    @property
    def simulated_s(self) -> float:
        """Duration of all drives."""
        return sum(one.seconds for one in self.driven)

    @property
    def wants_cells(self) -> bool:
        """Whether another drive would fill cells."""
        return self.coverage.counter.missing > 0 and not self.is_stuck

    @property
    def next_stretches(self) -> tuple[int, int]:
        """[first, end) of the gentle stretches of the next drive: one, or several where no cells are left.

        This distributes gentle driving over all drives, so that a split by drives has some of it on both sides.
        """
        more = 1 if self.wants_cells else MAX_STRETCHES_A_DRIVE
        return self.gentle_count, min(self.gentle_count + more, len(self.stretches))

    @property
    def wants_more(self) -> bool:
        """Whether another drive is needed."""
        return self.wants_cells or self.gentle_count < len(self.stretches)

    @property
    def progress_text(self) -> str:
        """Progress as text."""
        full, driven_min = self.coverage.full, self.simulated_s / 60.0
        text = f"{full} of {self.coverage.wanted} cells full after {driven_min:.1f} min of driving"
        wanted = len(self.stretches)
        return f"{text}, {self.gentle_count} of {wanted} gentle stretches" if wanted else text

    @property
    def is_stuck(self) -> bool:
        """Whether the last IDLE_DRIVES drives gained almost nothing."""
        last = self.driven[-IDLE_DRIVES:]
        least_s = MIN_GAIN * self.options.quota_s
        return len(last) == IDLE_DRIVES and all(one.gained_s < least_s for one in last)

    def count_existing(self) -> None:
        """Count the existing logs, up to the first missing number."""
        while (self.logs / f"{drive_name(len(self.driven) + 1)}.log").is_file():
            self.count_drive(len(self.driven) + 1)

    def count_drive(self, number: int) -> CollectedDrive:
        """Count the log of a drive."""
        (drive,) = read_drives([self.logs / f"{drive_name(number)}.log"], self.bench.codec)
        before, self.gentle_count = self.coverage.collected_s, self.next_stretches[1]
        self.coverage.add(drive.get)
        start, end = _pose(drive, 0), _pose(drive, -1)
        centre = self.centre or (start.x_m, start.y_m)
        out = measure_excess(drive.get, drive.dt_s, self.envelope, centre, self.options.area_m)
        seconds = drive.n_rows * drive.dt_s
        self.driven.append(
            CollectedDrive(drive_name(number), seconds, self.coverage.collected_s - before, out, start, end)
        )
        return self.driven[-1]

    def write_plan(self, number: int) -> Path:
        """Write scenario and plan of a drive. Returns the path of the scenario. The same logs give identical files."""
        options = self.options
        path = self.run.path / "scenarios" / f"{drive_name(number)}.toml"
        start = self.driven[-1].end if self.driven else StartPose()
        write_scenario(path, number, start, options.seed, options.drive_s)
        have, first_hold = tuple(self.coverage.counter.have), HOLD_NUMBERS_A_DRIVE * (number - 1)
        limits = (options.quota_s, options.area_m, options.top_mps, self.centre)
        plan = DrivePlan(*limits, have, first_hold, options.drive_s, self.next_stretches)
        write_json(path.with_suffix(".json"), plan_as_dict(plan))
        return path

    def as_dict(self) -> dict[str, Any]:
        """coverage.json."""
        return {
            **self.coverage.as_dict(),
            "simulated_s": round(self.simulated_s, 3),
            "beyond_envelope_s": round(sum(one.beyond.total_s for one in self.driven), 3),
            "area_m": self.options.area_m,
            "centre_m": self.centre,
            "gentle": [_stretch_data(one, i < self.gentle_count) for i, one in enumerate(self.stretches)],
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
        """Write coverage.json."""
        write_json(self.run.path / "coverage.json", self.as_dict())


def _stretch_data(stretch: GentleStretch, driven: bool) -> dict[str, Any]:
    return {
        "speed_mps": stretch.speed_mps,
        "hold_s": stretch.hold_s,
        "bent": stretch.is_curved,
        "coast_s": stretch.coast_s,
        "most_mps": stretch.max_mps,
        "driven": driven,
    }


def _pose(drive: Drive, row: int) -> StartPose:
    """First (row 0) or last (row -1) pose in the log."""
    values = [drive.get(f"ins.{name}") for name in ("x_m", "y_m", "heading_rad")]
    known = [value[np.isfinite(value)] if value is not None else np.zeros(0) for value in values]
    return StartPose(*(round(float(value[row]), 4) if len(value) else 0.0 for value in known))
