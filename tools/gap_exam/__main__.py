"""`python -m tools.gap_exam COMMAND`: the exam of the workflow that names what a simulation lacks.

  make   one question for a trial: vehicle folder, clean logs, a log with an effect of your choice, or a --blind one
  open   the truth of a blind one, once there is an answer
  bench  a model folder that puts a car of the exam on a bench as its vehicle, with an effect hidden in it
  run    make, seal, ask and keep, two at a time; the same call goes on after any kill, others ask for more
  beside what the names of 24 logs are worth beside a network's guess, and in a closed loop
  score  open the truths of what is answered; table.md, table.json, outcomes.png, limits.png
  list   rows of the exam, how many cases each has, what they take; of a --run what is left

DOMAIN is exam:COMMIT (40 hex digits, the frozen commit) or dev:NAME. The examined program is a command line.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.gap_exam import bus, hours, report
from tools.gap_exam.bench_folder import write_model
from tools.gap_exam.beside import LOGS, compare_all
from tools.gap_exam.cases import Effects, draw_effect, log_of, make, vehicle_of
from tools.gap_exam.catalogue import EFFECTS, kind_of
from tools.gap_exam.driver import CONTROLLER, PERSON
from tools.gap_exam.drives import KINDS
from tools.gap_exam.files import Run, read_json, write, write_json
from tools.gap_exam.oracle import detect
from tools.gap_exam.outcomes import outcome
from tools.gap_exam.prepare import Frozen
from tools.gap_exam.program import Program
from tools.gap_exam.recordings import NoRecording
from tools.gap_exam.rows import ROWS, exam_of, sample_of
from tools.gap_exam.score import marked
from tools.gap_exam.seal import Broken, StillSealed, seal, unseal
from tools.gap_exam.seeds import Domain, domain_of
from tools.gap_exam.session import Wish, askable, conduct, count, exam_for, standing


def main(words: list[str]) -> int:
    """Run a command. Returns the exit status: 0, 2 for a mistake, 130."""
    options = parser().parse_args(words)
    try:
        return options.run_command(options)
    except (ValueError, KeyError, OSError, Frozen, NoRecording, Broken, StillSealed) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; the same call goes on", file=sys.stderr)
        return 130


def parser() -> argparse.ArgumentParser:
    """What may be asked."""
    top = argparse.ArgumentParser(prog="gap_exam", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    one = _command(commands, "make", _make)
    one.add_argument("--out", type=Path, required=True)
    one.add_argument("--kind", choices=tuple(KINDS), default="excited")
    one.add_argument("--person", action="store_true", help="a person drives, no controller")
    one.add_argument("--seconds", type=float, default=180.0)
    bench = _command(commands, "bench", _bench)
    bench.add_argument("--out", type=Path, required=True, help="models/NAME of a bench_configs folder")
    for both in (one, bench):
        _asked(both)
    opened = _command(commands, "open", _open)
    opened.add_argument("--out", type=Path, required=True, help="folder of `make --blind`")
    opened.add_argument("--answer", type=Path, required=True, help="the gap.json of the log")
    run = _command(commands, "run", _run)
    run.add_argument("--run", type=Path, required=True, help="folder of the exam")
    run.add_argument("--recordings", type=Path, help="folder with comma2k19_rav4/ and dart/, for the row `semi`")
    run.add_argument("--rows", default="", help=f"ask these alone, comma-separated: {', '.join(ROWS)}")
    run.add_argument("--part", default="1/1", help="K/N: every Nth case")
    run.add_argument("--logs", type=int, default=0, help="the first so many of these (0: all)")
    run.add_argument("--hours", type=float, default=0.0, help="ask nothing more after so long (0: until all is done)")
    run.add_argument("--parallel", type=int, default=2)
    run.add_argument("--unfrozen", action="store_true", help="an exam of a checkout that is not the commit's")
    run.add_argument("--keep", action="store_true", help="leave logs and all that the program wrote")
    run.add_argument("--gap", default=Program().gap)
    run.add_argument("--calibrate", default=Program().calibrate)
    run.add_argument("--learn", default=Program().learn)
    run.add_argument("--limit-s", type=float, default=Program().limit_s)
    _small(run)
    beside = _command(commands, "beside", _beside)
    beside.add_argument("--run", type=Path, required=True)
    beside.add_argument("--logs", type=int, default=LOGS)
    _small(beside)
    counted = _command(commands, "score", _score)
    counted.add_argument("--run", type=Path, required=True, action="append", help="said again: pooled with the first")
    counted.add_argument("--json", action="store_true")
    listed = _command(commands, "list", _list)
    listed.add_argument("--run", type=Path, help="an exam under way: what it took and what is left of it")
    _small(listed)
    return top


def _command(commands, name: str, function) -> argparse.ArgumentParser:
    one = commands.add_parser(name)
    one.set_defaults(run_command=function)
    if name not in ("score", "open", "beside"):
        one.add_argument("--domain", type=domain_of, default=Domain("dev", "trial") if name != "run" else None)
    return one


def _small(one: argparse.ArgumentParser) -> None:
    one.add_argument("--sample", action="store_true", help="24 one-effect logs instead")


def _asked(one: argparse.ArgumentParser) -> None:
    one.add_argument("--vehicle", type=int, default=0, help="number of the pool's vehicle")
    one.add_argument("--effect", action="append", default=[], metavar="NAME[=VALUE]", help="may be said again")
    one.add_argument("--blind", action="store_true", help="an effect that nobody is told, its truth under seal")
    one.add_argument("--number", type=int, default=0, help="another drive, another blind effect")


def effects_of(options: argparse.Namespace, names: list[str]) -> Effects:
    """The effects that are asked for; a blind one out of `names`."""
    effects: Effects = {}
    for word in options.effect:
        name, _, said = word.partition("=")
        effects[name] = draw_effect(name, options.domain.rng("make", name, options.number))
        if said:
            effects[name][kind_of(name).parameter] = float(said)
    if options.blind:
        name = str(options.domain.rng("blind", options.number).choice(sorted(names)))
        effects[name] = draw_effect(name, options.domain.rng("blind", name, options.number))
    return effects


def _make(options: argparse.Namespace) -> int:
    vehicle = vehicle_of(options.domain, options.vehicle)
    bus.write_folder(options.out / "vehicle", vehicle)
    effects = effects_of(options, list(EFFECTS))
    for kind in ("excited", "ordinary"):
        seed = options.domain.seed("make", options.vehicle, kind)
        write(options.out / f"clean_{kind}.log", log_of(make(vehicle, {}, kind, CONTROLLER, seed), seed))
    seed = options.domain.seed("make", options.vehicle, "asked", options.number)
    who = PERSON if options.person else CONTROLLER
    made = make(vehicle, effects, options.kind, who, seed, options.seconds)
    write(options.out / "drive.log", log_of(made, seed))
    truth = {"effects": effects, "oracle": detect(made)._asdict(), "mismatch": vehicle.mismatch}
    sealed = seal(truth, os.urandom(16).hex())
    write_json(options.out / "sealed.json", sealed)
    print(f"sealed: {sealed['commitment']}" if options.blind else json.dumps(truth))
    return 0


def _bench(options: argparse.Namespace) -> int:
    vehicle = vehicle_of(options.domain, options.vehicle)
    effects = effects_of(options, list(EFFECTS))
    seed = options.domain.seed("vehicle", options.vehicle)
    truth = {"seed": seed, "mismatch": vehicle.mismatch, "effects": effects}
    write_model(options.out, truth, vehicle.noise, os.urandom(16).hex())
    print(f"{options.out}: the vehicle of {options.domain}, number {options.vehicle}")
    return 0


def _open(options: argparse.Namespace) -> int:
    answer = read_json(options.answer)
    if "verdict" not in answer:
        raise ValueError(f"{options.answer} is no answer: it has no verdict")
    truth = unseal(read_json(options.out / "sealed.json"))
    print(json.dumps({**truth, "outcome": outcome(list(truth["effects"]), answer)}))
    return 0


def _run(options: argparse.Namespace) -> int:
    names = ("run", "domain", "sample", "part", "logs", "hours", "recordings", "parallel", "unfrozen", "keep")
    words = ("gap", "calibrate", "learn", "limit_s")
    program = Program(**{name: getattr(options, name) for name in words})
    conduct(Wish(**{name: getattr(options, name) for name in names}, rows=rows_of(options), program=program))
    print(standing(Run(options.run))["done"], file=sys.stderr)
    return 0


def rows_of(options: argparse.Namespace) -> tuple[str, ...]:
    """The rows that were named."""
    return tuple(options.rows.split(",")) if options.rows else ()


def _beside(options: argparse.Namespace) -> int:
    wish = Wish(options.run, sample=options.sample)
    run, exam = Run(options.run), exam_for(wish)
    compare_all(run, exam, marked(run, range(len(exam.cases))), options.logs)
    return 0


def _score(options: argparse.Namespace) -> int:
    found = count([Run(folder) for folder in options.run])
    done = [one["done"] for one in found.exams]
    print(f"{'; '.join(done)}; {options.run[0]}/table.md", file=sys.stderr)
    page = report.markdown(found.rows, found.limits, f"Exam of {found.name}", done)
    print(json.dumps(report.as_json(found.rows, found.limits, found.wrong, found.name)) if options.json else page)
    return 0


def _list(options: argparse.Namespace) -> int:
    run = Run(options.run) if options.run else None
    if run is not None:
        exam = askable(run, exam_for(Wish(options.run, sample=bool(read_json(run.exam)["sample"]))))
    else:
        exam = sample_of(options.domain) if options.sample else exam_of(options.domain)
    kinds = Counter(model.kind for model in exam.models.values())
    print(hours.words(hours.costs(exam, run)))
    print(f"{len(exam.cases)} cases, {kinds['physics']} calibrated and {kinds['hybrid']} learned models")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
