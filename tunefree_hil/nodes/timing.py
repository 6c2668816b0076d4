"""Duration and lateness of each cycle. Kept apart from the recording: neither is hashed nor compared."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np


class CycleTimes:
    """Lateness and compute time by tick; written to `<folder>/timing-<role>.npz` where a folder is given."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.begin()

    def begin(self) -> None:
        """Start a new episode."""
        self.late_s: list[float] = []
        self.control_s: list[float] = []

    def note(self, late_s: float, control_s: float) -> None:
        """One tick: how late it began, how long it computed."""
        self.late_s.append(late_s)
        self.control_s.append(control_s)

    def save(
        self,
        role: str,
        counts_by_message: Mapping[str, Sequence[int]] | None = None,
        plan_counts: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        """Write under a temporary name, then rename.

        Args:
            role: Of the node.
            counts_by_message: See nodes/reception.py, as `heard_NAME`.
            plan_counts: Of the controller's optimisers by part (control/mpc/plan.py), as `plans_PART`.
        """
        if self.folder is None:
            return
        path = self.folder / f"timing-{role}.npz"
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            times = {"late_s": np.array(self.late_s), "control_time_s": np.array(self.control_s)}
            counts = {f"heard_{name}": np.array(row) for name, row in (counts_by_message or {}).items()}
            plans = {f"plans_{name}": np.array(row) for name, row in (plan_counts or {}).items()}
            np.savez(file, allow_pickle=False, **times, **counts, **plans)
        os.replace(part, path)
