"""What the nodes of a drive noticed of each other's frames, from the episode's timing.npz."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.nodes.reception import in_words

ROLES = ("ecu", "controller")
HEARD = "_heard_"


def heard_of(episode: Path) -> list[str]:
    """A line for each message with which something was wrong, by who heard it; empty where all was well.

    episode: folder of an episode. Without its timing.npz (a controller that is not ours keeps none) nothing is known.
    """
    file = episode / "timing.npz"
    if not file.is_file():
        return []
    with np.load(file, allow_pickle=False) as data:
        rows = {name: data[name].tolist() for name in data.files if HEARD in name}
    return [
        f"{role} heard {name.removeprefix(role + HEARD)}: {in_words(row)}"
        for role in ROLES
        for name, row in sorted(rows.items())
        if name.startswith(role + HEARD)
    ]
