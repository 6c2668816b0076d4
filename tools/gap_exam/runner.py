"""Runs the examined program over an exam: a model where one is needed, then a question at a time, two side by side.

Whatever is cut off, kill -9 included, the same call goes on: only whole answers count, and an answer is whole when
run.json is there. The program is a command line; nothing of it is imported.
"""

from __future__ import annotations

import json
import shutil
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from tools.gap_exam.call import Done, call
from tools.gap_exam.cases import Case
from tools.gap_exam.files import Run, write_json
from tools.gap_exam.prepare import clear, model_logs, question, vehicle_folder
from tools.gap_exam.rows import Exam, Model


class Program(NamedTuple):
    """How the examined program is called. {log}, {vehicle}, {model}, {out}, {logs}, {physics} are put in."""

    gap: str = "tunefree-hil gap {log} --vehicle {vehicle} --model {model} --out {out} --json"
    calibrate: str = "tunefree-hil calibrate {logs} --vehicle {vehicle} --out {out} --json"
    learn: str = "tunefree-hil learn {logs} --vehicle {vehicle} --physics {physics} --out {out} --json"
    limit_s: float = 900.0
    learn_limit_s: float = 3600.0


class Examiner:
    """One run over one exam."""

    def __init__(self, run: Run, exam: Exam, program: Program, *, keep: bool = False) -> None:
        self.run, self.exam, self.program = run, exam, program
        self.keep = keep
        self._models: dict[str, threading.Lock] = {name: threading.Lock() for name in exam.models}
        self._loops = threading.Lock()  # our own loops one at a time: they hold the interpreter anyway
        self.seconds: list[float] = []

    def go(self, cases: Sequence[Case], parallel: int = 2) -> int:
        """Answer what has no answer yet; how many were answered now."""
        todo = [case for case in cases if not self.run.is_answered(case.number)]
        todo.sort(key=lambda case: (case.model, case.number))  # models in turn: both workers seldom wait for one
        self._total, self._begun = len(todo), time.monotonic()
        self._say(f"{len(cases) - len(todo)} of {len(cases)} are answered; {len(todo)} to go")
        with ThreadPoolExecutor(parallel) as pool:
            for _ in pool.map(self.one, todo):
                self._say(self.progress())
        return len(todo)

    def progress(self) -> str:
        done, took = len(self.seconds), time.monotonic() - self._begun
        left = (self._total - done) * took / max(done, 1)
        return f"{done}/{self._total} answered, {took / max(done, 1):.1f} s each, {left / 3600.0:.2f} h left"

    def one(self, case: Case) -> None:
        """One question, from its model to its answer."""
        model = self.run.model(case.model) if case.model else None
        if case.model:
            with self._models[case.model]:
                failed = self._make_model(self.exam.models[case.model])
            if failed is not None:
                self._answer(case, failed._replace(stderr=f"no model: {failed.stderr}"), None)
                return
        with self._loops:
            log, vehicle = question(self.run, self.exam, case)
        out = log.parent / "out"
        shutil.rmtree(out, ignore_errors=True)
        if model is None:
            model, failed = self._own_model(vehicle)
            if failed is not None:
                self._answer(case, failed._replace(stderr=f"no model: {failed.stderr}"), None)
                return
        done = call(
            self.program.gap, self.program.limit_s, log=str(log), vehicle=str(vehicle), model=str(model), out=str(out)
        )
        self._answer(case, done, out)

    def _answer(self, case: Case, done: Done, out: Path | None) -> None:
        folder = self.run.answer(case.number)
        gap = found_gap(out, done) if out is not None else None
        if gap is not None:
            write_json(folder / "gap.json", gap)
        if done.status is None:
            done = done._replace(stderr=f"out of time\n{done.stderr}")
        if not self.run.sealed(case.number).is_file():  # its model failed: the truth is sealed all the same
            with self._loops:
                question(self.run, self.exam, case)
        words = "" if gap is not None else done.stderr
        write_json(folder / "run.json", {"status": done.status, "seconds": done.seconds, "words": words})
        self.seconds.append(done.seconds)
        if not self.keep:
            clear(self.run, case)

    def _make_model(self, model: Model) -> Done | None:
        """Have a model made where it is not there; what it came to where it could not be made."""
        folder = self.run.model(model.name)
        if (folder / "model.toml").is_file():
            return None
        with self._loops:
            vehicle = str(vehicle_folder(self.run, self.exam, model.vehicle))
            logs = [str(path) for path in model_logs(self.run, self.exam, model)]
        self._say(f"model {model.name} ({model.kind})")
        physics = folder if model.kind == "physics" else folder.with_suffix(".physics")
        done = self._model_call(self.program.calibrate, self.program.limit_s, physics, logs, vehicle)
        if done is None and model.kind != "physics":
            extra = {"physics": str(physics)}
            done = self._model_call(self.program.learn, self.program.learn_limit_s, folder, logs, vehicle, **extra)
        if done is None and not self.keep:
            shutil.rmtree(folder.with_suffix(".logs"), ignore_errors=True)
        return done

    def _own_model(self, vehicle: Path) -> tuple[Path, Done | None]:
        """The model of a recording's vehicle, from the untouched recording beside its folder."""
        folder = vehicle.with_name(f"{vehicle.name}.model")
        with self._loops:
            logs = [str(path) for path in sorted((vehicle.parent / f"{vehicle.name}.logs").glob("*.log"))]
            return folder, self._model_call(self.program.calibrate, self.program.limit_s, folder, logs, str(vehicle))

    @staticmethod
    def _model_call(command: str, limit_s: float, out: Path, logs: list[str], vehicle: str, **more: str) -> Done | None:
        if (out / "model.toml").is_file():
            return None
        part = out.with_name(f"{out.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        done = call(command, limit_s, logs=logs, vehicle=vehicle, out=str(part), **more)
        if not (part / "model.toml").is_file():
            return done
        part.replace(out)
        return None

    @staticmethod
    def _say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)


def found_gap(out: Path, done: Done) -> Any:
    """The answer: gap.json in the output folder, else what was printed as JSON; None where there is none."""
    texts = [(out / "gap.json").read_text()] if (out / "gap.json").is_file() else []
    for text in [*texts, done.stdout]:
        try:
            data = json.loads(text)
        except json.JSONDecodeError:
            continue
        data = data.get("data", data) if isinstance(data, dict) else None
        if isinstance(data, dict) and "verdict" in data:
            return data
    return None
