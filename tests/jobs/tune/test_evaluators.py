"""What scores a candidate: lost nodes, discarded real-time drives, batches; with stand-ins for benches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import tunefree_alone
from tunefree_hil.base.errors import BenchError, NotValid, PeerGone
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.episode.candump import LogFrame, write_candump
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.score import ScenarioGrade, combine_scores
from tunefree_hil.jobs.run_folder import RunFolder, open_run
from tunefree_hil.jobs.running.episode_results import EpisodeResult
from tunefree_hil.jobs.running.lateness import frame_lateness_s, judge_realtime
from tunefree_hil.jobs.running.trial_driver import DriveJob, TrialDriver
from tunefree_hil.jobs.tune.evaluators import MAX_REPEATS, BatchEvaluator, BusEvaluator, RealtimeDriver, VectorCandidate

SCENARIOS = ("tiny", "other")
Answer = Callable[[DriveJob], EpisodeResult | BenchError]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return load(write_bench(tmp_path, scenarios=SCENARIOS))


def graded(name: str, score: float) -> ScenarioGrade:
    return ScenarioGrade(name, score, {}, 0, "finished", 100)


def episode(name: str, score: float) -> EpisodeResult:
    return EpisodeResult(cast(Recording, None), graded(name, score), "hash", {})


class FakeDriver:
    """Answers each job; `lateness_s` is what the nodes then say of that drive."""

    def __init__(self, bench: Bench, folder: Path, answer: Answer, lateness_s: Sequence[float] = ()) -> None:
        self.bench, self.answer = bench, answer
        self.run = RunFolder(folder, {})
        self.lateness_s = list(lateness_s)
        self.driven: list[int] = []
        self.pace: dict[str, float] = {}

    def drive_jobs(self, jobs: Sequence[DriveJob], *, go_on: bool = False) -> dict[int, EpisodeResult | BenchError]:
        for job in jobs:
            self.driven.append(job.k)
            late_s = self.lateness_s.pop(0) if self.lateness_s else 0.0
            times = {f"{role}_late_s": np.array([0.0, late_s]) for role in ("ecu", "controller")}
            np.savez(self.run.episode(job.k) / "timing.npz", allow_pickle=False, **times)
        return {job.k: self.answer(job) for job in jobs}


def good(job: DriveJob) -> EpisodeResult | BenchError:
    return episode(job.scenario.name, 0.1 + job.values["lqr.q1"])


def candidates(bench: Bench, *q1: float, first: int = 3) -> list[VectorCandidate]:
    return [VectorCandidate(first + i, parameters_of(bench, {"lqr.q1": one})) for i, one in enumerate(q1)]


def over_bus(driver: FakeDriver, realtime: RealtimeDriver | None = None) -> BusEvaluator:
    scenarios = [driver.bench.scenarios[name] for name in SCENARIOS]
    return BusEvaluator(cast(TrialDriver, driver), scenarios, batch_size=2, realtime=realtime)


def in_real_time(driver: FakeDriver, repeats: int = 0) -> tuple[BusEvaluator, RealtimeDriver]:
    realtime = RealtimeDriver(cast(TrialDriver, driver), repeats=repeats)
    return over_bus(driver, realtime), realtime


def test_candidates_are_driven_under_numbers_of_their_own(bench: Bench, tmp_path: Path) -> None:
    track = FakeDriver(bench, tmp_path, good)
    found = over_bus(track).evaluate(candidates(bench, 0.25, 0.5))
    assert track.driven == [6, 7, 8, 9]
    assert [one.score for one in found] == pytest.approx([0.35, 0.6])
    assert list(found[0].scenarios) == list(SCENARIOS)


def test_a_lost_node_costs_its_own_candidate_only(bench: Bench, tmp_path: Path) -> None:
    track = FakeDriver(bench, tmp_path, lambda job: PeerGone("ecu") if job.k == 8 else good(job))
    evaluator = over_bus(track)
    lost = evaluator.evaluate(candidates(bench, 0.25, 0.5))
    assert [bool(one.error) for one in lost] == [False, True] and "ecu is gone" in lost[1].error
    with pytest.raises(PeerGone):
        evaluator.evaluate(candidates(bench, 0.5, first=4))


def test_a_drive_that_was_late_is_repeated_and_counted(bench: Bench, tmp_path: Path) -> None:
    track = FakeDriver(bench, tmp_path, good, lateness_s=[0.0, 0.020, 0.020, 0.0])
    evaluator, realtime = in_real_time(track)
    (found,) = evaluator.evaluate(candidates(bench, 0.25))
    assert track.driven == [6, 7, 7, 7]
    assert (realtime.drives, realtime.repeats, evaluator.pace["discarded"]) == (4, 2, 2)
    assert found.score == pytest.approx(0.35)


def test_late_frames_may_look_like_a_fault_of_the_vehicle(bench: Bench, tmp_path: Path) -> None:
    answers = {7: [BenchError("other: a fault", code="bywire_fault")]}

    def answer(job: DriveJob) -> EpisodeResult | BenchError:
        return answers[job.k].pop() if answers.get(job.k) else good(job)

    evaluator, realtime = in_real_time(FakeDriver(bench, tmp_path, answer, lateness_s=[0.0, 0.3, 0.0]))
    assert evaluator.evaluate(candidates(bench, 0.25))[0].error == "" and realtime.repeats == 1
    steady, _ = in_real_time(FakeDriver(bench, tmp_path, lambda _: PeerGone("ecu"), lateness_s=[0.3, 0.3]))
    with pytest.raises(PeerGone):
        steady.evaluate(candidates(bench, 0.25))


def test_a_machine_that_is_never_in_time_ends_it_with_the_count(bench: Bench, tmp_path: Path) -> None:
    evaluator, _ = in_real_time(FakeDriver(bench, tmp_path, good, lateness_s=[0.02] * 99), repeats=4)
    with pytest.raises(NotValid) as caught:
        evaluator.evaluate(candidates(bench, 0.25))
    drives = 2 * (1 + MAX_REPEATS)
    assert f"{drives} of {drives} drives were discarded" in caught.value.message
    assert caught.value.exit_status == 4


def test_frames_that_a_hub_delivers_late_are_no_real_time(bench: Bench, tmp_path: Path) -> None:
    """The nodes keep their time, the frames between them do not."""
    run = RunFolder(tmp_path, {})
    message = bench.codec.commands[0]
    for k, late_s in enumerate((0.001, 0.030)):
        stamps = [50.0 + n * message.period_ticks * bench.dt_s + (late_s if n == 5 else 0.0) for n in range(400)]
        stamps[0] -= 0.2  # what is due at tick 0 is sent as soon as the drive is announced
        frames = [LogFrame(stamp, "can0", message.key, bytes(8)) for stamp in stamps]
        write_candump(run.episode(k) / "vehicle.log", frames)
        assert frame_lateness_s(run, [k], bench.codec).max() == pytest.approx(late_s, abs=1e-5)
        times = {f"{role}_late_s": np.zeros(400) for role in ("ecu", "controller")}
        np.savez(run.episode(k) / "timing.npz", allow_pickle=False, **times)
        assert judge_realtime(run, [k], draw=False)["valid"]
        assert judge_realtime(run, [k], bench.codec, draw=False)["valid"] == (k == 0)


@pytest.mark.slow
def test_frames_of_a_real_bench_lie_on_its_ticks(tmp_path: Path) -> None:
    """Most of them, however busy this machine is: otherwise no drive of `tune --realtime` would ever count."""
    done = tunefree_alone("drive", write_bench(tmp_path), "--realtime", "--json", "--out", tmp_path, within_s=15.0)
    assert done.status in (0, 4), done.words
    run = open_run(Path(done.data["run"]))
    late_s = frame_lateness_s(run, [0], load(tmp_path / "b.toml").codec)
    assert len(late_s) > 1000 and np.median(late_s) < 0.1


class FakeBatch:
    def __init__(self, error: str = "") -> None:
        self.jobs: list[Job] = []
        self.error = error

    def drive(self, jobs: Sequence[Job]) -> list[Driven]:
        self.jobs += jobs
        return [Driven(graded(job.scenario.name, 0.1 + job.values["lqr.q1"]), 100, self.error) for job in jobs]


def in_batch(bench: Bench, batch: FakeBatch) -> BatchEvaluator:
    return BatchEvaluator(cast(Batch, batch), bench, [bench.scenarios[name] for name in SCENARIOS], batch_size=8)


def test_a_batch_drives_all_scenarios_of_all_candidates(bench: Bench) -> None:
    batch = FakeBatch()
    found = in_batch(bench, batch).evaluate(candidates(bench, 0.25, 0.5, 1.0))
    assert [job.scenario.name for job in batch.jobs] == list(SCENARIOS) * 3
    assert [one.score for one in found] == [
        combine_scores([graded(name, 0.1 + job.values["lqr.q1"]) for name in SCENARIOS]) for job in batch.jobs[::2]
    ]


@pytest.mark.parametrize("error", ["diverged", "left_lane", "bywire_fault"])
def test_a_batch_tells_failing_drives_from_failing_benches(bench: Bench, error: str) -> None:
    evaluator = in_batch(bench, FakeBatch(error))
    if error == "bywire_fault":
        with pytest.raises(BenchError, match="by-wire channel reported a fault"):
            evaluator.evaluate(candidates(bench, 0.25))
    else:
        assert evaluator.evaluate(candidates(bench, 0.25))[0].error == ""
