/* A controller that is not ours: a process that speaks the vehicle's DBC and dbc/bench.dbc, in C, with parameters of
 * its own that `tunefree-hil tune` searches. The page about it is docs/how-to/own_controller.md.
 *
 *   controller VEHICLE-BUS BENCH-BUS PATHS [TOKEN-FILE]
 *
 * VEHICLE-BUS, BENCH-BUS: tcp:127.0.0.1:PORT of a hub or socketcan:NAME. PATHS: the folder that
 * `tunefree-hil scenarios --export` wrote, or the {paths} of a bench file's command. TUNEFREE_REALTIME=1: it is not
 * waited for (the environment of whoever starts it says so). */
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
#include "messages.h"
#include "path.h"

enum { RUNNER, ECU, CONTROLLER };                                        /* ROLE */
enum { READY = 2, RUN = 3, FINISHED = 4, FAILED = 5, STOP = 6, END = 7 }; /* STATE */
enum { DIVERGED = 1, LEFT_LANE = 2, UNKNOWN_SCENARIO = 8 };              /* ERROR */
enum { FIRST_INDEX = 16, MOST = 64, WAIT_MS = 5000, LOOK_MS = 1000 };
static const double TICK_S = 0.01, HALF_LANE_M = 2.0, QUARTER_TURN_RAD = 1.5707963267948966;

typedef struct {
    Link *vehicle, *bench;
    const char *paths;
    Path path;
    Drive drive;
    Seen seen;
    int heard;
    double parameters[PARAMETERS];
    uint8_t given[256];
    int parameters_left; /* PARAM frames still to come, -1: no EPISODE yet */
    int running, failed;
    int realtime, begun; /* begun: the DONE before tick 0 has come */
    Counts counts;
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

/* Supervision (docs/reference/grading.md): the drive is over where the lane is left or the car points across the path. */
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

static void hear_all(Node *node)
{
    for (int i = 0; i < node->waiting_count; i++)
        hear(&node->seen, &node->heard, node->waiting + i);
    node->waiting_count = 0;
}

/* Phase 1 of tick k: the commands by what has been heard. */
static void cycle(Node *node, uint32_t k)
{
    Frame out[MOST_COMMANDS];
    int count = 0;
    if (!node->failed) {
        Command command = { 0.15, 0.15, 0.0 }; /* rolling on, until all has been heard */
        if (node->heard == HEARD_ALL) {
            command = drive_step(&node->drive, &node->path, node->parameters, &node->seen, (int)k);
            supervise(node, k);
        }
        count = command_frames(&node->counts, &command, k, out);
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
    node->heard = node->failed = node->waiting_count = node->running = node->begun = 0;
    memset(&node->counts, 0, sizeof node->counts);
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
    if (bench_param_unpack(&said, frame->data, frame->length) < 0)
        return;
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

/* Without a hub nobody says that the bench is gone: end with whoever started us (docs/how-to/own_controller.md). */
static void follow_starter(void)
{
    const char *starter = getenv("TUNEFREE_STARTER");
    if (starter && *starter && getppid() != (pid_t)atol(starter))
        fail(BENCH_LOST, "whoever started this is gone");
}

/* DONE k of the ECU. In lockstep what it announced counts in tick k. In real time tick k's frames leave as its deadline
 * passes, so they count from k + 1 on, and the frames that count in tick 0 come with a DONE of their own before it. */
static void done(Node *node, uint32_t k, int count)
{
    await_frames(node, count);
    if (!node->realtime)
        hear_all(node);
    if (!node->realtime || node->begun++)
        cycle(node, k);
    hear_all(node);
}

static void answer(Node *node, const Frame *frame)
{
    if (frame->id == BENCH_EPISODE_FRAME_ID) {
        begin(node, frame);
    } else if (frame->id == BENCH_PARAM_FRAME_ID) {
        take_parameter(node, frame);
    } else if (frame->id == BENCH_HELLO_FRAME_ID) {
        struct bench_hello_t said;
        if (bench_hello_unpack(&said, frame->data, frame->length) < 0)
            return;
        if (said.role == RUNNER && said.part == 0)
            say_hello(node);
    } else if (frame->id == BENCH_DONE_FRAME_ID) {
        struct bench_done_t said;
        if (bench_done_unpack(&said, frame->data, frame->length) < 0)
            return;
        if (said.phase == 0 && node->running)
            done(node, said.k, said.n_tx);
    } else if (frame->id == BENCH_STATUS_FRAME_ID) {
        struct bench_status_t said;
        if (bench_status_unpack(&said, frame->data, frame->length) < 0)
            return;
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
    const char *realtime = getenv("TUNEFREE_REALTIME");
    node.realtime = realtime && !strcmp(realtime, "1");
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
