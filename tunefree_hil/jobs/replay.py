"""Replay: drive the episodes of a run again with the same inputs, and compare every frame."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, calibration_path, load, model_of
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.episode.compare import compare_logs
from tunefree_hil.episode.frame_hash import frame_hash
from tunefree_hil.jobs.drive import find_scenario, new_session_name
from tunefree_hil.jobs.identity import file_sha256, steering_map_hash, user_part_hashes
from tunefree_hil.jobs.options.records import ReplayOptions
from tunefree_hil.jobs.run_folder import RunFolder, open_run, read_json
from tunefree_hil.jobs.running.foreign import make_launch, program_hashes, require_foreign_controller
from tunefree_hil.jobs.running.session import BenchSession

EXIT_DIFFERENT = 1  # exit status
# Texts for keys of `hashes`
FILE_TEXTS = {"calibration": "open-loop map", "steering_map": "steering map", "parts": "user modules"}
SUMMARY_KEYS = ("frame_hash", "parameters", "scenario", "seed")


def replay(options: ReplayOptions) -> Iterator[Event]:
    """Check the logs of a run; with `verify` drive its episodes again. Exit 1 when one differs."""
    run, verify = options.run, options.verify
    folder = open_run(run)
    if folder.record.get("realtime"):
        message = "was driven in real time, which cannot be repeated bit for bit"
        raise InputError(message, file=str(run), hint="drive it in lockstep (without --realtime)")
    bench = load(folder.bench_file())
    numbers = _episode_numbers(folder, options.episode)
    differing: list[dict[str, Any]] = []
    if verify:
        checks = _redrive_episodes(folder, bench, numbers)
    else:
        checks = _recheck_logs(folder, bench, numbers)
    for done, (k, problem) in enumerate(checks, 1):
        if problem:
            differing.append({"episode": k, **problem})
            yield Event("warning", f"episode {k}: {problem['sentence']}")
        yield Event("progress", f"episode {k}", {"label": "episode", "done": done, "total": len(numbers)})
    action = "driven again" if verify else "checked"
    sentence = f"{len(numbers)} episodes {action}: " + (
        f"{len(differing)} differ, first: {differing[0]['sentence']}" if differing else "all frames equal"
    )
    data = {"differing": differing, "episodes": len(numbers), "exit": EXIT_DIFFERENT if differing else 0}
    yield Event("result", sentence, {"sentence": sentence, "run": str(run), "next": [], **data})


def _episode_numbers(folder: RunFolder, episode: int | None) -> list[int]:
    """Numbers of the episodes that have their log, or the given one."""
    if episode is not None:
        if not (folder.path / "episodes" / str(episode) / "episode.json").is_file():
            raise InputError(f"has no episode {episode}", file=str(folder.path), key="--episode")
        return [episode]
    numbers = folder.episodes_with("vehicle.log")
    if not numbers:
        hint = "it may have been interrupted during the first episode"
        raise InputError("has no finished episode with its log", file=str(folder.path), hint=hint)
    return numbers


def _read_summary(folder: RunFolder, k: int) -> dict[str, Any]:
    path = folder.path / "episodes" / str(k) / "episode.json"
    if not path.is_file():
        raise InputError("is missing: the episode was interrupted", file=str(path), hint="leave this episode out")
    stored = read_json(path)
    missing = [key for key in SUMMARY_KEYS if key not in stored]
    if missing:
        raise InputError("is missing", file=str(path), key=missing[0], hint="leave this episode out: --episode K")
    return stored


def _log_hash(bench: Bench, log: Path) -> str:
    commands = {message.key for message in bench.codec.commands}
    return frame_hash(read_candump(log), bench.dt_s, commands, bench.codec.by_id.keys()).hex


def _recheck_logs(folder: RunFolder, bench: Bench, numbers: list[int]) -> Iterator[tuple[int, dict[str, Any] | None]]:
    for k in numbers:
        stored = _read_summary(folder, k)["frame_hash"]
        current = _log_hash(bench, folder.path / "episodes" / str(k) / "vehicle.log")
        problem = None if current == stored else {"sentence": "the log is not the graded one (its hash differs)"}
        yield k, problem


def _redrive_episodes(
    folder: RunFolder, bench: Bench, numbers: list[int]
) -> Iterator[tuple[int, dict[str, Any] | None]]:
    model = folder.record.get("model") or bench.spec.model
    _require_same_files(folder, bench, model)
    require_foreign_controller(bench, _read_summary(folder, numbers[0])["parameters"], join=False)
    launch = make_launch(bench, model, session=f"{new_session_name()}-replay")
    with (
        tempfile.TemporaryDirectory(prefix="tunefree-replay-") as scratch,
        BenchSession(folder.path / "bench.toml", Path(scratch) / "nodes", launch) as session,
    ):
        for k in numbers:
            stored = _read_summary(folder, k)
            again = Path(scratch) / str(k)
            again.mkdir()
            scenario = find_scenario(bench, stored["scenario"])
            session.drive(scenario, stored["seed"], stored["parameters"], again)
            yield k, _find_difference(folder, bench, k, stored, again / "vehicle.log")


def _find_difference(
    folder: RunFolder, bench: Bench, k: int, stored: dict[str, Any], again: Path
) -> dict[str, Any] | None:
    """None where hash and log are equal to the stored ones, else the first differing tick, id and signal."""
    first = folder.path / "episodes" / str(k) / "vehicle.log"
    same_hash = _log_hash(bench, again) == stored["frame_hash"]
    if not first.is_file():
        text = "the frame hash differs (its log was not kept, so the position is not known)"
        return None if same_hash else {"sentence": text}
    difference = compare_logs(first, again, bench.codec, bench.dt_s)
    if difference is not None:
        changed = "; the stored hash is that of the second, so the stored log was changed" if same_hash else ""
        return {"sentence": difference.sentence() + changed, **difference._asdict()}
    if not same_hash:
        return {"sentence": "the stored hash differs although the logs agree: episode.json was changed"}
    return None


def _require_same_files(folder: RunFolder, bench: Bench, model: str) -> None:
    """Raise InputError where an input file of the run has changed."""
    stored = folder.record.get("hashes", {})
    current = {
        "vehicle": bench.vehicle.hash,
        "model": model_of(bench, model).hash,
        "scenarios": {name: find_scenario(bench, name).hash for name in stored.get("scenarios", {})},
        "calibration": file_sha256(calibration_path(bench)),
        "steering_map": steering_map_hash(bench),
        "controller": program_hashes(bench),
        "parts": user_part_hashes(bench, model),
    }
    changed = [key for key, value in current.items() if key in stored and stored[key] != value]
    if changed:
        raise InputError(
            f"the {' and the '.join(FILE_TEXTS.get(key, key) for key in changed)} changed since this run",
            code="changed",
            file=str(folder.path / "run.json"),
            key=f"hashes.{changed[0]}",
            hint="restore the files, or make a new run",
        )
