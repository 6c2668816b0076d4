"""A training brings the held-out error down, can be cut off anywhere, and stops where numbers go wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.learn.training.made import REST, physics, track  # noqa: E402
from tunefree_hil.base.errors import InputError  # noqa: E402
from tunefree_hil.learn.evaluation.motion import MotionTrack  # noqa: E402
from tunefree_hil.learn.training import loop  # noqa: E402
from tunefree_hil.learn.training.fit import (  # noqa: E402
    DEFAULT_STEPS,
    TrackSplit,
    estimate_affordable_steps,
    make_learner,
    train_plant,
)
from tunefree_hil.learn.training.learners import TrainingPlan  # noqa: E402
from tunefree_hil.learn.training.loop import TrainingResult, read_planned_steps, run_training, schedule_evaluations  # noqa: E402
from tunefree_hil.learn.training.windows import draw_rows, find_window_starts, make_pool  # noqa: E402


def ended(steps) -> TrainingResult:  # type: ignore[no-untyped-def]
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


class Bowl:
    """A learner whose loss is a bowl: quick, and with a minimum that is known."""

    def __init__(self, spoilt_at: int = -1) -> None:
        self.net = torch.nn.Linear(2, 1, bias=False, dtype=torch.float64)
        with torch.no_grad():
            self.net.weight[:] = torch.tensor([[1.6, 0.5]])
        self.spoilt_at = spoilt_at

    def loss(self, step: int) -> torch.Tensor:
        target = torch.tensor(np.random.default_rng([1, step]).normal(1.0, 0.1, 2))
        spoilt = torch.nan if step == self.spoilt_at else 0.0
        return ((self.net.weight[0] - target) ** 2).sum() + spoilt

    def score(self) -> float:
        return float(((self.net.weight[0] - 1.0) ** 2).sum().detach())

    def cost(self, step: int) -> float:
        return 1.0

    def rate_share(self, step: int) -> float:
        return 1.0 - step / 200.0

    def arrays(self) -> dict[str, np.ndarray]:
        return {"weight": self.net.weight.detach().numpy().copy()}


def test_a_training_that_was_cut_off_goes_on_to_the_same_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wish = TrainingPlan("hybrid", 1, 80)
    whole = ended(run_training(Bowl(), wish, 80))
    monkeypatch.setattr(loop, "CHECKPOINT_INTERVAL_S", 0.0)
    monkeypatch.setattr(loop, "PROGRESS_INTERVAL_S", 0.0)
    part = tmp_path / "model.part"
    cut = run_training(Bowl(), wish, 80, part, "these data")
    for _ in range(33):
        next(cut)
    cut.close()
    again = ended(run_training(Bowl(), wish, 80, part, "these data"))
    assert again.is_resumed and not whole.is_resumed
    assert np.array_equal(again.arrays["weight"], whole.arrays["weight"])
    assert again.evaluations == whole.evaluations and again.score == whole.score < 0.3


def cut_off_it_ends_the_same(
    wish: TrainingPlan, tracks: tuple[list[MotionTrack], list[MotionTrack]], part: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Train whole; train again, cut off after nine words of it and taken up from `part`; compare every weight."""
    whole = ended(train_plant(wish, TrackSplit(*tracks), physics(), REST, None))
    monkeypatch.setattr(loop, "CHECKPOINT_INTERVAL_S", 0.0)
    monkeypatch.setattr(loop, "PROGRESS_INTERVAL_S", 0.0)
    cut = train_plant(wish, TrackSplit(*tracks), physics(), REST, part)
    for _ in range(9):
        next(cut)
    cut.close()
    again = ended(train_plant(wish, TrackSplit(*tracks), physics(), REST, part))
    assert again.is_resumed and again.steps == whole.steps == wish.steps
    assert all(np.array_equal(again.arrays[name], whole.arrays[name]) for name in whole.arrays)


def test_a_net_that_was_cut_off_goes_on_to_the_same_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tracks, wish = ([track(1, 12.0)], [track(3, 12.0)]), TrainingPlan("mlp", 1, 20)
    cut_off_it_ends_the_same(wish, tracks, tmp_path / "part", monkeypatch)


def test_a_training_cut_off_before_its_first_step_keeps_the_steps_that_a_clock_gave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Cut(Bowl):
        def score(self) -> float:
            raise KeyboardInterrupt

    wish, part = TrainingPlan("hybrid", 1, minutes=2.0), tmp_path / "model.part"
    with pytest.raises(KeyboardInterrupt):
        ended(run_training(Cut(), wish, 77, part, "these data"))
    assert read_planned_steps(part, "these data", wish) == 77
    assert read_planned_steps(part, "other data", wish) == 0
    again, whole = ended(run_training(Bowl(), wish, 77, part, "these data")), ended(run_training(Bowl(), wish, 77))
    assert again.is_resumed and again.evaluations == whole.evaluations and again.total == 77
    assert np.array_equal(again.arrays["weight"], whole.arrays["weight"])


def test_a_checkpoint_of_other_data_is_not_taken_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "CHECKPOINT_INTERVAL_S", 0.0)
    part = tmp_path / "model.part"
    ended(run_training(Bowl(), TrainingPlan("hybrid", 1, 20), 20, part, "these data"))
    assert not ended(run_training(Bowl(), TrainingPlan("hybrid", 1, 20), 20, part, "other data")).is_resumed
    assert not ended(run_training(Bowl(), TrainingPlan("hybrid", 2, 20), 20, part, "other data")).is_resumed


def test_numbers_that_are_not_finite_end_it_with_the_best_so_far() -> None:
    wish = TrainingPlan("hybrid", 1, 200)
    spoilt = ended(run_training(Bowl(spoilt_at=100), wish, 200))
    assert "not a finite number" in spoilt.stopped and spoilt.steps == 100
    assert np.isfinite(spoilt.arrays["weight"]).all()
    assert spoilt.score == min(score for _, score in spoilt.evaluations) < spoilt.untrained_score


def test_a_held_out_error_that_runs_away_ends_it() -> None:
    class Lost(Bowl):
        looked = 0

        def score(self) -> float:
            self.looked += 1
            return 1.0 if self.looked < 4 else 10.0 * self.looked

    lost = ended(run_training(Lost(), TrainingPlan("hybrid", 1, 200), 200))
    assert lost.stopped.startswith("it diverged") and lost.steps < 200 and lost.score == 1.0


def test_what_is_kept_is_a_mean_of_weights_and_training_goes_on_from_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    wish, learner = TrainingPlan("hybrid", 1, 300), Bowl()
    kept = ended(run_training(learner, wish, 300))
    monkeypatch.setattr(loop, "CRITERIA", loop.CRITERIA._replace(averaging_share=0.0))
    single = Bowl()
    alone = ended(run_training(single, wish, 300))
    assert kept.score != alone.score and max(kept.score, alone.score) < 0.01
    assert not np.array_equal(kept.arrays["weight"], alone.arrays["weight"])
    last = [some.evaluations[-1] for some in (kept, alone)]
    assert last[0][0] == last[1][0] == 300  # the same steps were taken, only what is looked at differs


def test_it_stops_where_it_gets_no_better_but_not_while_it_still_jumps_about() -> None:
    class Stuck(Bowl):
        def score(self) -> float:
            return 1.0

        def rate_share(self, step: int) -> float:
            return 1.0 if step < 200 else 0.3

    stuck = ended(run_training(Stuck(), TrainingPlan("hybrid", 1, 800), 800))
    assert stuck.stopped == "the held-out error gets no better"
    assert stuck.steps == 200 + loop.CRITERIA.patience * 800 // loop.CRITERIA.max_evaluations


@pytest.mark.slow
def test_a_hybrid_that_was_cut_off_in_its_guided_stage_goes_on_to_the_same_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracks, wish = ([track(1, 20.0)], [track(3, 8.0)]), TrainingPlan("hybrid", 1, 26, batch=8)
    cut_off_it_ends_the_same(wish, tracks, tmp_path / "part", monkeypatch)


def test_batches_depend_on_seed_and_step_alone() -> None:
    some = np.arange(1000)
    assert np.array_equal(draw_rows(some, 50, 1, 7), draw_rows(some, 50, 1, 7))
    assert not np.array_equal(draw_rows(some, 50, 1, 7), draw_rows(some, 50, 1, 8))
    assert len(draw_rows(np.arange(3), 50, 1, 1)) == 50


def test_windows_stay_within_what_is_good() -> None:
    own = track(1)
    good = own.is_good.copy()
    good[1000] = False
    pool = make_pool([own._replace(is_good=good)], physics(), REST)
    rows = find_window_starts(pool, 100, 100)
    assert len(rows) and not np.any((rows <= 1000) & (rows + 200 >= 1000))


class Timed(Bowl):
    """Steps that take so many seconds of this machine's time, by a clock that only they move on."""

    now = 0.0

    def __init__(self, monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
        super().__init__()
        self.seconds, self.steps = seconds, 0
        monkeypatch.setattr("tunefree_hil.learn.training.fit.time.process_time", lambda: self.now)

    def loss(self, step: int) -> torch.Tensor:
        self.now += self.seconds * self.cost(step)
        return super().loss(step)

    def cost(self, step: int) -> float:
        return 1.0 if step < 0.9 * self.steps else 11.0


def test_minutes_are_as_many_steps_as_this_machine_has_time_for(monkeypatch: pytest.MonkeyPatch) -> None:
    quick, slow = (estimate_affordable_steps(Timed(monkeypatch, seconds), 2.0) for seconds in (0.01, 0.04))
    assert quick == 6000 and slow == 1500  # a tenth of the steps takes eleven times as long: 0.02 s each


def test_timing_changes_no_weight() -> None:
    pool = make_pool([track(1)], physics(), REST)
    learner, other = (make_learner(TrainingPlan("mlp", 1), pool, pool, physics()) for _ in range(2))
    steps = estimate_affordable_steps(learner, 0.1)
    assert steps > 10 and all(param.grad is None or not param.grad.any() for param in learner.net.parameters())
    assert np.array_equal(learner.arrays()["w1"], other.arrays()["w1"])


def test_a_checkpoint_remembers_how_many_steps_were_planned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "CHECKPOINT_INTERVAL_S", 0.0)
    part, wish = tmp_path / "part", TrainingPlan("hybrid", 1, minutes=3.0)
    assert read_planned_steps(part, "these data", wish) == 0
    ended(run_training(Bowl(), wish, 35, part, "these data"))
    assert read_planned_steps(part, "these data", wish) == 35
    assert (
        read_planned_steps(part, "other data", wish)
        == read_planned_steps(part, "these data", wish._replace(seed=2))
        == 0
    )


def test_looks_are_spread_over_the_work() -> None:
    some = sorted(schedule_evaluations([1.0] * 900 + [9.0] * 100))
    assert some[-1] == 1000 and len(some) <= loop.CRITERIA.max_evaluations + 1
    assert len([step for step in some if step <= 900]) == len(some) // 2
    assert schedule_evaluations([1.0] * 7) == {5, 7}


def test_every_kind_has_its_steps() -> None:
    assert set(DEFAULT_STEPS) == set(loop.LEARNING_RATES) and min(DEFAULT_STEPS.values()) > 100


def test_nothing_to_learn_from_is_said() -> None:
    with pytest.raises(InputError, match="no stretch to learn from"):
        ended(train_plant(TrainingPlan("hybrid", 1, 1), TrackSplit([], [track(1)]), physics(), REST, None))
    short = track(2)._replace(is_good=np.zeros(track(2).n_rows, dtype=bool))
    with pytest.raises(InputError, match="training drives hold no stretch"):
        ended(train_plant(TrainingPlan("hybrid", 1, 1), TrackSplit([short], [track(1)]), physics(), REST, None))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "share"), [("hybrid", 0.8), ("lstm", 0.9)])
def test_a_little_training_lowers_the_held_out_error(kind: str, share: float) -> None:
    wish = TrainingPlan(kind, 1, 10, batch=32)
    trained = ended(train_plant(wish, TrackSplit([track(1), track(2)], [track(3)]), physics(), REST, None))
    assert trained.stopped == "" and trained.score < share * trained.untrained_score


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "steps", "share"), [("mlp", 40, 0.8), ("paper", 16, 0.95)])
def test_one_step_training_lowers_the_held_out_error(kind: str, steps: int, share: float) -> None:
    trained = ended(
        train_plant(TrainingPlan(kind, 1, steps), TrackSplit([track(1), track(2)], [track(3)]), physics(), REST, None)
    )
    assert trained.score < share * trained.untrained_score


def test_a_seed_decides_the_net() -> None:
    pool = make_pool([track(1)], physics(), REST)
    nets = [make_learner(TrainingPlan("lstm", seed, 5), pool, pool, physics()).arrays() for seed in (1, 1, 2)]
    assert np.array_equal(nets[0]["w_in"], nets[1]["w_in"]) and not np.array_equal(nets[0]["w_in"], nets[2]["w_in"])
