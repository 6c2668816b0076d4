"""The vehicle of a commission as one model folder: the bench file's verify_model with the bench file's own [[effects]].

`collect` drives a bench file's verify_model with its effects; the bench that is tuned has none, as they are no part of
the learned plant. This folder has them, so that what is verified on, and what `gap --drive` drives later, is the car
that the logs were collected from.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from tunefree_hil.config.dump import plain
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import BenchSpec
from tunefree_hil.learn.model_folder import data_of, write_beside

VEHICLE = "vehicle"  # in the commission's folder
HEAD = "# Written by tunefree_hil commission: {model} with the [[effects]] of {bench}, as `collect` drove it.\n"


def write_vehicle(folder: Path, bench: BenchSpec) -> Path:
    """Write the folder anew, whole or not at all, beside what else the verify_model's own holds; its path. The same
    bench file gives the same bytes. Raises InputError for a verify_model that cannot be read.
    """
    model = load_model(bench.verify_model, bench.path)
    data = data_of(model)
    # the bench's stand behind the model's own; an effect without parameters keeps its empty table
    data["effects"] = [{"params": {}, **plain(one)} for one in (*model.effects, *bench.effects)]
    shutil.rmtree(folder, ignore_errors=True)
    write_beside(folder, model, HEAD.format(model=Path(model.folder).name, bench=Path(bench.path).name), data)
    return folder
