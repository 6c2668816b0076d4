"""Table I: layout of the networks, read from trained models and from the code that runs them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tools.reproduction import fig4, models
from tools.reproduction.context import Context
from tools.reproduction.records import Claim, Method, Record, Value
from tunefree_hil.base.course import Start
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.open_loop_map.samples import PEDALS
from tunefree_hil.learn.open_loop_map.table import PedalNet
from tunefree_hil.learn.training.map_nets import HIDDEN_WIDTHS
from tunefree_hil.plant import paper
from tunefree_hil.plant.learned.lstm_cell import Cell, init_cell
from tunefree_hil.plant.learned.weights_file import cell_of, load_plant_file
from tunefree_hil.plant.types import rolling_motion

NAME = "table1"
PROBE = 1e3  # inputs in standard deviations, at which a bounded activation is at its bound


class CellLayout(NamedTuple):
    """Layout of an LSTM plant."""

    inputs: int
    units: int
    outputs: int

    @property
    def text(self) -> str:
        """'5-8-2'."""
        return f"{self.inputs}-{self.units}-{self.outputs}"


PAPER_LAYOUT = CellLayout(5, 8, 2)
PAPER_SAMPLES = 20


def layout_of(model: ModelSpec) -> CellLayout:
    """From the arrays of plant.npz: the weights of the inputs, and those of the outputs."""
    with np.load(Path(model.folder) / "plant.npz", allow_pickle=False) as arrays:
        inputs, outputs = arrays["w_in"].shape[1], arrays["w_out"].shape[0]
        return CellLayout(inputs, arrays["w_out"].shape[1], outputs)


def activation_of(net: Cell) -> str:
    """ReLU where the output of a unit has no bound, by running the window of the plant; tanh stays below 1."""
    past = PROBE * np.random.default_rng(1).standard_normal(paper.SAMPLES * paper.SAMPLE_INPUTS)
    cell = init_cell(net)
    motion = rolling_motion(Start(), 1.0)
    paper.run_window(net, paper.PaperState(motion, 0.0, cell, past, 0, 1), paper.SAMPLES - 1)
    hidden = np.asarray(cell.inputs)[paper.SAMPLE_INPUTS :]
    return "ReLU" if float(np.max(np.abs(hidden))) > 1.0 else "tanh"


def input_count(net: PedalNet) -> int:
    """Inputs of a net of the map: one array of weights each."""
    return sum(name.startswith("w_") and name != "w_out" for name in net._fields)


def reproduce(context: Context) -> Record:
    """Read the layouts."""
    with context.progress.relay_lines("learning"):
        plants = models.learned_plants(context, models.load_bench_of_data())
    as_printed, default = layout_of(plants["paper"]), layout_of(models.default_plant())
    activation = activation_of(cell_of(load_plant_file(Path(plants["paper"].folder) / "plant.npz", "paper")))
    chart, _ = fig4.learn(context)
    nets = {pedal: chart.selections[pedal].net for pedal in PEDALS}
    widths = ", ".join(f"{pedal} {chart.selections[pedal].width}" for pedal in PEDALS)
    inputs = {input_count(net) for net in nets.values()}
    is_same = as_printed == PAPER_LAYOUT and paper.SAMPLES == PAPER_SAMPLES and activation == "ReLU" and inputs == {2}
    cores = f"{len(os.sched_getaffinity(0))} cores of one machine"
    cluster = "6 nodes with 4 i7 processors each"
    return Record(
        name=NAME,
        title="Features of the learned models",
        paper="Table I: dynamic model: LSTM, 20 samples, 5 inputs, 8 hidden units with ReLU, 2 outputs; open-loop "
        "mapping: MLP, 2 inputs, one hidden layer with sigmoid, 1 output; 6 computing nodes.",
        claim=Claim("The kind `paper` and the nets of the map have the layout of Table I.", is_same),
        values=(
            Value("dynamic model, kind paper: layout", as_printed.text, "", PAPER_LAYOUT.text),
            Value("dynamic model, kind paper: samples over time", paper.SAMPLES, "", str(PAPER_SAMPLES)),
            Value("dynamic model, kind paper: activation", activation, "", "ReLU"),
            Value("default plant: kind", models.default_plant().plant.kind, "", "LSTM alone"),
            Value("default plant: layout of its LSTM, with state", default.text, "", PAPER_LAYOUT.text),
            Value("open-loop map: inputs of a net", str(max(inputs)), "", "2"),
            Value("open-loop map: hidden units, chosen", widths, "", f"chosen by trying; ours of {HIDDEN_WIDTHS}"),
            Value("training environment", cores, "", cluster),
        ),
        method=Method(
            "models of Fig. 3b and Fig. 4, and the shipped default plant",
            "1 model of each",
            f"training {context.seed}",
            "Layouts are read from the arrays of the trained models; the activation is found by running the plant's "
            "own window with large inputs.",
        ),
        difference="The default plant is a fitted physics with a small LSTM beside it, because the network as printed "
        "sees 0.2 s only (Fig. 3b).",
    )
