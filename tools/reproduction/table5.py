"""Table V: how long the searches take."""

from __future__ import annotations

from tools.measures import table5
from tools.reproduction.context import COMPLETE_BENCH, Context
from tools.reproduction.records import Claim, Method, Record, Value

NAME = "table5"
QUICK_SCENARIOS = ("side_pass", "right_turn")


def sizes(context: Context) -> table5.Sizes:
    """What this run measures."""
    if context.is_quick:
        return table5.Sizes(bus_trials=2, batch_share=0.02, scenarios=QUICK_SCENARIOS)
    return table5.Sizes(bus_trials=0) if context.is_full else table5.Sizes()


def time_setups(context: Context) -> list[table5.SetupTimes]:
    """The three setups of the paper."""
    place = context.folders.work / NAME
    with context.progress.relay_lines("over the bus"):
        return table5.time_setups(COMPLETE_BENCH, place, sizes(context), context.seed, context.progress.tell)


def reproduce(context: Context) -> Record:
    """Minutes over the bus and in the batch, the paper's hours beside."""
    rows = time_setups(context)
    values = []
    for row in rows:
        name = f"{row.setup.parameters} parameters, {row.setup.trials} trials"
        paper = f"{row.setup.paper_minutes[0] / 60.0:g} to {row.setup.paper_minutes[1] / 60.0:g} h"
        how = f"{'from' if row.bus_trials < row.setup.trials else 'all of'} {row.bus_trials} trials"
        values.append(Value(f"{name}, over the bus ({how})", row.bus_minutes, "min", paper, row.bus_low, row.bus_high))
        values.append(Value(f"{name}, in the batch ({row.batch_trials} trials)", row.batch_minutes, "min", paper))
    faster = all(row.bus_minutes < row.setup.paper_minutes[0] for row in rows)
    manual = table5.MANUAL_HOURS * 60.0 / rows[-1].bus_minutes
    values.append(Value("manual tuning over ours over the bus, 11 parameters", manual, "times", "about 18 times"))
    return Record(
        name=NAME,
        title="Time of a search",
        paper="Table V: 2 parameters about 200 steps in 1 to 2 h, 6 about 400 in 3 to 4 h, 11 about 800 in 6 to 7 h, "
        "on a cluster; by hand 5 days, overall 120 h.",
        claim=Claim("Every search takes less time over the bus than the paper's, on two cores.", faster),
        values=tuple(values),
        method=Method(
            f"{COMPLETE_BENCH} with the set of each row",
            ", ".join(str(row.bus_trials) for row in rows) + " trials over the bus",
            f"search {context.seed}",
            "Over the bus as `tune` drives, side by side on both cores, extrapolated from the measured trials unless "
            "--full is given; in the batch the whole search with its sampler, compiled before.",
        ),
        difference="The paper runs its whole driving stack on 130 processors and waits for it; the bench drives seven "
        "short scenarios in simulated time. The manual tuning time is the paper's, not measured here.",
        detail={"rows": [row._asdict() for row in rows]},
    )
