/* A controller that is not ours: a process that speaks the vehicle's DBC and dbc/bench.dbc, in C, with parameters of
 * its own that `tunefree-hil tune` searches. The page about it is docs/controller.md.
 *
 *   controller VEHICLE-BUS BENCH-BUS PATHS [TOKEN-FILE]
 *
 * VEHICLE-BUS, BENCH-BUS: tcp:127.0.0.1:PORT of a hub or socketcan:NAME. PATHS: the folder that
 * `tunefree-hil scenarios --export` wrote, or the {paths} of a bench file's command. Lockstep only. */
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

#include "bench.h"
#include "drive.h"
#include "link.h"
#include "path.h"
#include "vehicle.h"

enum { RUNNER, ECU, CONTROLLER };                                        /* ROLE */
enum { READY = 2, RUN = 3, FINISHED = 4, FAILED = 5, STOP = 6, END = 7 }; /* STATE */
enum { DIVERGED = 1, LEFT_LANE = 2, UNKNOWN_SCENARIO = 8 };              /* ERROR */
enum { FIRST_INDEX = 16, MOST = 64, PERIOD_MISC = 5, WAIT_MS = 5000, LOOK_MS = 1000 };
static const double TICK_S = 0.01, HALF_LANE_M = 2.0, QUARTER_TURN_RAD = 1.5707963267948966;
static const double RAD_PER_DEG = 0.017453292519943295;

typedef struct {
    Link *vehicle, *bench;
    const char *paths;
    Path path;
    Drive drive;
    Seen seen;
    int heard; /* bits: position, heading, speed */
    double parameters[PARAMETERS];
    uint8_t given[256];
    int parameters_left; /* PARAM frames still to come, -1: no EPISODE yet */
    int running, failed;
    uint8_t throttle_count, brake_count, steer_count;
    Frame waiting[MOST]; /* vehicle frames of the phase under way */
    int waiting_count;
} Node;

static void say(Node *node, const Frame *frame, double stamp_s)
{
    link_send(node->bench, frame, 1, stamp_s);
}

static void say_status(Node *node, int state, int error, uint32_t k)
{
    struct bench_status_t status = { CONTROLLER, (uint8_t)state, (uint16_t)error, k };
    Frame frame = { BENCH_STATUS_FRAME_ID, BENCH_STATUS_LENGTH, { 0 } };
    bench_status_pack(frame.data, &status, sizeof frame.data);
    say(node, &frame, k * TICK_S);
}

/* HELLO: our name, then a line "index name" for each parameter, four bytes a frame. */
static void say_hello(Node *node)
{
    char text[1024] = "pursuit";
    for (int i = 0; i < PARAMETERS; i++)
        snprintf(text + strlen(text), sizeof text - strlen(text), "\n%d %s", FIRST_INDEX + i, PARAMETER_NAMES[i]);
    uint16_t parts = (uint16_t)((strlen(text) + 3) / 4);
    for (uint16_t i = 0; i < parts; i++) {
        const uint8_t *chunk = (const uint8_t *)text + 4 * i;
        uint32_t four = (uint32_t)chunk[0] << 24 | (uint32_t)chunk[1] << 16 | (uint32_t)chunk[2] << 8 | chunk[3];
        struct bench_hello_t hello = { .role = CONTROLLER, .part = i, .parts = parts, .text = four };
        Frame frame = { BENCH_HELLO_FRAME_ID, BENCH_HELLO_LENGTH, { 0 } };
        bench_hello_pack(frame.data, &hello, sizeof frame.data);
        say(node, &frame, 0.0);
    }
}

/* DONE's digest: CRC-32 over id (4 bytes, little-endian) and data of each frame, its low 16 bits. */
static uint16_t digest(const Frame *frames, int count)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (int i = 0; i < count; i++)
        for (int j = 0; j < 4 + frames[i].length; j++) {
            crc ^= j < 4 ? frames[i].id >> (8 * j) & 0xFF : frames[i].data[j - 4];
            for (int bit = 0; bit < 8; bit++)
                crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
        }
    return (uint16_t)(~crc & 0xFFFF);
}

static void hear(Node *node, const Frame *frame)
{
    if (frame->id == VEHICLE_INS_POS_LOCAL_FRAME_ID) {
        struct vehicle_ins_pos_local_t said;
        vehicle_ins_pos_local_unpack(&said, frame->data, frame->length);
        node->seen.x_m = vehicle_ins_pos_local_pos_x_decode(said.pos_x);
        node->seen.y_m = vehicle_ins_pos_local_pos_y_decode(said.pos_y);
        node->heard |= 1;
    } else if (frame->id == VEHICLE_INS_VEL_YAW_LOCAL_FRAME_ID) {
        struct vehicle_ins_vel_yaw_local_t said;
        vehicle_ins_vel_yaw_local_unpack(&said, frame->data, frame->length);
        node->seen.heading_rad = vehicle_ins_vel_yaw_local_yaw_decode(said.yaw) * RAD_PER_DEG;
        node->heard |= 2;
    } else if (frame->id == VEHICLE_INS_VELOCITY_FRAME_ID) {
        struct vehicle_ins_velocity_t said;
        vehicle_ins_velocity_unpack(&said, frame->data, frame->length);
        node->seen.speed_mps = vehicle_ins_velocity_forward_decode(said.forward);
        node->heard |= 4;
    }
}

/* The command frames of a tick, in the order of their ids. EN is set from the first on. */
static int command_frames(Node *node, const Command *command, uint32_t k, Frame *out)
{
    struct vehicle_brake_cmd_t brake = { .pcmd = vehicle_brake_cmd_pcmd_encode(command->brake_frac),
                                         .cmd_type = VEHICLE_BRAKE_CMD_CMD_TYPE_PEDAL_CHOICE,
                                         .en = 1, .count = node->brake_count++ };
    struct vehicle_throttle_cmd_t throttle = { .pcmd = vehicle_throttle_cmd_pcmd_encode(command->throttle_frac),
                                               .cmd_type = VEHICLE_THROTTLE_CMD_CMD_TYPE_PEDAL_CHOICE,
                                               .en = 1, .count = node->throttle_count++ };
    struct vehicle_steering_cmd_t steer = { .scmd = vehicle_steering_cmd_scmd_encode(command->steer_deg), .en = 1,
                                            .svel = vehicle_steering_cmd_svel_encode(490.0),
                                            .count = node->steer_count++ };
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

/* Supervision (design D11): the drive is over where the lane is left or the car points across the path. */
static void supervise(Node *node, uint32_t k)
{
    int error = fabs(node->drive.heading_rad) > QUARTER_TURN_RAD ? DIVERGED
                : fabs(node->drive.lateral_m) > HALF_LANE_M      ? LEFT_LANE
                                                                 : 0;
    if (error) {
        node->failed = 1;
        fprintf(stderr, "controller: tick %u: error %d, commands stop\n", (unsigned)k, error);
        say_status(node, FAILED, error, k);
    }
}

/* Phase 1 of tick k: what phase 0 said is there in full. */
static void cycle(Node *node, uint32_t k)
{
    Frame out[5];
    int count = 0;
    for (int i = 0; i < node->waiting_count; i++)
        hear(node, node->waiting + i);
    node->waiting_count = 0;
    if (!node->failed) {
        Command command = { 0.15, 0.15, 0.0 }; /* rolling on, until all has been heard */
        if (node->heard == 7) {
            command = drive_step(&node->drive, &node->path, node->parameters, &node->seen, (int)k);
            supervise(node, k);
        }
        count = command_frames(node, &command, k, out);
    }
    link_send(node->vehicle, out, count, k * TICK_S);
    struct bench_done_t done = { k, 1, (uint8_t)count, digest(out, count) };
    Frame frame = { BENCH_DONE_FRAME_ID, BENCH_DONE_LENGTH, { 0 } };
    bench_done_pack(frame.data, &done, sizeof frame.data);
    say(node, &frame, k * TICK_S);
}

static void begin(Node *node, const Frame *frame)
{
    memset(&node->drive, 0, sizeof node->drive);
    memset(node->given, 0, sizeof node->given);
    node->heard = node->failed = node->waiting_count = node->running = 0;
    node->throttle_count = node->brake_count = node->steer_count = 0;
    memcpy(node->parameters, PARAMETER_DEFAULTS, sizeof node->parameters);
    node->parameters_left = 256;
    if (!path_load(&node->path, node->paths, frame->data)) {
        say_status(node, FAILED, UNKNOWN_SCENARIO, 0);
        exit(2);
    }
}

static void take_parameter(Node *node, const Frame *frame)
{
    struct bench_param_t said;
    bench_param_unpack(&said, frame->data, frame->length);
    if (node->parameters_left < 0)
        return;
    if (node->parameters_left == 256)
        node->parameters_left = said.count;
    if (!node->given[said.index]++ && --node->parameters_left == 0) {
        Frame old; /* what an ended episode left behind */
        while (link_take(node->vehicle, &old))
            ;
        say_status(node, READY, 0, 0);
        node->parameters_left = -1;
    }
    if (said.index >= FIRST_INDEX && said.index < FIRST_INDEX + PARAMETERS)
        node->parameters[said.index - FIRST_INDEX] = (double)said.value;
}

/* Whether the vehicle sends it: other nodes' frames do not count. */
static int is_report(uint32_t id)
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

/* DONE of the ECU: wait until the n_tx frames it announced have arrived. */
static void await_frames(Node *node, int count)
{
    if (count > MOST)
        fail(OWN_FAULT, "the ECU announced %d frames, %d are the most that are taken", count, MOST);
    while (node->waiting_count < count) {
        Frame *next = node->waiting + node->waiting_count;
        if (link_take(node->vehicle, next)) {
            node->waiting_count += is_report(next->id);
            continue;
        }
        struct pollfd ready = { link_fd(node->vehicle), POLLIN, 0 };
        if (poll(&ready, 1, WAIT_MS) <= 0)
            fail(BENCH_LOST, "the ECU announced %d frames, %d arrived", count, node->waiting_count);
    }
}

/* Without a hub nobody says that the bench is gone: end with whoever started us (docs/controller.md). */
static void follow_starter(void)
{
    const char *starter = getenv("TUNEFREE_STARTER");
    if (starter && *starter && getppid() != (pid_t)atol(starter))
        fail(BENCH_LOST, "whoever started this is gone");
}

static void answer(Node *node, const Frame *frame)
{
    if (frame->id == BENCH_EPISODE_FRAME_ID) {
        begin(node, frame);
    } else if (frame->id == BENCH_PARAM_FRAME_ID) {
        take_parameter(node, frame);
    } else if (frame->id == BENCH_HELLO_FRAME_ID) {
        struct bench_hello_t said;
        bench_hello_unpack(&said, frame->data, frame->length);
        if (said.role == RUNNER && said.part == 0)
            say_hello(node);
    } else if (frame->id == BENCH_DONE_FRAME_ID) {
        struct bench_done_t said;
        bench_done_unpack(&said, frame->data, frame->length);
        if (said.phase == 0 && node->running) {
            await_frames(node, said.n_tx);
            cycle(node, said.k);
        }
    } else if (frame->id == BENCH_STATUS_FRAME_ID) {
        struct bench_status_t said;
        bench_status_unpack(&said, frame->data, frame->length);
        if (said.role == RUNNER && said.state == END)
            exit(0);
        if (said.role == RUNNER && said.state == RUN)
            node->running = 1;
        else if (said.role == ECU && (said.state == FINISHED || said.state == FAILED))
            node->running = 0;
    }
}

int main(int count, char **words)
{
    static Node node;
    if (count < 4) {
        fprintf(stderr, "usage: %s VEHICLE-BUS BENCH-BUS PATHS [TOKEN-FILE]\n", words[0]);
        return 2;
    }
    const char *token_file = count > 4 && words[4][0] ? words[4] : NULL;
    node.paths = words[3];
    node.parameters_left = -1;
    node.vehicle = link_open(words[1], token_file, "controller");
    node.bench = link_open(words[2], token_file, "controller");
    say_hello(&node);
    for (;;) {
        Frame frame;
        while (link_take(node.bench, &frame))
            answer(&node, &frame);
        struct pollfd ready = { link_fd(node.bench), POLLIN, 0 };
        if (poll(&ready, 1, LOOK_MS) == 0)
            follow_starter();
    }
}
