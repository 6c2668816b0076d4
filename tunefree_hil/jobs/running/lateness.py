"""Real-time check of a run: lateness of the nodes' cycles and of the frames, with a histogram."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.schema import FaultSpec
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.episode_results import ROLES


class RealTimeCriteria(NamedTuple):
    """Thresholds of real time (docs/reference/design.md)."""

    late_s: float = 0.002  # a tick later than this is late
    max_late_share: float = 0.001  # share of late ticks from which the run was not real time
    max_late_s: float = 0.005  # no tick may be later


CRITERIA = RealTimeCriteria()


def judge_realtime(
    run: RunFolder,
    episodes: Iterable[int],
    codec: Codec | None = None,
    *,
    draw: bool = True,
    faults: Iterable[FaultSpec] = (),
) -> dict[str, Any]:
    """Whether the episodes were real time: in each node fewer than 0.1 % of the ticks over 2 ms late, none over 5 ms.

    Args:
        codec: Also check the frames, which a slow hub delivers late; None to check the nodes only.
        draw: Write the histogram.
        faults: Faults on a script; their messages are not checked.

    Returns:
        Plain data: "valid", "nodes", "figure", "sentence". A foreign controller's cycle times are not known.
    """
    numbers = list(episodes)
    late = {role: _node_lateness_s(run, role, numbers) for role in ROLES}
    if codec is not None:
        late["bus"] = frame_lateness_s(run, numbers, codec, {fault.message for fault in faults})
    known = {role: values for role, values in late.items() if len(values)}
    nodes = {role: _statistics(values) for role, values in known.items()}
    valid = bool(nodes) and all(
        node["late_share"] < CRITERIA.max_late_share and node["max_ms"] <= 1e3 * CRITERIA.max_late_s
        for node in nodes.values()
    )
    figure = _draw_histogram(run, known) if known and draw else ""
    worst = max((node["max_ms"] for node in nodes.values()), default=float("nan"))
    text = "real time was kept" if valid else "NOT real time, do not use the score"
    return {"valid": valid, "nodes": nodes, "figure": figure, "sentence": f"{text} (worst tick {worst:.1f} ms late)"}


def _statistics(late_s: np.ndarray) -> dict[str, Any]:
    return {
        "p50_ms": 1e3 * float(np.percentile(late_s, 50)),
        "p99_ms": 1e3 * float(np.percentile(late_s, 99)),
        "p999_ms": 1e3 * float(np.percentile(late_s, 99.9)),
        "max_ms": 1e3 * float(late_s.max()),
        "late_share": float(np.mean(late_s > CRITERIA.late_s)),
        "ticks": len(late_s),
    }


def _draw_histogram(run: RunFolder, late_s: Mapping[str, np.ndarray]) -> str:
    from tunefree_hil.figures.jitter import draw_jitter
    from tunefree_hil.figures.style import save

    rows = {role: list(map(float, values)) for role, values in late_s.items()}
    return str(save(draw_jitter(rows, CRITERIA.late_s), run.figures() / "jitter.png"))


def frame_lateness_s(
    run: RunFolder, episodes: Iterable[int], codec: Codec, disturbed: Collection[str] = ()
) -> np.ndarray:
    """Lateness of each logged frame against the periodic schedule of its id, from the earliest frame.

    A lost frame makes all later frames of its id late by a period, so `disturbed` messages, which a script drops or
    duplicates, are left out. The first frame of an id does not count: the frames of tick 0 are sent when RUN comes,
    before the common zero.
    """
    rows = []
    for k in episodes:
        path = run.episode(k) / "vehicle.log"
        stamps: dict[int, list[float]] = {}
        for frame in read_candump(path) if path.is_file() else ():
            stamps.setdefault(frame.can_id, []).append(frame.time_s)
        for message in (*codec.commands, *codec.telemetry):
            if message.name not in disturbed and len(stamps.get(message.key, ())) > 1:
                times_s = np.array(stamps[message.key][1:])
                times_s -= np.arange(len(times_s)) * message.period_ticks * codec.tick_ms * 1e-3
                rows.append(times_s - times_s.min())
    return np.concatenate(rows) if rows else np.zeros(0)


def _node_lateness_s(run: RunFolder, role: str, episodes: Iterable[int]) -> np.ndarray:
    rows = []
    for k in episodes:
        path = run.episode(k) / "timing.npz"
        if path.is_file():
            with np.load(path) as data:
                if f"{role}_late_s" in data:
                    rows.append(data[f"{role}_late_s"])
    return np.concatenate(rows) if rows else np.zeros(0)
