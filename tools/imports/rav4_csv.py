#!/usr/bin/env python3
"""Decode the RAV4 minute (shared data) into a CSV as a data logger exports it, for `log import`.

    python tools/imports/rav4_csv.py OUT.csv [--log ../shared/data/comma2k19_rav4/drive.candump.log] [--dbc ...]
    tunefree-hil log import OUT.csv --map tools/imports/rav4.toml --out FOLDER

A row a frame: the time, and the values that this frame brought; the other cells are empty. Values by cantools and the
data's own DBC, in the DBC's units. Data: comma2k19, copyright (c) 2018 comma.ai, MIT licence.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cantools

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tunefree_hil.base.errors import InputError  # noqa: E402
from tunefree_hil.episode.candump import read_candump  # noqa: E402

DATA = ROOT.parent / "shared" / "data" / "comma2k19_rav4"
CAR, SENT = "can0", "can128"  # the car's bus, and what the driving computer sent there
WHEELS = ("WHEEL_SPEED_FL", "WHEEL_SPEED_FR", "WHEEL_SPEED_RL", "WHEEL_SPEED_RR")
# (channel, id, least bytes) -> column: signals that are added up
COLUMNS = {
    (CAR, 0x0B4, 8): {"speed": ("SPEED",)},
    (CAR, 0x025, 8): {"steering_wheel": ("STEER_ANGLE", "STEER_FRACTION")},
    (CAR, 0x0AA, 8): {name.lower(): (name,) for name in WHEELS},
    (CAR, 0x260, 8): {"eps_torque": ("STEER_TORQUE_EPS",)},
    (CAR, 0x1D2, 8): {"cruise_active": ("CRUISE_ACTIVE",)},
    (SENT, 0x343, 2): {"accel_command": ("ACCEL_CMD",)},
    (SENT, 0x2E4, 5): {"torque_command": ("STEER_TORQUE_CMD",)},
}
NAMES = [column for columns in COLUMNS.values() for column in columns]


def rows(log: Path, dbc: Path) -> Iterator[dict[str, float]]:
    """Column -> value, and 'time' in s, a frame each; frames that end before their signals are left out.

    Frames of one stamp share a row, and of the same message the later is dropped, for a row has one time.
    """
    database: Any = cantools.database.load_file(str(dbc), strict=False)
    row: dict[str, float] = {}
    for frame in read_candump(log):
        wanted = next(
            (
                columns
                for (channel, can_id, least), columns in COLUMNS.items()
                if (channel, can_id) == (frame.channel, frame.can_id) and len(frame.data) >= least
            ),
            None,
        )
        if wanted is None:
            continue
        signals = database.decode_message(frame.can_id, frame.data, decode_choices=False, allow_truncated=True)
        values = {column: sum(float(signals[name]) for name in names) for column, names in wanted.items()}
        if row and row["time"] != frame.time_s:
            yield row
            row = {}
        row = {"time": frame.time_s} | values | row
    if row:
        yield row


def write(path: Path, found: Iterable[dict[str, float]]) -> None:
    """Write rows as a CSV with the columns 'time' and NAMES."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["time", *NAMES], lineterminator="\n")
        writer.writeheader()
        writer.writerows(found)


def main() -> int:
    """Write the CSV; 2 when an input does not fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--log", type=Path, default=DATA / "drive.candump.log")
    parser.add_argument("--dbc", type=Path, default=DATA / "rav4.dbc")
    options = parser.parse_args()
    try:
        found = list(rows(options.log, options.dbc))
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    write(options.out, found)
    print(f"{len(found)} rows in {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
