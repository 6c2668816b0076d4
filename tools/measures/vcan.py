"""Our bench over a link of the kernel beside our bench over the hub, in one kernel: equal frames, and what they cost.

Where this machine's kernel has no CAN all of it runs in one that `tools/vcan_vm` emulates, some 20 times slower: the
factor between the two buses is then of that machine, and so are the round trips.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tools.measures._summary import machine, rounded, summary
from tunefree_hil.bus.kernel_link import kernel_has_can

VALUE = "frame hashes that differ between tfhub and vcan0 in one kernel (of the scenarios of the bench file)"
ROOT = Path(__file__).resolve().parents[2]
LEAN = ROOT / "tests" / "vcan" / "lean"
PART = "tools.measures._over_vcan"


def measure(
    bench: str = "tests/vcan/bench.toml",
    scenarios: int = 6,
    rounds: int = 2000,
    link: str = "vcan0",
    limit_s: int = 3600,
) -> dict[str, Any]:
    """The first `scenarios` of the bench file over both buses, one after the other; `rounds` round trips on `link`.

    n counts scenarios; value, low and high are the number of hashes that differ: there is no chance in it.
    """
    before = machine()
    found = _run(["--bench", str(Path(bench)), "--scenarios", str(scenarios), "--rounds", str(rounds), link], limit_s)
    differing = [name for name, drive in found["drives"].items() if len(set(drive["hashes"].values())) != 1]
    detail = {"machine": before, "emulated": not kernel_has_can(), "differing": differing, **found}
    answer = summary([float(len(differing))], "hashes", rounded(detail))
    return {**answer, "n": len(found["drives"])}


def _run(words: list[str], limit_s: int) -> dict[str, Any]:
    """What _over_vcan.py prints, here or in an emulated kernel."""
    command = [sys.executable, "-m", PART, *words]
    if not kernel_has_can():
        vm = [str(ROOT / "tools" / "vcan_vm"), "--timeout", str(limit_s), "--env", f"PYTHONPATH={LEAN}"]
        command = [*vm, "--env", "TUNEFREE_START_LIMIT_S=400", "--", *command]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{PART} ended with status {done.returncode}; what it said stands above")
    return json.loads(done.stdout.splitlines()[-1])
