#!/usr/bin/env python3
"""`tools/precompile.py BENCH...`: compiles now what `tune` and `verify` of a bench would wait for at their first time.

What is compiled: the ECU of the verify model where a tick of it is heavy, the batch of each model, and the batch that
drives the margins. Each is one short use of the real thing, in a process of its own; the machine code stays in the
user's cache folder (base/kernel_cache.py). Nothing depends on it but the wait.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tunefree_hil.base.errors import TunefreeError  # noqa: E402
from tunefree_hil.bench import is_heavy, load, parameters_of  # noqa: E402
from tunefree_hil.bench.batch import Batch, Job  # noqa: E402
from tunefree_hil.jobs.tune.margins import EFFECTS, find_batch_obstacle  # noqa: E402

BATCH = "batch"


def main(benches: list[str]) -> int:
    """Compile for these bench files, two processes at a time. The first failure's status, or 0."""
    if benches[:1] == [f"--{BATCH}"]:
        return compile_batch(*benches[1:])
    if not benches:
        print((__doc__ or "").splitlines()[0], file=sys.stderr)
        return 2
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 2)) as pool, tempfile.TemporaryDirectory() as folder:
        try:
            uses = [words for bench in benches for words in uses_of(bench, folder)]
        except TunefreeError as error:
            print(error, file=sys.stderr)
            return 2
        return next((status for status in pool.map(_run, uses) if status), 0)


def uses_of(bench_file: str, folder: str) -> Iterator[list[str]]:
    """Command lines that use what is to be compiled, those that take longest first."""
    bench = load(bench_file)
    model, verify_model = bench.spec.model, bench.spec.verify_model
    if not find_batch_obstacle(bench):
        batches = [(verify_model, *EFFECTS)] if verify_model else []
        for words in [*batches, (model,)]:
            yield [str(Path(__file__).resolve()), f"--{BATCH}", bench_file, *words]
    for name in dict.fromkeys((verify_model, model)):
        if name and is_heavy(bench, name) and not bench.spec.controller.command:
            drive = ["-m", "tunefree_hil", "drive", bench_file, "--model", name, "--scenario", bench.spec.scenarios[0]]
            yield [*drive, "--plain", "--out", folder]


def compile_batch(bench_file: str, model: str, *effects: str) -> int:
    """Drive one scenario of a bench in a batch."""
    bench = load(bench_file)
    with Batch(bench, model, extra_effects=effects, threads=1) as batch:
        batch.drive([Job(parameters_of(bench, {}), bench.scenarios[bench.spec.scenarios[0]])])
    return 0


def _run(words: list[str]) -> int:
    done = subprocess.run([sys.executable, *words], cwd=Path.cwd(), capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stdout + done.stderr, file=sys.stderr)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
