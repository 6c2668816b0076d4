"""Fig. 4: the data of the open-loop map (a), and the map that was learned from them, braking (b)."""

from __future__ import annotations

import numpy as np

from tools.reproduction import models
from tools.reproduction.context import COMPLETE_BENCH, Context
from tools.reproduction.figures.open_loop import draw_open_loop
from tools.reproduction.records import Claim, Method, Record, Value
from tunefree_hil.jobs.learn.map import make_picture
from tunefree_hil.learn.compiled_process import exhaust
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.learn.open_loop_map.build import GatheredSamples, LearnedMap, gather_samples, learn_map
from tunefree_hil.learn.open_loop_map.samples import PEDALS
from tunefree_hil.learn.open_loop_map.table import SUPPORTED, is_monotone

NAME = "fig4"


def learn(context: Context) -> tuple[LearnedMap, GatheredSamples]:
    """The map of the collected logs and its samples."""
    bench = models.load_bench_of_data()
    with context.progress.relay_lines("collection"):
        drives = read_drives(models.collect_logs(context), bench.codec)
    context.progress.update(0.3, "logs read")
    gathered = gather_samples(drives, bench.vehicle)
    return exhaust(learn_map(gathered.samples, bench.vehicle, context.seed)), gathered


def reproduce(context: Context) -> Record:
    """Learn the map, draw its data and its braking half."""
    chart, gathered = learn(context)
    figure = draw_open_loop(make_picture(chart, gathered))
    held_out = {pedal: chart.selections[pedal].held_out_mps2 for pedal in PEDALS}
    minutes = models.minutes_driven(models.collect_logs(context))
    backed = float(np.mean(chart.grid.support == SUPPORTED))
    return Record(
        name=NAME,
        title="Open-loop mapping: data and braking surface",
        paper="Fig. 4: (a) the collected raw data, speed over command with the acceleration as colour; (b) the learned "
        "mapping, braking, as a surface. Pictures without numbers; the text says about two hours instead of days.",
        claim=Claim(
            "The learned mapping is monotone: more brake never means less deceleration.", is_monotone(chart.table)
        ),
        values=(
            Value("samples used", len(gathered.samples.speed_mps)),
            Value("driving that was collected", minutes, "min", "data collection and training about 120 min"),
            *(Value(f"error on held-out cells, {pedal}", error, "m/s2") for pedal, error in held_out.items()),
            Value("share of the map with data under it", 100.0 * backed, "percent"),
        ),
        method=Method(
            f"{COMPLETE_BENCH}, driven on its verify model",
            f"{len(models.collect_logs(context))} logs",
            f"nets {context.seed}",
            "Guided collection on the bus; nets of 3 to 16 sigmoid units for each pedal, the width chosen on "
            "cells that were held out.",
        ),
        difference="The data are from a simulated reference vehicle and from a planner that drives every cell, so they "
        "cover the plane more evenly than the paper's.",
        figures=(context.save(figure, NAME),),
        detail={"hidden_units": {pedal: chart.selections[pedal].width for pedal in PEDALS}},
    )
