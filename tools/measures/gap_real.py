"""What `gap` says of real cars: a model of one part of their recordings, asked about the other part.

Nobody knows what is missing there: no truth, so nothing here is right or wrong. Recordings are cut into pieces of
PIECE_S, which go to the model and to the question in turn, so that both hold all that was driven; a drive shorter than
two of them goes whole. Nothing that is asked about was seen by the model, nor the blocks of the proof by any fit. But
for the RAV4: its one minute is too short for two halves, and is asked about with the model that it made itself. What
an earlier call has left is used.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tools.gap_exam.recordings import with_track
from tools.measures._ledger import FOLDER, ROOT
from tools.measures._summary import rounded
from tools.measures._unseen import ended
from tools.measures.realcars import DATA, SETS, dart, needed
from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.gap.gap import run_gap
from tunefree_hil.jobs.gap.options import GapOptions
from tunefree_hil.jobs.learn.calibrate import calibrate
from tunefree_hil.jobs.learn.options import CalibrateOptions

VALUE = "recordings of real cars of which a name or a set is said, out of those that were asked; no truth is known"
NAME = "gap_real"
PIECE_S = 20.0
CANDIDATES = 3  # of each answer that are told


class Halves(NamedTuple):
    """Logs of a car that go to its model, and those that are asked about; beside them the vehicle's folder."""

    vehicle: Path
    model: tuple[Path, ...]
    asked: tuple[Path, ...]


def measure(data: str = str(DATA), folder: str = FOLDER) -> dict[str, Any]:
    """n: recordings. detail: by recording the sentence, the links that are broken, the best candidates, the proof."""
    place = Path(folder).resolve() / NAME
    found = {"rav4": _answer(rav4(Path(data), place / "rav4"), place / "rav4")}
    for name in SETS:
        logs = dart(name, Path(data), place / "imports").logs
        halves = split(logs[0].parent, logs, place / name / "cut")
        found[name] = _answer(halves, place / name)
    named = [name for name, one in found.items() if one.get("effects") or one.get("set")]
    return {"value": len(named), "unit": "1", "n": len(found), "low": None, "high": None, "detail": rounded(found)}


def rav4(data: Path, place: Path) -> Halves:
    """The minute as it was recorded, with the track by which its wheels tell the yaw rate."""
    source = data / "comma2k19_rav4"
    needed(source)
    vehicle = place / "vehicle"
    vehicle.mkdir(parents=True, exist_ok=True)
    shutil.copy(ROOT / "dbc" / "rav4_2017" / "vehicle.dbc", vehicle)
    sheet = (ROOT / "dbc" / "rav4_2017" / "vehicle.toml").read_text(encoding="utf-8")
    (vehicle / "vehicle.toml").write_text(with_track(sheet), encoding="utf-8")
    minute = (source / "drive.candump.log",)
    return Halves(vehicle, minute, minute)


def split(vehicle: Path, logs: Sequence[Path], out: Path) -> Halves:
    """Cut logs into pieces and deal them out in turn; pieces that are there are written again, the same."""
    halves: tuple[list[Path], list[Path]] = ([], [])
    for log in logs:
        for number, text in enumerate(pieces(log.read_text(encoding="utf-8"))):
            half = 0 if len(halves[0]) == len(halves[1]) else 1
            path = out / ("model", "asked")[half] / f"{log.parent.name}-{number}.log"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            halves[half].append(path)
    return Halves(vehicle, tuple(halves[0]), tuple(halves[1]))


def pieces(text: str) -> list[str]:
    """Candump text in equal pieces of about PIECE_S; whole where it is shorter than two."""
    lines = text.splitlines(keepends=True)
    stamps = [float(line[1 : line.index(")")]) for line in lines]
    begin, seconds = stamps[0], stamps[-1] - stamps[0]
    many = max(int(seconds / PIECE_S), 1)
    found = [""] * many
    for stamp, line in zip(stamps, lines, strict=True):
        found[min(int((stamp - begin) * many / seconds), many - 1)] += line
    return found


def _answer(halves: Halves, place: Path) -> dict[str, Any]:
    """Calibrate on one half, ask about the other; a refusal is an answer too."""
    model, out = place / "model", place / "gap"
    try:
        if not model.is_dir():
            ended(calibrate(CalibrateOptions(list(halves.model), str(halves.vehicle), model)))
        ended(run_gap(GapOptions(list(halves.asked), str(halves.vehicle), str(model), out)))
    except InputError as error:
        return {"refused": error.message}
    return told(json.loads((out / "gap.json").read_text(encoding="utf-8")), halves)


def told(answer: dict[str, Any], halves: Halves) -> dict[str, Any]:
    """Of an answer what a table has room for."""
    best = sorted(answer["candidates"], key=lambda one: -one["evidence"])[:CANDIDATES]
    return {
        "logs": {"model": len(halves.model), "asked": len(halves.asked)},
        **{key: answer.get(key) for key in ("verdict", "sentence", "effects", "set", "explained_frac", "moved")},
        "broken": {one["signal"]: one["share"] for one in answer["links"] if one["broken"]},
        "evidence": {one["name"]: one["evidence"] for one in best},
        "signals": {
            name: {key: one[key] for key in ("before", "recalibrated", "after", "floor")}
            for name, one in answer["signals"].items()
        },
    }
