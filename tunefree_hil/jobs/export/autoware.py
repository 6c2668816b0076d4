"""Autoware's parameter files and pedal tables (autowarefoundation/autoware.universe).

Names are those of control/autoware_pid_longitudinal_controller, control/autoware_mpc_lateral_controller and
vehicle/autoware_raw_vehicle_cmd_converter. Each file has only the keys that the bench has a value for: it is loaded
after Autoware's own file of the same name.

Autoware steers by MPC, the bench by LQR or its own MPC. Of an LQR the weights are start values: Q on lateral and
heading error over R on the road-wheel angle, and the scheduler's ratios as a weight of the steering that grows with the
square of the speed.
"""

from __future__ import annotations

import math
from typing import Any

from tunefree_hil.control.lateral import lqr
from tunefree_hil.control.longitudinal import pid
from tunefree_hil.jobs.export.number_text import format_number
from tunefree_hil.jobs.export.pedal_maps import (
    BRAKE,
    THROTTLE,
    PedalMap,
    largest_difference,
    make_pedal_map,
    render_csv,
)
from tunefree_hil.jobs.export.remarks import Export, ExportFile, PartExport, Remark, RemarkKind
from tunefree_hil.jobs.export.values import ExportValues
from tunefree_hil.jobs.export.yaml_text import render_parameters

AFTER = "Load this after Autoware's own file of the same name: it has only the keys that the bench has a value for."
LQR_PARTS, PID_PARTS, MPC_PART = ("lqr", "lqr_preview"), ("pid", "pid_preview"), "mpc"
ACCEL_MAP, BRAKE_MAP = "accel_map.csv", "brake_map.csv"
PID_FILE, MPC_FILE = "pid.param.yaml", "mpc.param.yaml"
MPC_WEIGHTS = {
    "mpc_weight_lat_error": "mpc.q_lateral",
    "mpc_weight_heading_error": "mpc.q_heading",
    "mpc_weight_steering_input": "mpc.r_steer",
    "mpc_weight_steer_rate": "mpc.r_steer_rate",
}


def export_autoware(source: ExportValues) -> Export:
    """Parameter files of the two controllers, the vehicle and the command converter, and its pedal tables."""
    lateral, longitudinal = make_lateral(source), make_longitudinal(source)
    rest_frac = source.vehicle.rest_pedal_frac
    throttle, brake = (make_pedal_map(source.calibration, rest_frac, sign) for sign in (THROTTLE, BRAKE))
    files = [
        ExportFile(ACCEL_MAP, render_csv(throttle, "default")),
        ExportFile(BRAKE_MAP, render_csv(brake, "default")),
        ExportFile("raw_vehicle_cmd_converter.param.yaml", render_parameters(converter_keys(source, throttle, brake))),
        ExportFile("vehicle_info.param.yaml", render_parameters(vehicle_keys(source), (AFTER,))),
    ]
    for name, part in ((MPC_FILE, lateral), (PID_FILE, longitudinal)):
        if part.content:
            files.append(ExportFile(name, render_parameters(part.content, (AFTER,))))
    remarks = [*lateral.remarks, *longitudinal.remarks, *map_remarks(source, throttle, brake), *other_remarks(source)]
    return Export(files, remarks, frozenset((*lateral.names, *longitudinal.names)))


def make_lateral(source: ExportValues) -> PartExport:
    """Weights of the MPC, and the steering actuator as it was identified."""
    delays, vehicle = source.delays, source.vehicle
    model = {
        "vehicle_model_type": "kinematics",
        "input_delay": delays.steer_dead_time_s + delays.bus_s,
        "vehicle_model_steer_tau": delays.steer_lag_s,
        "steering_lpf_cutoff_hz": source.settings.cutoff_hz,
        "mpc_acceleration_limit": vehicle.accel_high_mps2,
    }
    rate_dps = math.degrees(vehicle.steer_rate_radps / vehicle.steer_ratio)
    text = f"the wheel turns at most {rate_dps:.1f} deg/s (road wheel); Autoware's lists by curvature and speed stand"
    remarks = [Remark(RemarkKind.NOT_EXPORTED, "steer_rate_lim_dps_list_by_curvature, ..._by_velocity", text)]
    if source.parts.lateral == MPC_PART:
        return own_mpc(source, model, remarks)
    if source.parts.lateral not in LQR_PARTS:
        text = "Autoware's MPC has no weights for it; the delays of the steering are exported"
        return PartExport(
            model, (), [*remarks, Remark(RemarkKind.NOT_EXPORTED, f"lateral = {source.parts.lateral}", text)]
        )
    values = source.values
    weights = {
        "mpc_weight_lat_error": values["lqr.q1"],
        "mpc_weight_heading_error": values["lqr.q3"],
        "mpc_weight_heading_error_squared_vel": 0.0,
        "mpc_weight_steering_input": lqr.INPUT_WEIGHT,
        "mpc_weight_steering_input_squared_vel": speed_weight_s2pm2(),
    }
    text = (
        "the weights of the LQR, as start values: Autoware's MPC has another model and horizon and was not driven here"
    )
    remarks.append(Remark(RemarkKind.DIFFERS, f"lateral = {source.parts.lateral}", text))
    remarks += [
        Remark(
            RemarkKind.NOT_EXPORTED, name, f"{format_number(values[name])}; Autoware's MPC weighs no rate of an error"
        )
        for name in ("lqr.q2", "lqr.q4")
    ]
    return PartExport({**weights, **model}, ("lqr.q1", "lqr.q3"), remarks)


def own_mpc(source: ExportValues, model: dict[str, Any], remarks: list[Remark]) -> PartExport:
    """The weights of the bench's own MPC."""
    weights = {key: source.values[name] for key, name in MPC_WEIGHTS.items() if name in source.values}
    names = tuple(name for name in MPC_WEIGHTS.values() if name in source.values)
    text = "Autoware's MPC has another model, horizon and ratios over speed; it was not driven here"
    remarks = [*remarks, Remark(RemarkKind.DIFFERS, "lateral = mpc", text)]
    return PartExport({**weights, **model}, names, remarks)


def speed_weight_s2pm2() -> float:
    """c of the steering weight 1 + c v^2 that stands for the scheduler's ratio on Q1: least squares of 1 / ratio."""
    pairs = [
        (speed * speed, 1.0 / ratio - 1.0) for speed, ratio in zip(lqr.SCHEDULE_MPS, lqr.LATERAL_RATIO, strict=True)
    ]
    return sum(square * excess for square, excess in pairs) / sum(square * square for square, _ in pairs)


def make_longitudinal(source: ExportValues) -> PartExport:
    """The speed PID above the switch speed; Autoware has one set of gains and no loop of the station."""
    if source.parts.longitudinal not in PID_PARTS:
        text = "Autoware's PID has no gains for it; its file is not written"
        return PartExport(
            {}, (), [Remark(RemarkKind.NOT_EXPORTED, f"longitudinal = {source.parts.longitudinal}", text)]
        )
    values, delays, vehicle = source.values, source.delays, source.vehicle
    kp, ki = values["speed.kp_high"], values["speed.ki_high"]
    proportional, integral = kp * pid.SPEED_LIMIT_MPS, pid.INTEGRAL_LIMIT_MPS2
    keys = {
        "delay_compensation_time": delays.drive_dead_time_s + delays.drive_lag_s + delays.bus_s,
        "enable_slope_compensation": False,
        "kp": kp,
        "ki": ki,
        "kd": 0.0,
        "max_out": proportional + integral,
        "min_out": -proportional - integral,
        "max_p_effort": proportional,
        "min_p_effort": -proportional,
        "max_i_effort": integral,
        "min_i_effort": -integral,
        "max_d_effort": 0.0,
        "min_d_effort": 0.0,
        "max_acc": vehicle.accel_high_mps2,
        "min_acc": vehicle.accel_low_mps2,
    }
    return PartExport(keys, ("speed.kp_high", "speed.ki_high"), longitudinal_remarks(source))


def longitudinal_remarks(source: ExportValues) -> list[Remark]:
    """How Autoware's longitudinal control differs from the one that was driven."""
    values = source.values
    remarks = [
        Remark(
            RemarkKind.DIFFERS, name, f"{format_number(values[name])}; Autoware has one set of gains, from above 3 m/s"
        )
        for name in ("speed.kp_low", "speed.ki_low")
    ]
    text = f"{format_number(values['station.kp'])}; Autoware takes the speed of the nearest point and has no such loop"
    remarks.append(Remark(RemarkKind.DIFFERS, "station.kp", text))
    if source.parts.longitudinal == "pid_preview":
        text = "these gains were driven with prediction, observer and estimator, of which Autoware's PID has none"
        remarks.append(Remark(RemarkKind.DIFFERS, "longitudinal = pid_preview", text))
    return remarks


def converter_keys(source: ExportValues, throttle: PedalMap, brake: PedalMap) -> dict[str, Any]:
    """Keys of the command converter. The steering goes through a constant ratio: the steering wheel's angle."""
    vehicle, limit_rad = source.vehicle, source.vehicle.steer_limit_rad
    rest_frac = vehicle.rest_pedal_frac  # pedals count from rest there, the vehicle's limits do not
    return {
        "csv_path_accel_map": ACCEL_MAP,
        "csv_path_brake_map": BRAKE_MAP,
        "convert_accel_cmd": True,
        "convert_brake_cmd": True,
        "convert_steer_cmd": True,
        "convert_steer_cmd_method": "vgr",
        "vgr_coef_a": source.vehicle.steer_ratio,
        "vgr_coef_b": 0.0,
        "vgr_coef_c": 0.0,
        "max_throttle": min(float(throttle.pedal_frac[-1]), vehicle.throttle_limit_frac - rest_frac),
        "max_brake": min(float(brake.pedal_frac[-1]), vehicle.brake_limit_frac - rest_frac),
        "max_steer": limit_rad,
        "min_steer": -limit_rad,
    }


def vehicle_keys(source: ExportValues) -> dict[str, Any]:
    """What vehicle.toml says of the vehicle's shape."""
    vehicle = source.vehicle
    keys = {"wheel_base": vehicle.wheelbase_m, "max_steer_angle": vehicle.steer_limit_rad / vehicle.steer_ratio}
    return keys if source.wheel_radius_m is None else {"wheel_radius": source.wheel_radius_m, **keys}


def map_remarks(source: ExportValues, throttle: PedalMap, brake: PedalMap) -> list[Remark]:
    """What the pedals count from, and how far the tables are from the bench's map."""
    rest_frac = source.vehicle.rest_pedal_frac
    of_throttle, of_brake = (largest_difference(one, source.calibration, rest_frac) for one in (throttle, brake))
    text = f"pedals count from rest, a duty of {rest_frac:g}: the vehicle interface adds it to accel_cmd and brake_cmd"
    accuracy = "Autoware interpolates between speeds first. Its accelerations differ from the bench's map by at most"
    accuracy += (
        f" {of_throttle.accel_mps2:.3f} m/s2 (throttle) and {of_brake.accel_mps2:.3f} m/s2 (brake), its pedals by"
    )
    accuracy += f" {100.0 * of_throttle.pedal_frac:.2f} % and {100.0 * of_brake.pedal_frac:.2f} % of duty"
    paths = "csv_path_accel_map and csv_path_brake_map are the files beside this one: give their full paths"
    which = "Autoware brakes where the map's released throttle is too fast, the bench where the demand is below 0"
    return [
        Remark(RemarkKind.DIFFERS, "pedals", text),
        Remark(RemarkKind.DIFFERS, "pedal tables", accuracy),
        Remark(RemarkKind.DIFFERS, "choice of the pedal", which),
        Remark(RemarkKind.ASSUMED, "paths of the tables", paths),
    ]


def other_remarks(source: ExportValues) -> list[Remark]:
    """Parts without a place in Autoware."""
    is_on = source.values["mrac.enable"] >= 0.5
    mrac = "Autoware has no inner loop around the steering actuator" + (
        "; the bench drove with MRAC on" if is_on else ""
    )
    return [
        Remark(
            RemarkKind.NOT_EXPORTED, "steer_map.csv", "a table of steering voltages; the bench commands angles (vgr)"
        ),
        Remark(RemarkKind.DIFFERS if is_on else RemarkKind.NOT_EXPORTED, "MRAC", mrac),
        Remark(
            RemarkKind.NOT_EXPORTED,
            "wheel_width, wheel_tread, overhangs, vehicle_height",
            "vehicle_info.param.yaml: not in vehicle.toml",
        ),
    ]
