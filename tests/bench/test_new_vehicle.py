"""A vehicle that is not the project's: folders of a user's own, beside a bench file of their own, and no Python."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.house import ROOT
from tools.make_calibration import calibrate, write
from tools.measures._in_process import InProcess
from tools.measures.faults import NOT_DETECTABLE, SILENT, rows_of
from tunefree_hil.bench import Bench, load, parameters_of, require_buildable
from tunefree_hil.jobs.doctor import check_bench_file, check_vehicle_folder
from tunefree_hil.jobs.machine import FAULT
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.nodes.controller import ControllerPart
from tunefree_hil.nodes.timing import CycleTimes


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("user") / "project"
    shutil.copytree(ROOT / "tests" / "bench" / "kart", folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)  # as a person would: names are looked for here
        write(calibrate("kart_nominal"), folder / "models" / "kart_nominal" / "calibration.npz")
    return load(folder / "kart.toml")


def test_the_doctor_finds_nothing(bench: Bench) -> None:
    found = [*check_bench_file(Path(bench.file)), *check_vehicle_folder(Path(bench.vehicle.folder))]
    assert [one for one in found if one.kind == FAULT] == []


def test_it_drives_with_gains_that_the_rules_give_it(bench: Bench) -> None:
    """Without a gear, a yaw rate or a lateral acceleration in its reports, on commands every 20 ms."""
    scenario = bench.scenarios["bend"]
    for values in (compute_baseline_vectors(bench)["rule_based"], parameters_of(bench)):
        require_buildable(bench, bench.spec.model, [scenario], values)
        graded, _ = InProcess(bench).grade(scenario, values)
        peak = graded.metrics["lateral_err_peak"]
        assert (graded.outcome, graded.replans) == ("finished", 0)
        assert peak is not None and 0.5 * peak < 0.3, "metres"


def test_none_of_its_bus_faults_is_silent(bench: Bench) -> None:
    rows = rows_of(bench, every=11)
    assert len(rows) > 10 and [row for row in rows if row.answer == SILENT] == []
    unseen = {row.where for row in rows if row.answer == NOT_DETECTABLE}
    assert unseen <= {"Status", "Pose", "Motion", "Drive"}, "the steering command alone has a CRC"


def test_its_clear_bit_that_lies_behind_four_bytes_is_sent(bench: Bench) -> None:
    """A short clear frame is what one vehicle takes; this one says nowhere that it does."""
    codec = bench.codec
    own = [one for one in codec.commands if one.clear]
    assert any(one.signals[one.clear].end_bit > 32 and not one.allow_truncated for one in own)
    part = ControllerPart(codec, {}, lambda *_: None, CycleTimes())  # type: ignore[arg-type, return-value]
    part.task = SimpleNamespace(dt_s=bench.dt_s)  # type: ignore[assignment]
    for message, frame in zip(own, part._clear_frames(0), strict=True):
        assert len(frame.data) == message.length and codec.decode(message, frame.data)[message.clear] == 1.0
