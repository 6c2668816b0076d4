"""How much extra steer dead time the winner bears, against the best manual vector: of finished tune runs, or own ones.

A run whose verify.json holds margins is read; the others' winners are driven in the compiled batch, on the verify model
over the verify scenarios. Own runs are tunes in the batch, one a seed, kept in `folder` and used again.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tools.measures._ledger import FIGURES
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.run_folder import open_run, read_json
from tunefree_hil.jobs.tune.candidates import TUNED, compute_baseline_vectors, read_winner
from tunefree_hil.jobs.tune.margins import MarginDrives, find_margins, margin_data, margin_table, margin_text
from tunefree_hil.jobs.tune.options import BATCH
from tunefree_hil.jobs.tune.tune import tune

VALUE = "winner's / best manual's delay margin, smallest over the verify scenarios (manual must not re-plan as it is)"
OWN = "runs/measure-margins"


def measure(
    runs: str = "",
    bench: str = "bench_configs/mkz_steer.toml",
    trials: int = 30,
    seeds: int = 1,
    folder: str = OWN,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """runs: folders of finished tunes, with commas between; without them `seeds` studies of `trials` trials each."""
    chosen = [Path(one) for one in runs.split(",") if one] or own_runs(bench, trials, seeds, Path(folder))
    before, found = machine(), {str(path): margins_of(path) for path in chosen}
    ratios = [ratio for data in found.values() if (ratio := ratio_of(data)) is not None]
    if not ratios:
        reasons = "; ".join(data["reason"] or "every manual vector re-plans as it is" for data in found.values())
        raise InputError(f"there is no ratio: {reasons}", code="no_margins", key="runs")
    detail = {"machine": before, "runs": {name: _detail(data) for name, data in found.items()}}
    detail["figure"] = _draw(next(data for data in found.values() if not data["reason"]), Path(figures))
    return summary(ratios, "ratio of delay margins", rounded(detail))


def margins_of(run: Path) -> dict[str, Any]:
    """ "margins" of a run's verify.json, else found now; the steering is then not known."""
    kept = run / "verify.json"
    if kept.is_file() and not (known := read_json(kept).get("margins", {"reason": "older"}))["reason"]:
        return known
    folder = open_run(run)
    bench = load(folder.bench_file())
    vectors = {TUNED: read_winner(bench, folder), **compute_baseline_vectors(bench)}
    scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
    found = _ended(find_margins(bench, bench.spec.verify_model, vectors, scenarios))
    scores = scores_of(bench, found) if isinstance(found, MarginDrives) else {}
    return margin_data(found, dict.fromkeys(vectors), scores, {})  # nothing was driven over the bus here


def scores_of(bench: Bench, found: MarginDrives) -> dict[str, float]:
    """Each vector's score over the scenarios, weighted by their planned samples (the paper's eq. 7)."""
    ticks = {name: bench.course(bench.scenarios[name]).ticks for name in bench.spec.verify_scenarios}
    by_name = {bench.scenarios[name].name: count for name, count in ticks.items()}
    whole = sum(by_name.values())
    return {name: sum(score * by_name[key] for key, score in some.items()) / whole
            for name, some in found.scores.items()}  # fmt: skip


def ratio_of(data: Mapping[str, Any]) -> float | None:
    """Winner's delay margin over manual's; None where there is no manual one to compare with."""
    if data["reason"] or data["against"] is None:
        return None
    mine, other = (data["vectors"][name]["delay"]["value"] for name in (TUNED, data["against"]))
    return mine / other


def own_runs(bench: str, trials: int, seeds: int, folder: Path) -> list[Path]:
    """Finished tunes of seeds 1, 2, ...: those in `folder`, the missing ones made now, in the batch."""
    found = []
    for seed in range(1, seeds + 1):
        place = folder / f"{Path(bench).stem}-{trials}-{seed}"
        done = [path.parent for path in sorted(place.glob("*/best.toml"))]
        if not done:
            asked = TuneOptions(Path(bench), trials=trials, seed=seed, out=place, verify=False, backend=BATCH)
            _ended(tune(asked))
            done = [path.parent for path in sorted(place.glob("*/best.toml"))]
        found.append(done[-1])
    return found


def _ended(job: Iterable[Event]) -> Any:
    """Run a job to its end, its words to stderr; what it returns."""
    events = iter(job)
    while True:
        try:
            print(next(events).message, file=sys.stderr, flush=True)
        except StopIteration as stop:
            return stop.value


def _detail(data: Mapping[str, Any]) -> dict[str, Any]:
    """What a reader asks of a run: who is compared, every vector's margins and failures, the sentence."""
    if data["reason"]:
        return {"reason": data["reason"]}
    keys = ("delay", "gain_up", "gain_down", "inside", "beyond", "steering")
    vectors = {name: {key: one[key] for key in keys} for name, one in data["vectors"].items()}
    print("\n".join(margin_table(data, TUNED)), file=sys.stderr)
    kept = {key: data[key] for key in ("against", "less", "drives", "limits")}
    if data["same_as_bus"]["of"]:
        kept["same_as_bus"] = data["same_as_bus"]
    return {"ratio": ratio_of(data), "words": margin_text(data, TUNED), **kept, "vectors": vectors}


def _draw(data: Mapping[str, Any], folder: Path) -> str:
    from tunefree_hil.figures.style import save
    from tunefree_hil.figures.tuning.margins import draw_margins

    return str(save(draw_margins(data, TUNED), folder / "margins.png"))
