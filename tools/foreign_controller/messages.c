#include "messages.h"

#include <stddef.h>
#include <string.h>

#include "vehicle.h"

enum { PERIOD_MISC = 5 };
static const double RAD_PER_DEG = 0.017453292519943295;

void hear(Seen *seen, int *heard, const Frame *frame)
{
    if (frame->id == VEHICLE_INS_POS_LOCAL_FRAME_ID) {
        struct vehicle_ins_pos_local_t said;
        if (vehicle_ins_pos_local_unpack(&said, frame->data, frame->length) < 0)
            return; /* shorter than the DBC says */
        seen->x_m = vehicle_ins_pos_local_pos_x_decode(said.pos_x);
        seen->y_m = vehicle_ins_pos_local_pos_y_decode(said.pos_y);
        *heard |= 1;
    } else if (frame->id == VEHICLE_INS_VEL_YAW_LOCAL_FRAME_ID) {
        struct vehicle_ins_vel_yaw_local_t said;
        if (vehicle_ins_vel_yaw_local_unpack(&said, frame->data, frame->length) < 0)
            return; /* shorter than the DBC says */
        seen->heading_rad = vehicle_ins_vel_yaw_local_yaw_decode(said.yaw) * RAD_PER_DEG;
        *heard |= 2;
    } else if (frame->id == VEHICLE_INS_VELOCITY_FRAME_ID) {
        struct vehicle_ins_velocity_t said;
        if (vehicle_ins_velocity_unpack(&said, frame->data, frame->length) < 0)
            return; /* shorter than the DBC says */
        seen->speed_mps = vehicle_ins_velocity_forward_decode(said.forward);
        *heard |= 4;
    }
}

int command_frames(Counts *counts, const Command *command, uint32_t k, Frame *out)
{
    struct vehicle_brake_cmd_t brake = { .pcmd = vehicle_brake_cmd_pcmd_encode(command->brake_frac),
                                         .cmd_type = VEHICLE_BRAKE_CMD_CMD_TYPE_PEDAL_CHOICE,
                                         .en = 1, .count = counts->brake++ };
    struct vehicle_throttle_cmd_t throttle = { .pcmd = vehicle_throttle_cmd_pcmd_encode(command->throttle_frac),
                                               .cmd_type = VEHICLE_THROTTLE_CMD_CMD_TYPE_PEDAL_CHOICE,
                                               .en = 1, .count = counts->throttle++ };
    struct vehicle_steering_cmd_t steer = { .scmd = vehicle_steering_cmd_scmd_encode(command->steer_deg), .en = 1,
                                            .svel = vehicle_steering_cmd_svel_encode(490.0),
                                            .count = counts->steer++ };
    struct vehicle_gear_cmd_t gear = { .gcmd = VEHICLE_GEAR_CMD_GCMD_DRIVE_CHOICE };
    struct vehicle_misc_cmd_t misc = { .trncmd = VEHICLE_MISC_CMD_TRNCMD_NONE_CHOICE };
    memset(out, 0, 5 * sizeof *out);
    out[0] = (Frame){ VEHICLE_BRAKE_CMD_FRAME_ID, VEHICLE_BRAKE_CMD_LENGTH, { 0 } };
    vehicle_brake_cmd_pack(out[0].data, &brake, 8);
    out[1] = (Frame){ VEHICLE_THROTTLE_CMD_FRAME_ID, VEHICLE_THROTTLE_CMD_LENGTH, { 0 } };
    vehicle_throttle_cmd_pack(out[1].data, &throttle, 8);
    out[2] = (Frame){ VEHICLE_STEERING_CMD_FRAME_ID, VEHICLE_STEERING_CMD_LENGTH, { 0 } };
    vehicle_steering_cmd_pack(out[2].data, &steer, 8);
    out[3] = (Frame){ VEHICLE_GEAR_CMD_FRAME_ID, VEHICLE_GEAR_CMD_LENGTH, { 0 } };
    vehicle_gear_cmd_pack(out[3].data, &gear, 8);
    out[4] = (Frame){ VEHICLE_MISC_CMD_FRAME_ID, VEHICLE_MISC_CMD_LENGTH, { 0 } };
    vehicle_misc_cmd_pack(out[4].data, &misc, 8);
    return k % PERIOD_MISC == 0 ? 5 : 4;
}

int is_report(uint32_t id)
{
    static const uint32_t REPORTS[] = {
        VEHICLE_BRAKE_REPORT_FRAME_ID,         VEHICLE_THROTTLE_REPORT_FRAME_ID, VEHICLE_STEERING_REPORT_FRAME_ID,
        VEHICLE_GEAR_REPORT_FRAME_ID,          VEHICLE_WHEEL_SPEED_FRAME_ID,     VEHICLE_ACCEL_FRAME_ID,
        VEHICLE_GYRO_FRAME_ID,                 VEHICLE_INS_POS_LOCAL_FRAME_ID,   VEHICLE_INS_VEL_YAW_LOCAL_FRAME_ID,
        VEHICLE_INS_ANGULAR_VELOCITY_FRAME_ID, VEHICLE_INS_VELOCITY_FRAME_ID,    VEHICLE_INS_ACCELERATION_FRAME_ID,
    };
    for (size_t i = 0; i < sizeof REPORTS / sizeof *REPORTS; i++)
        if (REPORTS[i] == id)
            return 1;
    return 0;
}
