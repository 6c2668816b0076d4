"""A small vehicle folder of its own for tests: CAN FD, 29-bit ids, Motorola order, P01 commands, P02 reports."""

from __future__ import annotations

from pathlib import Path

DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 2566844926 DRIVE: 12 A
 SG_ SUM : 23|8@0+ (1,0) [0|255] "" B
 SG_ ALIVE : 31|4@0+ (1,0) [0|14] "" B
 SG_ ID_HIGH : 27|4@0+ (1,0) [0|15] "" B
 SG_ EN : 47|1@0+ (1,0) [0|1] "" B
 SG_ THR : 7|12@0+ (0.025,0) [0|100] "%" B
 SG_ BRK : 63|14@0+ (0.01,0) [0|100] "%" B
 SG_ STEER : 79|16@0- (0.0005,0) [-16|16] "rad" B
BO_ 2566844927 STATE: 16 B
 SG_ CRC : 7|8@0+ (1,0) [0|255] "" A
 SG_ ALIVE : 11|4@0+ (1,0) [0|15] "" A
 SG_ SPEED : 23|16@0+ (0.005,0) [0|327.675] "m/s" A
 SG_ EN : 39|1@0+ (1,0) [0|1] "" A
BO_ 2566844928 EXTRA: 4 A
 SG_ CRC : 0|8@1+ (1,0) [0|255] "" B
 SG_ ALIVE : 12|4@1+ (1,0) [0|15] "" B
"""

P01 = '{ profile = "P01", data_ids = [0x123], id_mode = "nibble", crc = "SUM", counter = "ALIVE", nibble = "ID_HIGH" }'
P02 = f'{{ profile = "P02", data_ids = {list(range(10, 26))}, crc = "CRC", counter = "ALIVE" }}'

TOML = f"""schema = "tunefree.vehicle/1"
name = "little_fd"
dbc = ["vehicle.dbc"]
bitrate = 500000
data_bitrate = 2000000
absent = ["command.gear", "ins.x_m", "ins.y_m", "ins.heading_rad", "ins.speed_mps", "ins.accel_mps2",
    "ins.yaw_rate_radps", "report.wheel_speed_radps", "report.accel_mps2", "report.lateral_accel_mps2",
    "report.yaw_rate_radps", "report.gear", "report.steer_rad", "report.steer_command_rad",
    "report.throttle_frac", "report.throttle_command_frac", "report.throttle_input_frac", "report.brake_frac",
    "report.brake_command_frac", "report.brake_input_frac"]
[command.throttle_frac]
message = "DRIVE"
signal = "THR"
scale = 0.01
period_ms = 10
timeout_ms = 100
enable = "EN"
e2e = {P01}
[command.brake_frac]
message = "DRIVE"
signal = "BRK"
scale = 0.01
period_ms = 10
[command.steer_rad]
message = "DRIVE"
signal = "STEER"
period_ms = 10
[report.speed_mps]
message = "STATE"
signal = "SPEED"
period_ms = 20
e2e = {P02}
[extra.EXTRA]
kind = "command"
period_ms = 50
e2e = {P02}
[state]
enabled = [{{ message = "STATE", signal = "EN", bywire = "throttle" }}]
[limits]
steer_rad = 8.0
steer_rate_radps = 8.0
throttle_frac = 0.8
brake_frac = 0.5
"""


def write_car(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the folder with words replaced in its toml or DBC."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {"vehicle.toml": TOML, "vehicle.dbc": DBC}
    for old, new in changes:
        name = next(name for name, text in texts.items() if old in text)
        texts[name] = texts[name].replace(old, new, 1)
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder
