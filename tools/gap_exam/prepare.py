"""Questions out of an exam: vehicle folders, logs, truths under seal. Each whole or not there, so it may be cut off."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

from tools.gap_exam import bus, semi_real
from tools.gap_exam.cases import MISMATCHES, Case, Made, log_of, make, vehicle_of
from tools.gap_exam.fast import source_hash
from tools.gap_exam.files import Run, read_json, write, write_json
from tools.gap_exam.hidden import hidden_of
from tools.gap_exam.oracle import detect
from tools.gap_exam.program import PACKAGE, Program, differences, said_of
from tools.gap_exam.recordings import log_name
from tools.gap_exam.rows import Exam, Model
from tools.gap_exam.seal import put_away
from tools.gap_exam.seeds import EXAM

SCHEMA = "gap-exam/1"
COMPILED = "__pycache__"  # what the interpreter and the kernels' compiler leave beside every file


class Frozen(Exception):
    """A run that was begun under other conditions."""


def truths_hash(exam: Exam) -> str:
    """SHA-256 over all cases as drawn: fixed before the first question is asked."""
    text = json.dumps([case._asdict() for case in exam.cases], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def is_frozen(exam: Exam, root: Path) -> bool:
    """Whether `root` is a clean checkout of the commit that an exam's domain names; development's domains never are.

    In the package a file that git does not know, or is told to ignore, counts as a change as well: every file of its
    folder of effects is in the catalogue.
    """
    if exam.domain.kind != EXAM:
        return False
    head, changed, others = (
        subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False).stdout.strip()
        for words in (
            ("rev-parse", "HEAD"),
            ("status", "--porcelain", "--untracked-files=no"),
            ("ls-files", "--others", "--", PACKAGE),
        )
    )
    new = [path for path in others.splitlines() if COMPILED not in path]
    return head == exam.domain.name and not changed and not new


def begin(run: Run, exam: Exam, *, frozen: bool = False, sample: bool = False, program: Program | None = None) -> None:
    """Write exam.json, or see that the run goes on as it was begun; raises Frozen where it does not.

    frozen: whether what is examined is what the domain's commit holds. sample: whether it is the small one. program:
    what is examined; an exam that was begun without a word of it goes on with any.
    """
    of = None if program is None else said_of(program)
    said = {
        "sample": sample,
        "frozen": frozen,
        "schema": SCHEMA,
        "domain": str(exam.domain),
        "cases": len(exam.cases),
        "models": len(exam.models),
        "truths": truths_hash(exam),
        "source": source_hash(),
    }
    if not run.exam.is_file():
        write_json(run.exam, said if of is None else {**said, "program": of})
        return
    was = read_json(run.exam)
    changed = [key for key in said if was.get(key) != said[key]]
    if changed:
        raise Frozen(f"{run.folder} was begun with another {', '.join(changed)}; another exam needs another folder")
    other = [] if of is None or "program" not in was else differences(was["program"], of)
    if other:
        raise Frozen(
            f"{run.folder} was begun with another program: {'; '.join(other)}. Go on with the same words and the same "
            "installation, or begin another exam in another folder"
        )


def vehicle_folder(run: Run, exam: Exam, number: int) -> Path:
    """The folder of a vehicle of the pool, written where it is not there."""
    folder = run.vehicle(number)
    if not (folder / "vehicle.toml").is_file():
        part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
        bus.write_folder(part, vehicle_of(exam.domain, number))
        folder.parent.mkdir(parents=True, exist_ok=True)
        part.replace(folder)
    return folder


def model_logs(run: Run, exam: Exam, model: Model) -> list[Path]:
    """The logs that a model is made from."""
    vehicle = vehicle_of(exam.domain, model.vehicle)
    logs = []
    for i, spec in enumerate(model.logs):
        path = run.model(model.name).with_suffix(".logs") / f"drive_{i}.log"
        if not path.is_file():
            made = make(vehicle, spec.effects, spec.kind, spec.who, spec.seed, spec.duration_s)
            write(path, log_of(made, spec.seed))
        logs.append(path)
    return logs


def question(run: Run, exam: Exam, case: Case) -> tuple[list[Path], Path]:
    """(logs, vehicle folder) of a case; its truth, with whether it is detectable, is sealed before there is a log."""
    if case.source:
        vehicle, texts, extra = semi_real.question(run, case)
        _seal(run, case, extra)
    else:
        vehicle = vehicle_folder(run, exam, case.vehicle)
        made = make(
            vehicle_of(exam.domain, case.vehicle), case.effects, case.kind, case.who, case.seed, case.duration_s
        )
        _seal(run, case, {**_found(made, case), "mismatch": MISMATCHES[case.vehicle % len(MISMATCHES)]})
        texts = [log_of(made, case.seed)]
    paths = [run.log(case.number).with_name(log_name(number)) for number in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        write(path, text)
    return paths, vehicle


def _found(made: Made, case: Case) -> dict[str, Any]:
    """What the oracle says of a case: of all that is hidden, and of two effects of each beside the other."""
    wide = case.row in ("start_b", "start_d")  # its model has seen the effect
    found: dict[str, Any] = {"oracle": detect(made, wide=wide)._asdict()}
    if len(case.effects) > 1:
        others = {name: {key: one for key, one in case.effects.items() if key != name} for name in case.effects}
        each = {name: detect(made, known=hidden_of(rest)) for name, rest in others.items()}
        found["each"] = {name: one._asdict() for name, one in each.items()}
    return found


def _seal(run: Run, case: Case, extra: dict[str, Any]) -> None:
    truth = {**case._asdict(), **extra}
    nonce = os.urandom(16).hex()
    put_away(run, case.number, truth, nonce)


def clear(run: Run, case: Case) -> None:
    """Take an answered question away."""
    shutil.rmtree(run.log(case.number).parent, ignore_errors=True)
