"""Apollo's configuration files: text protos of lateral and longitudinal control, calibration table, vehicle constants.

Field names are those of ApolloAuto/apollo (modules/control/proto, modules/control/controllers/*/proto,
modules/common/configs/proto/vehicle_config.proto); values are in Apollo's units: pedals and steering in percent, mass
by wheel. Commands of the table are negative for the brake.
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.kernel import buffer
from tunefree_hil.base.maths import lerp_table
from tunefree_hil.control.follower import PREVIEW_S
from tunefree_hil.control.lateral import lqr
from tunefree_hil.control.longitudinal import pid
from tunefree_hil.control.mrac_model import second_order_p
from tunefree_hil.control.parameters import RICCATI_CODES
from tunefree_hil.control.riccati import (
    SHIPPED_ROUNDS,
    SHIPPED_TOLERANCE,
    fill_gain,
    make_buffers,
    recurse,
    solve_gain,
)
from tunefree_hil.jobs.export.number_text import format_number
from tunefree_hil.jobs.export.remarks import Export, ExportFile, PartExport, Remark, RemarkKind
from tunefree_hil.jobs.export.text_proto import Message, render
from tunefree_hil.jobs.export.values import ExportValues

LQR_PARTS, PID_PARTS = ("lqr", "lqr_preview"), ("pid", "pid_preview")
LQR_NAMES = ("lqr.q1", "lqr.q2", "lqr.q3", "lqr.q4", "look_ahead_m", "riccati")
PID_NAMES = ("station.kp", "speed.kp_low", "speed.ki_low", "speed.kp_high", "speed.ki_high")
MRAC_NAMES = ("mrac.enable", "mrac.t_ref_s", "mrac.p", "mrac.gamma", "mrac.clamp_s")
TABLE_DIGITS = 6  # decimal places of the calibration table
# What Apollo's files need and the bench has no value for: those of docs/reference/apollo.md.
FILTER_WINDOW = 10  # of the mean filter, which navigation mode alone uses
PITCH_CUTOFF_HZ = 5  # of the slope term, which is off
SWITCH_WINDOW_MPS = 1.0  # over which the low-speed lead-lag fades, which is off
ENOUGH_SHARE, ENOUGH_MPS, LARGEST_ROUNDS = 0.95, 4.0, 10000  # of a hint on max_iteration
COMPARED_MPS = (1.0, 4.0, 12.0)  # speeds at which the gains of both solvers are compared
# The shipped tolerance, 0.01, is of the size of P: with weights well below the shipped ones the recursion would stop in
# its first round, with no gain at all. Gains that were driven with the converged equation are exported with this one.
SMALL_TOLERANCE = 1e-9

HEAD = """\
# Replace the messages of the same name in modules/control/conf/control_conf.pb.txt (Apollo 6, 7, Apollo Lite).
# Flags in control.conf (fields of this file in Apollo Lite): enable_gain_scheduler and set_steer_limit true,
# enable_slope_offset false.
"""


def export_apollo(source: ExportValues) -> Export:
    """The files for Apollo 6 and 7 (one control_conf.pb.txt) and for Apollo 8 and later (one file a controller)."""
    lateral, longitudinal, table = make_lateral(source), make_longitudinal(source), calibration_table(source)
    files, together = [], HEAD
    if lateral.content is not None:
        together += render(Message(lat_controller_conf=lateral.content))
        newer = Message()
        newer.fields = [*lateral.content.fields, *lateral_of_newer().fields]
        files.append(ExportFile("apollo_8/lat_based_lqr_controller/conf/controller_conf.pb.txt", render(newer)))
    if longitudinal.content is not None:
        with_table = Message(calibration_table=table)
        with_table.fields = [*longitudinal.content.fields, *with_table.fields]
        together += render(Message(lon_controller_conf=with_table))
        files.append(
            ExportFile("apollo_8/lon_based_pid_controller/conf/controller_conf.pb.txt", render(longitudinal.content))
        )
    files.append(ExportFile("apollo_8/control_task_base/conf/calibration_table.pb.txt", render(table)))
    files.append(ExportFile("vehicle_param.pb.txt", render(Message(vehicle_param=vehicle_param(source)))))
    if lateral.content is not None or longitudinal.content is not None:
        files.insert(0, ExportFile("apollo_6_7/control_conf.pb.txt", together))
    remarks = [*lateral.remarks, *longitudinal.remarks, *vehicle_remarks(source)]
    return Export(files, remarks, frozenset((*lateral.names, *longitudinal.names)))


def make_lateral(source: ExportValues) -> PartExport:
    """The LQR and its MRAC; no message where the lateral part is another one."""
    if source.parts.lateral not in LQR_PARTS:
        text = "Apollo's LQR has no values for it; its lateral files are not written"
        return PartExport(None, (), [Remark(RemarkKind.NOT_EXPORTED, f"lateral = {source.parts.lateral}", text)])
    values, vehicle, mrac = source.values, source.vehicle, make_mrac(source)
    weights = [values[name] for name in LQR_NAMES[:4]]
    per_wheel = wheel_masses_kg(source)
    message = Message(
        ts=source.dt_s,
        preview_window=0,
        cf=vehicle.front_stiffness_n_per_rad,
        cr=vehicle.rear_stiffness_n_per_rad,
        mass_fl=per_wheel.front,
        mass_fr=per_wheel.front,
        mass_rl=per_wheel.rear,
        mass_rr=per_wheel.rear,
        eps=SHIPPED_TOLERANCE if is_capped(source) else SMALL_TOLERANCE,
        matrix_q=weights,
        reverse_matrix_q=weights,
        cutoff_freq=round(source.settings.cutoff_hz),
        mean_filter_window_size=FILTER_WINDOW,
        max_iteration=SHIPPED_ROUNDS,
        max_lateral_acceleration=vehicle.lateral_accel_mps2,
        enable_reverse_leadlag_compensation=False,
        enable_steer_mrac_control=mrac.content is not None and values["mrac.enable"] >= 0.5,
        enable_look_ahead_back_control=values["look_ahead_m"] > 0.0,
        lookahead_station=values["look_ahead_m"],
        lookahead_station_high_speed=values["look_ahead_m"],
        lat_err_gain_scheduler=scheduler(lqr.LATERAL_RATIO),
        heading_err_gain_scheduler=scheduler(lqr.HEADING_RATIO),
    )
    if mrac.content is not None:
        message.fields.append(("steer_mrac_conf", mrac.content))
    names = (*LQR_NAMES, *mrac.names)
    return PartExport(message, names, [*mrac.remarks, *lateral_remarks(source)])


def lateral_of_newer() -> Message:
    """Fields that Apollo 8 moved into the lateral file; at a switch speed the lead-lag, which is off, would fade."""
    return Message(
        switch_speed=lqr.LOW_SPEED_MPS,
        switch_speed_window=SWITCH_WINDOW_MPS,
        trajectory_transform_to_com_drive=True,
        enable_maximum_steer_rate_limit=False,
    )


def is_capped(source: ExportValues) -> bool:
    """Whether the gains were driven with Apollo's solver."""
    return source.parts.lateral == "lqr" and source.values["riccati"] == RICCATI_CODES["apollo150"]


def scheduler(ratios: tuple[float, ...]) -> Message:
    """Ratio by speed."""
    steps = zip(lqr.SCHEDULE_MPS, ratios, strict=True)
    return Message(scheduler=[Message(speed=speed_mps, ratio=ratio) for speed_mps, ratio in steps])


class WheelMasses(NamedTuple):
    """kg on each front and each rear wheel."""

    front: int
    rear: int


def wheel_masses_kg(source: ExportValues) -> WheelMasses:
    """Apollo finds the centre of mass from these whole numbers."""
    vehicle = source.vehicle
    share = 0.5 * vehicle.mass_kg / vehicle.wheelbase_m
    return WheelMasses(round(share * vehicle.rear_axle_m), round(share * vehicle.front_axle_m))


def make_mrac(source: ExportValues) -> PartExport:
    """Apollo has the laws of order 1 and 2 of mrac.py; everything else is exported as MRAC off."""
    values, settings = source.values, source.settings
    reason = ""
    if source.parts.inner != "mrac":
        reason = f"inner = {source.parts.inner} is not Apollo's law"
    elif settings.mrac_form != "apollo":
        reason = f"mrac_form = '{settings.mrac_form}' is not Apollo's law"
    elif settings.mrac_order > 2:
        reason = f"Apollo refuses a reference model of order {settings.mrac_order}"
    if reason:
        is_on = values["mrac.enable"] >= 0.5
        kind = RemarkKind.DIFFERS if is_on else RemarkKind.NOT_EXPORTED
        text = f"{reason}; steering is exported with MRAC off" + (", the bench drove with MRAC on" if is_on else "")
        return PartExport(None, (), [Remark(kind, "MRAC", text)])
    order, p = settings.mrac_order, second_order_p(values["mrac.p"], settings)
    message = Message(
        mrac_model_order=order,
        reference_time_constant=values["mrac.t_ref_s"],
        reference_natural_frequency=settings.mrac_natural_radps,
        reference_damping_ratio=settings.mrac_damping,
        adaption_state_gain=values["mrac.gamma"],
        adaption_desired_gain=values["mrac.gamma"],
        adaption_nonlinear_gain=values["mrac.gamma"],
        adaption_matrix_p=[values["mrac.p"]] if order == 1 else [p.p11, p.p12, p.p12, p.p22],
        mrac_saturation_level=1.0,
        anti_windup_compensation_gain=settings.mrac_anti_windup,
        clamping_time_constant=values["mrac.clamp_s"],
    )
    remarks = []
    if settings.mrac_dead_zone > 0.0 and values["mrac.enable"] >= 0.5:
        text = f"the bench does not adapt to errors below {settings.mrac_dead_zone:g} % of the steering limit; "
        text += "Apollo has no dead zone, so its gains drift on straight roads"
        remarks.append(Remark(RemarkKind.DIFFERS, "mrac_dead_zone", text))
    return PartExport(message, MRAC_NAMES, remarks)


def lateral_remarks(source: ExportValues) -> list[Remark]:
    """How Apollo's lateral control differs from the one that was driven."""
    remarks = []
    if source.parts.lateral == "lqr_preview":
        text = "these weights were driven with the steering map, preview and prediction over the dead time, of which"
        text += " Apollo's LQR has none: the same weights may swing there. Tune with lateral = 'lqr' for Apollo"
        remarks.append(Remark(RemarkKind.DIFFERS, "lateral = lqr_preview", text))
        remarks += [
            Remark(RemarkKind.NOT_EXPORTED, name, f"{format_number(value)}; part of lqr_preview")
            for name, value in source.values.items()
            if name.startswith("steer.")
        ]
    if source.parts.lateral == "lqr" and not is_capped(source):
        remarks.append(Remark(RemarkKind.DIFFERS, "riccati = converged", describe_riccati(source)))
    inertia_kgm2 = source.vehicle.mass_kg * source.vehicle.front_axle_m * source.vehicle.rear_axle_m
    text = f"{source.vehicle.yaw_inertia_kgm2:g} kg m2; Apollo computes it from the wheel masses: {inertia_kgm2:.0f}"
    remarks.append(Remark(RemarkKind.NOT_EXPORTED, "yaw inertia", text))
    text = "the forward weights; the bench does not drive in reverse"
    return [*remarks, Remark(RemarkKind.ASSUMED, "reverse_matrix_q", text)]


def describe_riccati(source: ExportValues) -> str:
    """What Apollo's rounds leave of the gain on the lateral error, at COMPARED_MPS."""
    shares = [f"{100.0 * capped_share(source, speed_mps):.0f} % at {speed_mps:g} m/s" for speed_mps in COMPARED_MPS]
    text = f"Apollo stops after {SHIPPED_ROUNDS} rounds: of the driven gain on the lateral error it has"
    more = f"max_iteration: {needed_rounds(source)} gives {100.0 * ENOUGH_SHARE:.0f} % at {ENOUGH_MPS:g} m/s"
    return f"{text} {', '.join(shares)}. Tune with riccati = 'apollo150' for Apollo. {more}, and takes longer"


def needed_rounds(source: ExportValues) -> int:
    """Rounds, in hundreds, that give ENOUGH_SHARE of the driven gain at ENOUGH_MPS."""
    rounds = 100
    while rounds < LARGEST_ROUNDS and capped_share(source, ENOUGH_MPS, rounds) < ENOUGH_SHARE:
        rounds += 100
    return rounds


def capped_share(source: ExportValues, speed_mps: float, rounds: int = SHIPPED_ROUNDS) -> float:
    """K1 after so many rounds with the exported tolerance, over the converged one."""
    a, b = lqr.model(speed_mps, source.vehicle, source.dt_s)
    q, p, gain, work = buffer(16), buffer(16), buffer(4), make_buffers(4)
    ratios = (lqr.LATERAL_RATIO, None, lqr.HEADING_RATIO, None)
    for i, (name, ratio) in enumerate(zip(LQR_NAMES[:4], ratios, strict=True)):
        scheduled = 1.0 if ratio is None else lerp_table(lqr.SCHEDULE_MPS, ratio, speed_mps)
        q[5 * i] = source.values[name] * scheduled
    solve_gain(gain, p, a, b, q, lqr.INPUT_WEIGHT, 4, False, work)
    converged = float(gain[0])
    recurse(p, a, b, q, lqr.INPUT_WEIGHT, 4, rounds, SMALL_TOLERANCE, work.w, work.row)
    fill_gain(gain, p, a, b, lqr.INPUT_WEIGHT, 4)
    return float(gain[0]) / converged if converged != 0.0 else 1.0


def make_longitudinal(source: ExportValues) -> PartExport:
    """Station and speed PID; no message where the longitudinal part is another one."""
    if source.parts.longitudinal not in PID_PARTS:
        text = "Apollo's PID has no values for it; its longitudinal files are not written, except the table"
        return PartExport(
            None, (), [Remark(RemarkKind.NOT_EXPORTED, f"longitudinal = {source.parts.longitudinal}", text)]
        )
    values = source.values
    station = pid_conf(values["station.kp"], 0.0)
    low = pid_conf(values["speed.kp_low"], values["speed.ki_low"])
    high = pid_conf(values["speed.kp_high"], values["speed.ki_high"])
    message = Message(
        ts=source.dt_s,
        brake_minimum_action=0.0,
        throttle_minimum_action=0.0,
        speed_controller_input_limit=pid.SPEED_LIMIT_MPS,
        station_error_limit=pid.STATION_LIMIT_M,
        preview_window=float(round(values.get("speed.preview_s", PREVIEW_S) / source.dt_s)),
        standstill_acceleration=pid.STANDSTILL_MPS2,
        station_pid_conf=station,
        low_speed_pid_conf=low,
        high_speed_pid_conf=high,
        switch_speed=pid.SWITCH_MPS,
        switch_speed_window=SWITCH_WINDOW_MPS,
        reverse_station_pid_conf=station,
        reverse_speed_pid_conf=low,
        pitch_angle_filter_conf=Message(cutoff_freq=PITCH_CUTOFF_HZ),
        enable_reverse_leadlag_compensation=False,
    )
    names = (*PID_NAMES, *(("speed.preview_s",) if "speed.preview_s" in values else ()))
    return PartExport(message, names, longitudinal_remarks(source))


def longitudinal_remarks(source: ExportValues) -> list[Remark]:
    """How Apollo's longitudinal control differs from the one that was driven."""
    remarks = [
        Remark(RemarkKind.ASSUMED, "reverse_station_pid_conf, reverse_speed_pid_conf", "the forward gains up to 3 m/s"),
        Remark(RemarkKind.ASSUMED, "pitch_angle_filter_conf", "as shipped; the slope term is off"),
    ]
    if source.parts.longitudinal == "pid_preview":
        text = "these gains were driven with prediction, observer and estimator, of which Apollo's PID has none"
        remarks.append(Remark(RemarkKind.DIFFERS, "longitudinal = pid_preview", text))
        remarks += [
            Remark(RemarkKind.NOT_EXPORTED, name, f"{format_number(source.values[name])}; part of pid_preview")
            for name in ("speed.predict", "speed.observer_radps", "speed.filter_s", "pedals.hysteresis_mps2")
            if name in source.values
        ]
    text = "the bench releases a pedal to its rest duty, Apollo commands 0 there (docs/reference/apollo.md)"
    return [*remarks, Remark(RemarkKind.DIFFERS, "released pedals", text)]


def pid_conf(kp: float, ki: float) -> Message:
    """A PID with Apollo's limit of the integral."""
    return Message(
        integrator_enable=ki != 0.0, integrator_saturation_level=pid.INTEGRAL_LIMIT_MPS2, kp=kp, ki=ki, kd=0.0
    )


def calibration_table(source: ExportValues) -> Message:
    """Triples of speed, acceleration and command in percent, by speed and acceleration."""
    rows = sorted(zip(*source.triples, strict=True))
    places = {(round(speed, TABLE_DIGITS), round(accel, TABLE_DIGITS)): command for speed, accel, command in rows}
    return Message(
        calibration=[
            Message(speed=speed, acceleration=accel, command=round(100.0 * command, TABLE_DIGITS))
            for (speed, accel), command in places.items()
        ]
    )


def vehicle_param(source: ExportValues) -> Message:
    """Constants that the controllers read there; dead zones are the pedals' rest."""
    vehicle, rest_percent = source.vehicle, 100.0 * source.vehicle.rest_pedal_frac
    message = Message(
        max_acceleration=vehicle.accel_high_mps2,
        max_deceleration=vehicle.accel_low_mps2,
        max_steer_angle=vehicle.steer_limit_rad,
        max_steer_angle_rate=vehicle.steer_rate_radps,
        steer_ratio=vehicle.steer_ratio,
        wheel_base=vehicle.wheelbase_m,
        brake_deadzone=rest_percent,
        throttle_deadzone=rest_percent,
        steering_latency_param=Message(
            dead_time=vehicle.steer_dead_time_s, rise_time=vehicle.steer_rise_time_s, peak_time=0.0, settling_time=0.0
        ),
    )
    if source.wheel_radius_m is not None:
        message.fields.append(("wheel_rolling_radius", source.wheel_radius_m))
    return message


def vehicle_remarks(source: ExportValues) -> list[Remark]:
    """What vehicle_param.pb.txt lacks, and what whole numbers do to the mass."""
    masses, vehicle = wheel_masses_kg(source), source.vehicle
    total_kg = 2 * (masses.front + masses.rear)
    remarks = [
        Remark(
            RemarkKind.NOT_EXPORTED,
            "dimensions of the body",
            "vehicle_param.pb.txt has the constants of the controllers only; merge it into yours",
        )
    ]
    if abs(total_kg - vehicle.mass_kg) > 0.0:
        text = f"{total_kg} kg instead of {vehicle.mass_kg:g} kg: Apollo's wheel masses are whole numbers"
        remarks.append(Remark(RemarkKind.DIFFERS, "mass", text))
    return remarks
