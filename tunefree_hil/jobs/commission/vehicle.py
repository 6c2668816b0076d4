"""The vehicle of a commission as one model folder: the verify_model of the bench file with its own [[effects]].

`collect` drives the verify_model with the effects of the bench file. The bench that is tuned has none, as they are not
part of the learned plant. This folder has them, so that verification and `gap --drive` use the car of the logs.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from tunefree_hil.config.dump import plain
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import BenchSpec
from tunefree_hil.learn.model_folder import model_toml_from_spec, write_model_copy

VEHICLE = "vehicle"  # in the folder of the commission
HEAD = "# Written by tunefree_hil commission: {model} with the [[effects]] of {bench}, as `collect` drove it.\n"


def write_vehicle(folder: Path, bench: BenchSpec) -> Path:
    """Write the folder, completely or not at all; the same bench file gives the same bytes.

    Returns:
        Its path.

    Raises:
        InputError: The verify_model cannot be read.
    """
    model = load_model(bench.verify_model, bench.path)
    data = model_toml_from_spec(model)
    # Effects of the bench file follow those of the model; an effect without parameters keeps its empty table.
    data["effects"] = [{"params": {}, **plain(one)} for one in (*model.effects, *bench.effects)]
    shutil.rmtree(folder, ignore_errors=True)
    write_model_copy(folder, model, HEAD.format(model=Path(model.folder).name, bench=Path(bench.path).name), data)
    return folder
