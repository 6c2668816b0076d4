"""Recordings of real cars made ready: for each a vehicle folder, logs that its model is made from, and one to ask of.

DART's drives become CAN logs by the examined program's own `log import` (a command, nothing imported); the model of
the drives that are asked about (drive.log, drive_1.log, ...: a minute and a half and more together) is made from all
the others. The RAV4's one minute is too short to be cut: its model is made from the minute as it was recorded, and what
is asked about is that minute rewritten.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from tools.gap_exam.call import call
from tools.gap_exam.files import Run, write

DART_FOLDER = "dart/steering_identification_25_sept_2024"
DART_DRIVES = {
    "dart_a": ("09_57_26",),
    "dart_b": ("09_50_18",),
    "dart_c": ("09_53_24", "09_54_57", "10_02_32"),  # the others hold what a model can be judged on
}
RAV4_TRACK = "track_m = 1.57  # the data sheet's: what its wheels say of the yaw rate is all there is of a gyro"
NOMINAL = "\n[nominal]\n"
RAV4_LOG = "comma2k19_rav4/drive.candump.log"
IMPORT = "tunefree-hil log import {csv} --map {map} --out {out} --json"
ROOT = Path(__file__).resolve().parents[2]


class NoRecording(Exception):
    """A recording that is not there, or that could not be imported."""


def make_ready(run: Run, data: Path, command: str = IMPORT) -> None:
    """Write RUN/recordings/NAME for every recording that is not there yet; raises NoRecording."""
    imported = _dart(run, data, command)
    for name, drives in DART_DRIVES.items():
        target = run.folder / "recordings" / name
        if not (target / "drive.log").is_file():
            mine = [next(folder for folder in imported if folder.name.endswith(drive)) for drive in drives]
            _copy_folder(mine[0], target / "vehicle")
            for number, other in enumerate(one for one in imported if one not in mine):
                write(target / "vehicle.logs" / f"{number:02d}.log", (other / "drive.log").read_text())
            for number, one in reversed(list(enumerate(mine))):  # drive.log comes last: then all are there
                write(target / log_name(number), (one / "drive.log").read_text())
    _rav4(run, data)


def log_name(number: int) -> str:
    """The file of one of the logs that are asked about together."""
    return f"drive_{number}.log" if number else "drive.log"


def _dart(run: Run, data: Path, command: str) -> list[Path]:
    """All drives with motion capture, each imported into a folder that ends in its time of day."""
    found = sorted((data / DART_FOLDER).glob("*.csv"))
    wanted = [drive for drives in DART_DRIVES.values() for drive in drives]
    missing = [drive for drive in wanted if not any(path.stem.endswith(drive) for path in found)]
    if missing:
        folder = data / DART_FOLDER
        raise NoRecording(f"{folder} holds no drive {', '.join(missing)}; --recordings names the folder of both cars")
    return [_imported(run.folder / "recordings" / f".{path.stem}", path, command) for path in found]


def _imported(out: Path, path: Path, command: str) -> Path:
    if not (out / "drive.log").is_file():
        shutil.rmtree(out, ignore_errors=True)
        out.parent.mkdir(parents=True, exist_ok=True)
        mapping = ROOT / "tools" / "imports" / "dart_100hz.toml"
        done = call(command, 300.0, csv=str(path), map=str(mapping), out=str(out))
        if done.status != 0:
            raise NoRecording(f"{path.name} could not be imported: {done.stderr}")
    return out


def _rav4(run: Run, data: Path) -> None:
    target = run.folder / "recordings" / "rav4"
    path = data / RAV4_LOG
    if not path.is_file():
        raise NoRecording(f"{path} is not there; --recordings names the folder of both cars")
    if not (target / "drive.log").is_file():
        _copy_folder(ROOT / "dbc" / "rav4_2017", target / "vehicle")
        sheet = target / "vehicle" / "vehicle.toml"
        write(sheet, with_track(sheet.read_text()))
        write(target / "vehicle.logs" / "00.log", path.read_text())
        write(target / "drive.log", path.read_text())


def with_track(sheet: str) -> str:
    """The RAV4's vehicle.toml with its track. Raises NoRecording for one in which that has no place of its own."""
    if sheet.count(NOMINAL) != 1 or "\ntrack_m" in sheet:
        raise NoRecording("dbc/rav4_2017/vehicle.toml was expected to have one [nominal] and no track_m")
    return sheet.replace(NOMINAL, f"{NOMINAL}{RAV4_TRACK}\n")


def _copy_folder(source: Path, target: Path) -> None:
    for name in ("vehicle.dbc", "vehicle.toml"):
        write(target / name, (source / name).read_text())
