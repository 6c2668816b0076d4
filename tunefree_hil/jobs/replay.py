"""Replay: drive a run's episodes again from its bench file, parameters and seeds, and compare every frame."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, calibration_path, is_heavy, load, model_of
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.episode.compare import compare_logs
from tunefree_hil.episode.frame_hash import frame_hash
from tunefree_hil.jobs.drive import find_scenario, own_session
from tunefree_hil.jobs.identity import own_parts, sha256_of
from tunefree_hil.jobs.run_folder import RunFolder, open_run, read_json
from tunefree_hil.jobs.running.foreign import program_hashes, program_of, require_one
from tunefree_hil.jobs.running.session import Session

DIFFERS = 1  # exit status
SAID = {"calibration": "open-loop map", "parts": "modules of your own"}  # of `hashes`, where the key says too little
SUMMARY_KEYS = ("frame_hash", "parameters", "scenario", "seed")


def replay(run: Path, *, episode: int | None, verify: bool) -> Iterator[Event]:
    """Read a run's logs again; with `verify` drive its episodes again. Exit 1 at the first difference of each."""
    folder = open_run(run)
    if folder.record.get("realtime"):
        raise InputError(
            "was driven in real time: wall time is part of it, so it cannot be driven again bit for bit",
            file=str(run),
            hint="drive it in lockstep (without --realtime)",
        )
    bench = load(folder.bench_file())
    numbers = _numbers(folder, episode)
    differing: list[dict[str, Any]] = []
    if verify:
        checks = _drive_again(folder, bench, numbers)
    else:
        checks = _read_again(folder, bench, numbers)
    for done, (k, problem) in enumerate(checks, 1):
        if problem:
            differing.append({"episode": k, **problem})
            yield Event("warning", f"episode {k}: {problem['sentence']}")
        yield Event("progress", f"episode {k}", {"label": "episode", "done": done, "total": len(numbers)})
    what = "driven again" if verify else "read again"
    sentence = f"{len(numbers)} episodes {what}: " + (
        f"{len(differing)} differ, first: {differing[0]['sentence']}" if differing else "all frames equal"
    )
    data = {"differing": differing, "episodes": len(numbers), "exit": DIFFERS if differing else 0}
    yield Event("result", sentence, {"sentence": sentence, "run": str(run), "next": [], **data})


def _numbers(folder: RunFolder, episode: int | None) -> list[int]:
    """Episodes that have their log, or the one asked for."""
    if episode is not None:
        if not (folder.path / "episodes" / str(episode) / "episode.json").is_file():
            raise InputError(f"has no episode {episode}", file=str(folder.path), key="--episode")
        return [episode]
    found = folder.numbered("vehicle.log")
    if not found:
        raise InputError(
            "has no finished episode with its log", file=str(folder.path), hint="was it cut off before the first one?"
        )
    return found


def _summary(folder: RunFolder, k: int) -> dict[str, Any]:
    path = folder.path / "episodes" / str(k) / "episode.json"
    if not path.is_file():
        raise InputError("is not there: the episode was cut off", file=str(path), hint="leave this episode out")
    stored = read_json(path)
    missing = [key for key in SUMMARY_KEYS if key not in stored]
    if missing:
        raise InputError("is not there", file=str(path), key=missing[0], hint="leave this episode out: --episode K")
    return stored


def _hash(bench: Bench, log: Path) -> str:
    commands = {message.key for message in bench.codec.commands}
    return frame_hash(read_candump(log), bench.dt_s, commands, bench.codec.by_id.keys()).hex


def _read_again(folder: RunFolder, bench: Bench, numbers: list[int]) -> Iterator[tuple[int, dict[str, Any] | None]]:
    for k in numbers:
        stored = _summary(folder, k)["frame_hash"]
        found = _hash(bench, folder.path / "episodes" / str(k) / "vehicle.log")
        problem = None if found == stored else {"sentence": "the log is not the one that was graded (its hash differs)"}
        yield k, problem


def _drive_again(folder: RunFolder, bench: Bench, numbers: list[int]) -> Iterator[tuple[int, dict[str, Any] | None]]:
    model = folder.record.get("model") or bench.spec.model
    _require_same_files(folder, bench, model)
    require_one(bench, _summary(folder, numbers[0])["parameters"], join=False)
    with (
        tempfile.TemporaryDirectory(prefix="tunefree-replay-") as scratch,
        Session(
            folder.path / "bench.toml",
            Path(scratch) / "nodes",
            session=f"{own_session()}-replay",
            model=model,
            jitted_ecu=is_heavy(bench, model),
            controller_command=program_of(bench),
        ) as session,
    ):
        for k in numbers:
            stored = _summary(folder, k)
            again = Path(scratch) / str(k)
            again.mkdir()
            scenario = find_scenario(bench, stored["scenario"])
            session.drive(scenario, stored["seed"], stored["parameters"], again)
            yield k, _difference(folder, bench, k, stored, again / "vehicle.log")


def _difference(folder: RunFolder, bench: Bench, k: int, stored: dict[str, Any], again: Path) -> dict[str, Any] | None:
    """None where hash and log are the stored ones, else the first differing tick, id and signal with both values."""
    first = folder.path / "episodes" / str(k) / "vehicle.log"
    same_hash = _hash(bench, again) == stored["frame_hash"]
    if not first.is_file():
        words = "the frame hash differs (its log was not kept, so where cannot be said)"
        return None if same_hash else {"sentence": words}
    found = compare_logs(first, again, bench.codec, bench.dt_s)
    if found is not None:
        changed = "; the stored hash is that of the second, so the stored log was changed" if same_hash else ""
        return {"sentence": found.sentence() + changed, **found._asdict()}
    if not same_hash:
        return {"sentence": "the stored hash differs although the logs agree: episode.json was changed"}
    return None


def _require_same_files(folder: RunFolder, bench: Bench, model: str) -> None:
    """Raise InputError where a file that the run was made with has changed."""
    stored = folder.record.get("hashes", {})
    now = {
        "vehicle": bench.vehicle.hash,
        "model": model_of(bench, model).hash,
        "scenarios": {name: find_scenario(bench, name).hash for name in stored.get("scenarios", {})},
        "calibration": sha256_of(calibration_path(bench)),
        "controller": program_hashes(bench),
        "parts": own_parts(bench, model),
    }
    changed = [key for key, value in now.items() if key in stored and stored[key] != value]
    if changed:
        raise InputError(
            f"the {' and the '.join(SAID.get(key, key) for key in changed)} changed since this run was made",
            code="changed",
            file=str(folder.path / "run.json"),
            key=f"hashes.{changed[0]}",
            hint="bring the files back, or make a new run",
        )
