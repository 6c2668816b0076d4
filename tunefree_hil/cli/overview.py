"""The overview that `tunefree-hil` prints without a command: the main jobs, one line each."""

from __future__ import annotations

from tunefree_hil import __version__

JOBS = (
    ("drive", "BENCH", "drive the scenarios of a bench file over the bus and score them"),
    ("learn", "LOGS", "learn the simulated vehicle from logs"),
    ("tune", "BENCH", "find the controller's parameters, and see why the winner wins"),
    ("gap", "LOG", "name what the simulation lacks, from a log"),
)


def overview() -> str:
    """At most 80 columns wide."""
    lines = [f"tunefree-hil {__version__}: a bench that tunes the controllers of a by-wire vehicle", ""]
    for name, argument, purpose in JOBS:
        lines.append(f"  {name:<6}{argument:<7}{purpose}")
    lines += ["", "  see the rest:  tunefree-hil --help      one of them:  tunefree-hil tune --help"]
    return "\n".join(lines)
