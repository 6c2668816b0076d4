/* What the controller computes: pure pursuit to the side, PI on the speed. Knows nothing of buses. */
#ifndef DRIVE_H
#define DRIVE_H

#include "path.h"

/* Announced by name; the tuner searches them. */
enum { LOOK_AHEAD_S, LOOK_AHEAD_LEAST_M, SPEED_KP, SPEED_KI, STATION_KP, PARAMETERS };
extern const char *const PARAMETER_NAMES[PARAMETERS];
extern const double PARAMETER_DEFAULTS[PARAMETERS];

typedef struct {
    double x_m, y_m, heading_rad, speed_mps; /* rear axle, from the INS frames */
} Seen;

typedef struct {
    double throttle_frac, brake_frac, steer_deg; /* pedal duty on the wire, angle of the steering wheel */
} Command;

typedef struct {
    int nearest;
    double integral_mps2;
    double lateral_m, heading_rad; /* errors against the path, vehicle - reference */
} Drive;

/* One cycle at tick k. */
Command drive_step(Drive *drive, const Path *path, const double parameters[PARAMETERS], const Seen *seen, int k);

#endif
