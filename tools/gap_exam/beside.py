"""What a name is worth beside a network without one, and behind the wheel: both in the exam's own car.

For a log that was answered: the exam's car without the effect, recalibrated on the log, is mended in two ways. By name:
the effects of the answer with their values are put in, and it is recalibrated with them. Without: a plain LSTM learns
from the same log what the car misses (residual_net.py). Then both run free on two drives that neither has seen: one of
the same kind, and one at other speeds. Shrink: the share of the error that could be explained, of both.

Closed loop: the same driver with the same plan in the car before and in the one with the name; how much nearer to the
measured drive it comes, in what the driver tracks.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.gap_exam.call import call
from tools.gap_exam.car import Car
from tools.gap_exam.cases import Made, make, planned, vehicle_of
from tools.gap_exam.catalogue import EFFECTS
from tools.gap_exam.files import Run, read_json, write_json
from tools.gap_exam.hidden import NOTHING, Hidden, hidden_of
from tools.gap_exam.oracle import BLOCK, HEADING, LEAST, ROWS, blocks, errors, free_run, recalibrated, scales
from tools.gap_exam.rows import Exam
from tools.gap_exam.score import Marked, Row, detectable, row
from tools.gap_exam.simulate import INS_SPEED, INS_YAW, REPORT_SPEED, drive
from tools.gap_exam.statistics import quantile, share

LOGS = 24
UNSEEN_S = 120.0
EVERY = 4  # ticks a step of the network
OFFSETS, LEARNED = 4, 0.8  # its blocks overlap; the last fifth of the log decides when to stop
SUMMED = (REPORT_SPEED, HEADING, INS_SPEED)  # of the signals those to which it says the rate
ROW = "one effect, beside a plain LSTM residual"
NET = Path(__file__).with_name("residual_net.py")
Array = np.ndarray
Model = tuple[Car, Hidden]


class Beside(NamedTuple):
    """Shares of the explainable error that go, on the same kind of drive and at other speeds; and the closed loop."""

    name_same: float
    net_same: float
    name_other: float
    net_other: float
    replay_down: float
    replay_worst: float


def stated(answer: Mapping[str, Any] | None) -> Hidden:
    """The effects that an answer states, with their values; nothing where it states none."""
    effects = {}
    for one in (answer or {}).get("effects", []):
        if one.get("name") in EFFECTS:
            values = {key: said["value"] if isinstance(said, Mapping) else said for key, said in one["params"].items()}
            effects[one["name"]] = values
    return hidden_of(effects)


def compare(exam: Exam, truth: Mapping[str, Any], answer: Mapping[str, Any] | None) -> Beside:
    """Mend the car of a log in both ways, and look at unseen drives."""
    vehicle = vehicle_of(exam.domain, truth["vehicle"])
    made = make(vehicle, truth["effects"], truth["kind"], truth["who"], truth["seed"], truth["duration_s"])
    unseen = {
        name: make(vehicle, truth["effects"], kind, truth["who"], exam.domain.seed("beside", truth["seed"], name),
                   UNSEEN_S) for name, kind in (("same", truth["kind"]), ("other", "quick"))
    }  # fmt: skip
    scale, known = scales(made), stated(answer)
    inside = blocks(len(made.drive.commands))
    before = recalibrated(made, scale, inside[0] | inside[1])
    after = before if known == NOTHING else recalibrated(made, scale, inside[0] | inside[1], known)
    said = _network(made, unseen, before, scale)
    shrunk: dict[str, float] = {}
    for name, one in unseen.items():
        floor = _left(one, free_run(one, vehicle.car, one.hidden), scale)
        first = _left(one, free_run(one, *before), scale)
        for way, model in (("name", free_run(one, *after)), ("net", free_run(one, *before) + said[name])):
            shrunk[f"{way}_{name}"] = (first - _left(one, model, scale)) / (first - floor)
    return Beside(**shrunk, **_closed_loop(made, truth, before, after, scale))


def _left(made: Made, model: Array, scale: Array) -> float:
    inside = blocks(len(made.drive.commands))
    return float(np.sqrt(errors(made, model, scale, inside[0] | inside[1]).mean()))


def _network(made: Made, unseen: Mapping[str, Made], before: Model, scale: Array) -> dict[str, Array]:
    """What the network adds to the reports [K, rows] of every unseen drive, having learned from the log."""
    some = [_steps(made, before, scale, begin) for begin in range(0, BLOCK, BLOCK // OFFSETS)]
    starts = np.concatenate([begin + BLOCK * np.arange(len(one[0])) for begin, one in
                             zip(range(0, BLOCK, BLOCK // OFFSETS), some, strict=True)])  # fmt: skip
    edge = LEARNED * len(made.drive.commands)
    use = np.where(starts + BLOCK <= edge, 0, np.where(starts >= edge, 1, 2))  # learn, judge, neither
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
        learned = {"x": np.concatenate([x for x, _ in some]), "y": np.concatenate([y for _, y in some]), "use": use}
        learned["summed"] = np.isin(ROWS, SUMMED)
        np.savez(source, **learned, **{name: _steps(one, before, scale, 0)[0] for name, one in unseen.items()})
        done = call("python {net} {source} {target}", 900.0, net=str(NET), source=str(source), target=str(target))
        if done.status != 0:
            raise ValueError(f"the network was not fitted: {done.stderr}")
        with np.load(target) as data:
            return {name: _at_ticks(data[name], len(one.drive.commands), scale) for name, one in unseen.items()}


def _steps(made: Made, before: Model, scale: Array, begin: int) -> tuple[Array, Array]:
    """(inputs, targets) [blocks, steps, ...]: commands and what the car says; what it misses, in units of `scale`."""
    count = (len(made.drive.commands) - begin) // BLOCK
    says, measured = free_run(made, *before, begin), made.drive.reports[:, ROWS]

    def cut(rows: Array) -> Array:
        return rows[begin : begin + count * BLOCK].reshape(count, BLOCK, -1)[:, ::EVERY]

    missed, says = cut((measured - says) / scale), cut(says)
    says[:, :, ROWS.index(HEADING)] -= says[:, :1, ROWS.index(HEADING)]
    return np.concatenate([cut(made.drive.commands), says], axis=2), missed


def _at_ticks(said: Array, ticks: int, scale: Array) -> Array:
    """Outputs of whole blocks at every tick, straight lines between; 0 behind the last whole block."""
    out, at = np.zeros((ticks, said.shape[2])), np.arange(BLOCK)
    for place, block in enumerate(said):
        for column in range(said.shape[2]):
            line = np.interp(at, at[::EVERY], block[:, column])
            out[place * BLOCK : (place + 1) * BLOCK, column] = line
    return out * scale


def _closed_loop(made: Made, truth: Mapping[str, Any], before: Model, after: Model, scale: Array) -> dict[str, float]:
    """The same plan, driver and noise in both cars, against the measured drive."""
    plan, noise = planned(made.vehicle, truth["kind"], truth["seed"], truth["duration_s"])
    off = []
    for car, hidden in (before, after):
        again = drive(car, hidden, plan, made.driver, noise, made.lost)
        off.append(np.sqrt(((again.reports - made.drive.reports) ** 2).mean(axis=0)))
    tracked = [INS_SPEED, INS_YAW]
    units = scale[[ROWS.index(one) for one in tracked]]
    first, last = (float(np.sqrt(((one[tracked] / units) ** 2).mean())) for one in off)
    away = [np.hypot(one[list(ROWS)], scale) for one in off]  # noise and all that nobody can do better count in both
    rows = [k for k, one in enumerate(ROWS) if one != HEADING]  # a heading runs away with the smallest difference
    return {"replay_down": 1.0 - last / first, "replay_worst": float((away[1] / away[0])[rows].max()) - 1.0}


def compare_all(run: Run, exam: Exam, cases: Sequence[Marked], logs: int = LOGS) -> None:
    """Compare for the first so many detectable one-effect logs that are answered, as far as it is not done."""
    for one in chosen(cases, logs):
        path = _kept(run, one.number)
        if not path.is_file():
            found = compare(exam, one.truth, one.answer)
            write_json(path, found._asdict())
            print(f"beside a network: {one.number}, {found.name_same:.2f} and {found.net_same:.2f}", file=sys.stderr)


def chosen(cases: Sequence[Marked], logs: int = LOGS) -> list[Marked]:
    """Which they are: by their seeds, which have nothing to do with answers."""
    of = [one for one in cases if one.truth["row"] == "one" and detectable(one)]
    return sorted(of, key=lambda one: one.truth["seed"])[:logs]


def row_of(pairs: Sequence[tuple[Run, Marked]]) -> Row | None:
    """The row of the table, over cases of one run or several; None where nothing was compared."""
    done = [(run, one) for run, one in pairs if one.truth["row"] == "one" and _kept(run, one.number).is_file()]
    if not done:
        return None
    found = [Beside(**read_json(_kept(run, one.number))) for run, one in done]
    figures = {name: quantile([getattr(one, name) for one in found], 0.5) for name in Beside._fields}
    figures["replay_worst"] = quantile([one.replay_worst for one in found], 1.0)
    figures["name_over_net_same"] = quantile([one.name_same / max(one.net_same, LEAST) for one in found], 0.5)
    figures["name_beats_net_other"] = share(sum(one.name_other > one.net_other for one in found), len(found))
    return row(ROW, [one for _, one in done])._replace(figures=figures)


def _kept(run: Run, number: int) -> Path:
    return run.folder / "beside" / f"{number:04d}.json"
