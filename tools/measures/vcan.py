"""Our bench over a link of the kernel beside our bench over the hub, in one kernel: equal frames, and what they cost.

Where this machine's kernel has no CAN all of it runs in one that `tools/vcan_vm` emulates, some 20 times slower: paces,
round trips and the factors between the two buses are then of that machine. Cut off, it goes on: each scenario, driven
over both buses in one kernel, is kept as it comes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._ledger import CARRIERS, FOLDER, ROOT, Ledger, code_hash, meaning
from tools.measures._rig import standing
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import load
from tunefree_hil.bus.socketcan.kernel_link import kernel_has_can
from tunefree_hil.jobs.running.session import SLOW_VARIABLE

VALUE = "frame hashes that differ between tfhub and vcan0 in one kernel (of the scenarios of the bench file)"
LEAN = ROOT / "tests" / "vcan" / "lean"
PART = "tools.measures._over_vcan"
BUSES = ("tfhub", "vcan")
# Besides what a score depends on: the carriers, for it is they who are compared.
CARRYING = (CARRIERS, "jobs/running/session.py", "jobs/running/session_parts.py")
EMULATED = {"PYTHONPATH": str(LEAN), SLOW_VARIABLE: "600"}


def measure(
    bench: str = "tests/vcan/bench.toml",
    scenarios: int = 6,
    runs: int = 5,
    rounds: int = 2000,
    link: str = "vcan0",
    limit_s: int = 3600,
    folder: str = f"{FOLDER}/vcan",
) -> dict[str, Any]:
    """The first `scenarios` of the bench file over both buses in turn; `runs` of `rounds` round trips over each.

    n counts scenarios; value, low and high are the number of hashes that differ: there is no chance in it. The factors
    are vcan's time by tfhub's. limit_s: of an emulated machine.
    """
    before, loaded, ledger = machine(), load(bench), Ledger(Path(folder))
    names = loaded.spec.scenarios[:scenarios]
    emulated = not kernel_has_can()
    common = {"carriers": carriers_hash(), "link": link, "emulated": emulated}
    keys: dict[str, dict[str, Any]] = {
        name: {**standing(loaded, loaded.spec.model, [loaded.scenarios[name]]), **common} for name in names
    }
    trips = {**common, "code": code_hash(), "runs": runs, "rounds": rounds}
    missing = [name for name in names if ledger.find(keys[name]) is None]
    asked = ["--scenarios", ",".join(missing)] if missing else []
    if runs and ledger.find(trips) is None:
        asked += ["--runs", str(runs), "--rounds", str(rounds)]
    for line in _found([link, "--bench", str(Path(bench)), *asked], emulated, limit_s) if asked else ():
        if "scenario" in line:
            ledger.keep(keys[line["scenario"]], {**line["found"], "machine": before})
        else:
            ledger.keep(trips, {**line["round_trips_per_s"], "machine": before})
    drives = {name: ledger.find(keys[name]) for name in names}
    if lost := [name for name, drive in drives.items() if drive is None]:
        raise BenchError(f"{PART} ended without {', '.join(lost)}", code="incomplete", hint="call the measure again")
    return answer_of(drives, ledger.find(trips) if runs else None, emulated)


def answer_of(drives: Mapping[str, Any], trips: Mapping[str, Any] | None, emulated: bool) -> dict[str, Any]:
    """The measure's answer from what was kept: scenario -> drives over both buses; round trips a second by bus."""
    differing = [name for name, drive in drives.items() if len(set(drive["hashes"].values())) != 1]
    detail: dict[str, Any] = {
        "emulated": emulated,
        "differing": differing,
        "ticks_per_s": {bus: _middle([one["ticks"] / one["wall_s"][bus] for one in drives.values()]) for bus in BUSES},
        "factor_of_drives": _middle([one["wall_s"]["vcan"] / one["wall_s"]["tfhub"] for one in drives.values()]),
    }
    if trips:
        detail["round_trips_per_s"] = {bus: _middle(trips[bus]) for bus in BUSES}
        detail["factor_of_round_trips"] = _middle([a / b for a, b in zip(trips["tfhub"], trips["vcan"], strict=True)])
        detail["machine_of_round_trips"] = trips["machine"]
    detail["drives"] = dict(drives)
    return {**summary([float(len(differing))], "hashes", rounded(detail)), "n": len(drives)}


def _middle(values: Sequence[float]) -> dict[str, float]:
    """Median, least and most."""
    return {"median": float(np.median(values)), "low": min(values), "high": max(values), "n": len(values)}


@lru_cache(maxsize=1)
def carriers_hash() -> str:
    """SHA-256 over the code that carries frames; comments, docstrings and layout do not count."""
    package, digest = ROOT / "tunefree_hil", sha256()
    for name in CARRYING:
        for path in sorted((package / name).rglob("*.py")) or [package / name]:
            digest.update(path.relative_to(package).as_posix().encode())
            digest.update(meaning(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()


def _found(words: list[str], emulated: bool, limit_s: int) -> Iterator[dict[str, Any]]:
    """What _over_vcan.py says, as it comes, from here or from an emulated kernel. BenchError where it fails."""
    command, variables = [sys.executable, "-m", PART, *words], dict(os.environ)
    if emulated:
        handed = [word for name, value in EMULATED.items() for word in ("--env", f"{name}={value}")]
        command = [str(ROOT / "tools" / "vcan_vm"), "--timeout", str(limit_s), *handed, "--", *command]
        command = ["setpriv", "--pdeathsig", "TERM", *command]  # a machine whose measure was killed ends, too
    else:
        variables["PYTHONPATH"] = str(LEAN)
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=variables) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                yield json.loads(line)
        except BaseException:
            process.terminate()
            raise
    if process.returncode:
        said = f"{PART} ended with status {process.returncode}; what it said stands above"
        raise BenchError(said, code="over_vcan", hint="what it had found is kept: call the measure again")
