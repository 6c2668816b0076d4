"""Fig. 3b: the heading that learned and rule-based plants predict, over time, against the measured one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tools.measures.figures.headings import HeadingRun, draw_headings
from tools.measures.freerun import heading_on, judged_on
from tools.reproduction import models
from tools.reproduction.context import COMPLETE_BENCH, Context
from tools.reproduction.records import Claim, Method, Record, Value
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.evaluation.free_run import FreeRunErrors, table_from_errors

NAME = "fig3b"
HORIZON = "10"  # s of free run; a key of the table of errors
DEGREES = 180.0 / np.pi
LABELS = {
    "lstm": "LSTM plant (kind lstm)",
    "rule_based": "rule-based plant",
    "mlp": "MLP plant",
    "paper": "LSTM of Table I as printed (kind paper)",
    "hybrid": "default plant (kind hybrid, shipped)",
    "physics": "fitted physics",
}


def reproduce(context: Context) -> Record:
    """Learn the plants, let all run freely on unseen drives, draw the drive that turns most."""
    with context.progress.relay_lines("learning"):
        return _reproduce(context)


def _reproduce(context: Context) -> Record:
    bench = models.load_bench_of_data()
    plants = {**models.learned_plants(context, bench), "hybrid": models.default_plant()}
    context.progress.update(0.8, "plants learned")
    tracks = models.unseen_motion(context, bench)
    with CompiledProcess() as worker:
        errors = judged_on(worker, plants, bench, tracks, models.data_size(context).every_s)
        heading = heading_on(worker, plants, bench, tracks)
    picture = draw_headings(heading._replace(title=f"{heading.title}; free run from 0 s"))
    size = models.data_size(context)
    means = mean_headings_deg(errors)
    return Record(
        name=NAME,
        title="Predicted heading angle of learned and rule-based plants",
        paper="Fig. 3b: heading predicted by the LSTM plant, the rule-based plant and an MLP beside the measured one, "
        "over time; the LSTM is nearest. A picture without numbers.",
        claim=Claim(
            "The LSTM plant predicts the heading better than the rule-based plant and the MLP.",
            means["lstm"] < min(means["rule_based"], means["mlp"]),
        ),
        values=tuple(_values(errors, context.seed)),
        method=Method(
            f"{COMPLETE_BENCH}, driven on its verify model",
            f"{_level_starts(errors)} free runs of 10 s on {len(tracks)} unseen drives",
            f"training {context.seed}",
            f"A guided collection of {models.minutes_driven(models.collect_logs(context)):.0f} minutes, "
            f"{size.minutes:g} minutes of training for each net, the same split for all; then free runs from measured "
            "starts on drives with other noise. Mean heading error at the end of 10 s; the picture is the unseen "
            "start that turns most.",
        ),
        difference="A simulated reference vehicle stands in for the road vehicle. The `lstm` plant gets the actuators' "
        "outputs and keeps its state; the network of Table I as printed gets commands over 20 samples (0.2 s), which "
        "is shorter than the steering's dead time and lag.",
        figures=(context.save(picture, NAME),),
        detail={"picture_error_deg": _picture_errors(heading), "mean_heading_error_deg": means},
    )


def mean_headings_deg(errors: Mapping[str, FreeRunErrors]) -> dict[str, float]:
    """Mean heading error after the horizon by kind, in degrees."""
    return {kind: DEGREES * _level(one, 1)[HORIZON]["heading_rad"]["mean"] for kind, one in errors.items()}


def _values(errors: Mapping[str, FreeRunErrors], seed: int) -> list[Value]:
    values = []
    for kind, label in LABELS.items():
        row = _level(errors[kind], seed)[HORIZON]
        heading, position = row["heading_rad"], row["position_m"]
        low, high = heading["low"], heading["high"]
        if low is not None and high is not None:
            low, high = DEGREES * low, DEGREES * high
        values.append(Value(f"{label}: heading error", DEGREES * heading["mean"], "deg", low=low, high=high))
        values.append(
            Value(f"{label}: position error", position["mean"], "m", low=position["low"], high=position["high"])
        )
    return values


def _level(errors: FreeRunErrors, seed: int) -> dict:
    return table_from_errors(errors, seed)["level"]


def _level_starts(errors: Mapping[str, FreeRunErrors]) -> int:
    return int(_level(errors["physics"], 1)["starts"])


def _picture_errors(heading: HeadingRun) -> dict[str, float]:
    """Mean heading error over the drive of the picture by kind, in degrees."""
    return {
        kind: float(DEGREES * np.abs(values - heading.truth).mean()) for kind, values in sorted(heading.kinds.items())
    }
