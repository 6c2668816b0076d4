"""How much memory the nodes take (docs/reference/design.md)."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from tools.measures._summary import rounded, summary
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession

VALUE = "MB, peak resident size of the largest node, the compiled ECU among them (median of sessions)"
LIMITS_MB = {"plain": 150.0, "compiled": 250.0}  # docs/reference/design.md


def measure(runs: int = 3, scenarios: str = "", bench: str = "bench_configs/mkz_steer.toml") -> dict[str, Any]:
    """`runs` sessions of each kind drive all scenarios of the bench file, then their nodes are looked at.

    plain: nominal plant, nothing compiled. compiled: reference plant, its ECU compiled. resident: after the last drive,
    where the peak may be of an instant (compiling).
    """
    loaded = load(bench)
    names = [name for name in loaded.spec.scenarios if not scenarios or name in scenarios.split(",")]
    plain = [_session_mb(loaded, loaded.spec.model, names, compiled=False) for _ in range(runs)]
    compiled = [_session_mb(loaded, loaded.spec.verify_model, names, compiled=True) for _ in range(runs)]
    uncompiled = [mb for session in plain for mb in session["peak"].values()]
    uncompiled += [mb for session in compiled for node, mb in session["peak"].items() if node != "ecu"]
    largest = {"plain": max(uncompiled), "compiled": max(session["peak"]["ecu"] for session in compiled)}
    detail = {
        "scenarios": names,
        loaded.spec.model: plain,
        loaded.spec.verify_model: compiled,
        "largest_plain_mb": largest["plain"],
        "largest_compiled_mb": largest["compiled"],
        "limits_mb": LIMITS_MB,
        "holds": {kind: largest[kind] <= limit for kind, limit in LIMITS_MB.items()},
    }
    each = [max([*one["peak"].values(), *other["peak"].values()]) for one, other in zip(plain, compiled, strict=True)]
    return summary(each, "MB", rounded(detail))


def _session_mb(bench: Bench, model: str, names: list[str], *, compiled: bool) -> dict[str, dict[str, float]]:
    """{peak, resident: node -> MB} after all these drives in one session."""
    with (
        tempfile.TemporaryDirectory() as folder,
        BenchSession(
            Path(bench.file),
            Path(folder) / "nodes",
            BenchLaunch(session=f"memory-{os.getpid()}", model=model, jitted_ecu=compiled),
        ) as session,
    ):
        for name in names:
            episode = Path(folder) / name
            episode.mkdir()
            scenario = bench.scenarios[name]
            session.drive(scenario, scenario.noise_seed, parameters_of(bench), episode)
        return {"peak": _sizes_mb(session, "VmHWM"), "resident": _sizes_mb(session, "VmRSS")}


def _sizes_mb(session: BenchSession, field: str) -> dict[str, float]:
    """Node -> MB; field: of /proc/PID/status, VmHWM for the peak, VmRSS for this moment."""
    sizes = {}
    for child in session.processes.children:
        status = Path(f"/proc/{child.process.pid}/status")
        lines = [line for line in status.read_text().splitlines() if line.startswith(field)]
        sizes[child.name] = float(lines[0].split()[1]) / 1024.0
    return sizes
