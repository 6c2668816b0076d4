"""What changes in a car from one day to the next, as parameters of effects of the catalogue: one row says all of it.

A row is a number that recalibration may move (gap/null.py). Whoever adds one says here by how much, how well a
calibration knows it, whether it belongs to the day or to the car, and where it shows.
"""

from __future__ import annotations

from typing import NamedTuple


class Drift(NamedTuple):
    """sigma: standard deviation from day to day, in the parameter's unit; why: what changes there.

    constant: the constant of the plant (card.json of `calibrate`) by which the doubt about it is known; own_unit: that
    doubt is in the constant's own unit, not a share of it; against: more of it is less of the constant.
    daily: of the day and not of the car: no calibration takes it in, however near it comes. formed: by it recalibration
    makes up for a form that the model has not, too, and that is the same every day. written: into a repaired
    model; what is of the day is not, nor what the next day's sensors or tyres have otherwise. by_weight: sigma is of
    ROAD_CAR_KG, and a tenth of the weight is pushed by a tenth. sideways: it shows in how the car turns and in what it
    feels sideways.
    """

    effect: str
    parameter: str
    sigma: float
    why: str
    constant: str = ""
    own_unit: bool = False
    against: bool = False
    daily: bool = False
    formed: bool = False
    written: bool = True
    by_weight: bool = False
    sideways: bool = False

    @property
    def key(self) -> str:
        """As gap/graph.py takes it."""
        return f"{self.effect}.{self.parameter}"


ROAD_CAR_KG = 1800.0
TYRES, GYRO, ACCEL = (
    "tyre pressure, temperature",
    "a gyro's bias from one start to the next",
    "the same of an accelerometer",
)
ROWS = (
    Drift("throttle_gain", "gain_frac", 0.02, "fuel, temperature of the engine"),
    Drift("brake_gain", "gain_frac", 0.02, "temperature of the discs", "brake_force_n_per_frac"),
    Drift("steer_gain", "gain_frac", 0.01, "what a fit leaves of the steering ratio", "steer_ratio", against=True),
    Drift("steer_offset", "offset_rad", 0.003, "straight ahead, as a calibration finds it"),
    Drift("rolling_resistance", "extra_frac", 0.06, TYRES, "rolling_frac"),
    Drift("aero_drag", "drag_area_m2", 0.03, "what a fit leaves of it at town speeds", "drag_area_m2", own_unit=True),
    # The grip is of the day: by it a model has the form of its tyres' curve right, too, which no calibration takes in
    Drift(
        "friction", "friction_frac", 0.15, "nobody measured it",
        daily=True, formed=True, written=False, sideways=True,
    ),
    Drift("front_stiffness", "gain_frac", 0.02, TYRES, "front_stiffness_n_per_rad", sideways=True),
    Drift("rear_stiffness", "gain_frac", 0.02, TYRES, "rear_stiffness_n_per_rad", sideways=True),
    Drift("grade", "grade_rad", 0.0007, "no road is level", daily=True, written=False),
    Drift(
        "side_wind", "force_n", 8.0, "camber of a level road, a breeze",
        daily=True, written=False, by_weight=True, sideways=True,
    ),
    Drift("speed_scale", "scale_frac", 0.001, "rolling radius", written=False),
    Drift("yaw_rate_bias", "bias_radps", 0.0003, GYRO, daily=True, written=False),
    Drift("yaw_rate_scale", "scale_frac", 0.002, "a gyro's scale", written=False),
    Drift("accel_bias", "bias_mps2", 0.008, ACCEL, daily=True, written=False),
)  # fmt: skip
BY_KEY = {one.key: one for one in ROWS}
DRIFT = {one.key: one.sigma for one in ROWS}
DAILY = tuple(one.effect for one in ROWS if one.daily)
RECALIBRATED = {"by": "recalibration"}  # provenance of what recalibration moved
UNWRITTEN = tuple(one.effect for one in ROWS if not one.written)
