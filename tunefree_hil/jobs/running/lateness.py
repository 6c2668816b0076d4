"""Was it real time? The verdict over the nodes' cycle times, and the histogram (can_hil_anchors C4)."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import numpy as np

from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.schema import FaultSpec
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.trial_driver import ROLES

LATE_S = 0.002
LATE_SHARE = 0.001
NEVER_LATER_S = 0.005


def judge_realtime(
    run: RunFolder,
    episodes: Iterable[int],
    codec: Codec | None = None,
    *,
    draw: bool = True,
    faults: Iterable[FaultSpec] = (),
) -> dict[str, Any]:
    """Real time means: fewer than 0.1 % of the ticks over 2 ms late and none over 5 ms, in either node.

    codec: the same of the frames between them, which a slow hub delivers late to nodes that keep their time. faults: on
    a script, whose messages come as they please.
    draw=False leaves out the histogram. A controller of the user's own says nothing of its cycles: the others count.
    """
    numbers = list(episodes)
    late = {role: _late_s(run, role, numbers) for role in ROLES}
    if codec is not None:
        late["bus"] = frames_late_s(run, numbers, codec, {fault.message for fault in faults})
    known = {role: values for role, values in late.items() if len(values)}
    nodes = {
        role: {
            "p50_ms": 1e3 * float(np.percentile(values, 50)),
            "p99_ms": 1e3 * float(np.percentile(values, 99)),
            "p999_ms": 1e3 * float(np.percentile(values, 99.9)),
            "max_ms": 1e3 * float(values.max()),
            "late_share": float(np.mean(values > LATE_S)),
            "ticks": len(values),
        }
        for role, values in known.items()
    }
    valid = bool(nodes) and all(
        node["late_share"] < LATE_SHARE and node["max_ms"] <= 1e3 * NEVER_LATER_S for node in nodes.values()
    )
    figure = ""
    if known and draw:
        from tunefree_hil.figures.jitter import write_jitter

        figure = str(
            write_jitter(
                run.figures() / "jitter.png", {role: list(map(float, rows)) for role, rows in known.items()}, LATE_S
            )
        )
    worst = max((node["max_ms"] for node in nodes.values()), default=float("nan"))
    words = "it was real time" if valid else "NOT real time, do not use the score"
    return {"valid": valid, "nodes": nodes, "figure": figure, "sentence": f"{words} (worst tick {worst:.1f} ms late)"}


def frames_late_s(run: RunFolder, episodes: Iterable[int], codec: Codec, disturbed: Collection[str] = ()) -> np.ndarray:
    """How much later than the earliest of its id, counted in periods, each frame of the logs was stamped.

    A frame that was lost makes all later ones of its id late by a period: `disturbed` messages, that a script drops or
    doubles, are left out. The first of an id does not count: what is
    due at tick 0 is sent when RUN comes, the lead before the common zero.
    """
    rows = []
    for k in episodes:
        path = run.episode(k) / "vehicle.log"
        stamps: dict[int, list[float]] = {}
        for frame in read_candump(path) if path.is_file() else ():
            stamps.setdefault(frame.can_id, []).append(frame.time_s)
        for message in (*codec.commands, *codec.telemetry):
            if message.name not in disturbed and len(stamps.get(message.key, ())) > 1:
                found = np.array(stamps[message.key][1:])
                found -= np.arange(len(found)) * message.period_ticks * codec.tick_ms * 1e-3
                rows.append(found - found.min())
    return np.concatenate(rows) if rows else np.zeros(0)


def _late_s(run: RunFolder, role: str, episodes: Iterable[int]) -> np.ndarray:
    rows = []
    for k in episodes:
        path = run.episode(k) / "timing.npz"
        if path.is_file():
            with np.load(path) as data:
                if f"{role}_late_s" in data:
                    rows.append(data[f"{role}_late_s"])
    return np.concatenate(rows) if rows else np.zeros(0)
