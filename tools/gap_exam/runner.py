"""Runs the examined program over an exam: a model where one is needed, then a question at a time, two side by side.

Whatever is cut off, kill -9 included, the same call goes on: only whole answers count, and an answer is whole when
run.json is there. The program is a command line; nothing of it is imported. Models are shared by all cases of a vehicle
that start from a clean calibration.
"""

from __future__ import annotations

import json
import math
import shutil
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from tools.gap_exam.call import Done, call, end_all
from tools.gap_exam.cases import Case
from tools.gap_exam.files import Run, held, read_json, write_json
from tools.gap_exam.ladder import Ladder
from tools.gap_exam.prepare import clear, model_logs, question, vehicle_folder
from tools.gap_exam.program import Program
from tools.gap_exam.rows import Exam, Model
from tools.gap_exam.semi_real import SOURCES

__all__ = ["Examiner", "Program", "Turns"]
# A model that cannot be made may be the machine's doing: its cases have no answer until a second call found the same
LEAST_REFUSALS = 2


class Turns:
    """Whose turn it is: cases in their order, but one whose size hangs on answers that are not there lets others by."""

    def __init__(self, run: Run, ladder: Ladder, todo: Sequence[Case], until: float = math.inf) -> None:
        self.run, self.ladder, self.todo, self.until = run, ladder, list(todo), until
        self.stopped = False
        self._under_way = 0
        self._change = threading.Condition()

    def take(self) -> Case | None:
        """The next case, with its size; None where there is none, or no time for one."""
        with self._change:
            while self.todo and not self.stopped and time.monotonic() < self.until:
                ready = next((one for one in self.todo if not self.ladder.waits(self.run, one)), None)
                if ready is not None:
                    self.todo.remove(ready)
                    self._under_way += 1
                    return self.ladder.sized(self.run, ready)
                if not self._under_way:
                    return None  # what it waits for is not among these cases
                self._change.wait()
            return None

    def give_back(self) -> None:
        """A case that was taken is done with."""
        with self._change:
            self._under_way -= 1
            self._change.notify_all()

    def stop(self) -> None:
        """Nobody gets a case any more; what is under way is ended and does not count."""
        with self._change:
            self.stopped = True
            self._change.notify_all()
        end_all()


class Examiner:
    """One run over one exam."""

    def __init__(self, run: Run, exam: Exam, program: Program, *, keep: bool = False) -> None:
        self.run, self.exam, self.program = run, exam, program
        self.keep = keep
        self._models: dict[str, threading.Lock] = {name: threading.Lock() for name in (*exam.models, *SOURCES)}
        self._failed: dict[str, Done] = {}  # models that could not be made: asked for once a call
        self._loops = threading.Lock()  # our own loops one at a time: they hold the interpreter anyway
        self._turns = Turns(run, Ladder(exam), ())
        self.seconds: list[float] = []
        self.unasked = 0  # cases of models that could not be made, which the next call asks for once more

    def go(self, cases: Sequence[Case], parallel: int = 2, hours: float = 0.0) -> int:
        """Answer what of these has no answer yet, in their order; how many were answered now.

        hours: after so long no further question is asked (0: until all are answered).
        """
        todo = [case for case in cases if not self.run.is_answered(case.number)]
        for case in cases:
            if not self.keep and self.run.is_answered(case.number):
                clear(self.run, case)  # a kill may have come between its answer and this
        self._total, self._begun = len(todo), time.monotonic()
        self._say(f"{len(cases) - len(todo)} of {len(cases)} are answered; {len(todo)} to go")
        until = self._begun + 3600.0 * hours if hours else math.inf
        self._turns = Turns(self.run, Ladder(self.exam), todo, until)
        with ThreadPoolExecutor(parallel) as pool:
            workers = [pool.submit(self._work) for _ in range(parallel)]
            try:
                for worker in as_completed(workers):
                    worker.result()
            except BaseException:  # an interrupt, or an error of one worker: the others do not go on alone
                self._turns.stop()
                raise
        if self.unasked:
            self._say(f"{self.unasked} have no model and no answer yet; the same call asks for their models once more")
        if self._turns.todo:
            self._say(f"{len(self._turns.todo)} of {len(cases)} are still to be asked; the same call goes on")
        return len(self.seconds)

    def _work(self) -> None:
        while (case := self._turns.take()) is not None:
            try:
                self.one(case)
            finally:
                self._turns.give_back()
            self._say(self.progress())

    def progress(self) -> str:
        done, took = len(self.seconds), time.monotonic() - self._begun
        left = (self._total - done) * took / max(done, 1)
        return f"{done}/{self._total} answered, {took / max(done, 1):.1f} s each, {left / 3600.0:.2f} h left"

    def one(self, case: Case) -> None:
        """One question, from its model to its answer."""
        with self._loops:
            began = time.monotonic()
            logs, vehicle = question(self.run, self.exam, case)
            made_s = time.monotonic() - began
        model, failed = self._model_of(case, vehicle)
        if self._turns.stopped:
            return
        out = logs[0].parent / "out"
        if failed is None:
            shutil.rmtree(out, ignore_errors=True)
            places = {"vehicle": str(vehicle), "model": str(model), "out": str(out)}
            done = call(self.program.gap, self.program.limit_s, log=[str(path) for path in logs], **places)
        elif self._refusals(case) < LEAST_REFUSALS:
            self.unasked += 1
            if not self.keep:
                clear(self.run, case)
            return
        else:
            done = failed._replace(stderr=f"no model: {failed.stderr}")
        if not self._turns.stopped:
            self._answer(case, done, out if failed is None else None, made_s)

    def _answer(self, case: Case, done: Done, out: Path | None, made_s: float) -> None:
        folder = self.run.answer(case.number)
        gap = found_gap(out, done) if out is not None else None
        if gap is not None:
            write_json(folder / "gap.json", gap)
        if done.status is None:
            done = done._replace(stderr=f"out of time\n{done.stderr}")
        words = "" if gap is not None else done.stderr
        took = {"seconds": done.seconds, "made_s": made_s}
        write_json(folder / "run.json", {"status": done.status, **took, "words": words})
        self.seconds.append(done.seconds)
        if not self.keep:
            clear(self.run, case)

    def _model_of(self, case: Case, vehicle: Path) -> tuple[Path, Done | None]:
        """(model folder, what it came to where it could not be made); a recording's lies beside its vehicle."""
        name = case.model or case.source
        with self._models[name]:
            if name not in self._failed:
                made = self._make_model(self.exam.models[name]) if case.model else self._own_model(vehicle)
                if made is not None and not self._turns.stopped:
                    self._failed[name] = made
                    words = {"status": made.status, "seconds": made.seconds, "words": made.stderr}
                    write_json(self.run.refused(name), {"calls": self._refusals(case) + 1, **words})
        folder = self.run.model(name) if case.model else vehicle.with_name(f"{vehicle.name}.model")
        return folder, self._failed.get(name)

    def _refusals(self, case: Case) -> int:
        """In how many calls the model of a case could not be made."""
        path = self.run.refused(case.model or case.source)
        return int(read_json(path)["calls"]) if path.is_file() else 0

    def _make_model(self, model: Model) -> Done | None:
        """Have a model made where it is not there; what it came to where it could not be made."""
        folder = self.run.model(model.name)
        if (folder / "model.toml").is_file():
            return None
        with self._loops:
            vehicle = str(vehicle_folder(self.run, self.exam, model.vehicle))
            logs = [str(path) for path in model_logs(self.run, self.exam, model)]
        begun = time.monotonic()
        physics = folder if model.kind == "physics" else folder.with_suffix(".physics")
        done = self._model_call(self.program.calibrate, self.program.limit_s, physics, logs, vehicle)
        if done is None and model.kind != "physics":
            extra = {"physics": str(physics)}
            done = self._model_call(self.program.learn, self.program.learn_limit_s, folder, logs, vehicle, **extra)
        if done is None and not self.keep:
            shutil.rmtree(folder.with_suffix(".logs"), ignore_errors=True)
        took = time.monotonic() - begun
        if done is None:
            write_json(self.run.model_time(model.name), {"seconds": took})
        self._say(f"model {model.name} ({model.kind}): {took:.0f} s")
        return done

    def _own_model(self, vehicle: Path) -> Done | None:
        """The model of a recording's vehicle, from the untouched recordings beside its folder."""
        logs = [str(path) for path in sorted((vehicle.parent / f"{vehicle.name}.logs").glob("*.log"))]
        folder = vehicle.with_name(f"{vehicle.name}.model")
        return self._model_call(self.program.calibrate, self.program.limit_s, folder, logs, str(vehicle))

    def _model_call(
        self, command: str, limit_s: float, out: Path, logs: list[str], vehicle: str, **more: str
    ) -> Done | None:
        """Have a model folder written, by one process at a time; what it came to where there is none then.

        Its name until it is whole is always the same: `learn` finds its checkpoint (OUT.part) beside it, and goes on.
        """
        with held(out.with_name(f"{out.name}.lock"), lambda: self._turns.stopped) as mine:
            if not mine:
                return Done(None, 0.0, "", "stopped before its turn came")
            if (out / "model.toml").is_file():
                return None
            part = out.with_name(f"{out.name}.part")
            shutil.rmtree(part, ignore_errors=True)  # of a call that was killed: no command goes on in a folder
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
