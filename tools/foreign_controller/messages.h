/* The vehicle's frames: what is heard of its reports, what its commands are made of. */
#ifndef MESSAGES_H
#define MESSAGES_H

#include <stdint.h>

#include "drive.h"
#include "link.h"

enum { HEARD_ALL = 7, MOST_COMMANDS = 5 };

typedef struct {
    uint8_t throttle, brake, steer; /* rolling counters of the command frames */
} Counts;

/* Whether the vehicle sends it: other nodes' frames do not count. */
int is_report(uint32_t id);

/* Take what a report says; heard: bits for position, heading and speed, HEARD_ALL when all have come. */
void hear(Seen *seen, int *heard, const Frame *frame);

/* The command frames of tick k, in the order of their ids; how many. EN is set from the first on. */
int command_frames(Counts *counts, const Command *command, uint32_t k, Frame *out);

#endif
