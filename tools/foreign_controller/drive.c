#include "drive.h"

#include <math.h>

const char *const PARAMETER_NAMES[PARAMETERS] = {
    [LOOK_AHEAD_S] = "pursuit.look_ahead_s", [LOOK_AHEAD_LEAST_M] = "pursuit.look_ahead_least_m",
    [SPEED_KP] = "pi.kp",                    [SPEED_KI] = "pi.ki",
    [STATION_KP] = "pi.station_kp",
};
const double PARAMETER_DEFAULTS[PARAMETERS] = { 0.8, 3.0, 1.0, 0.3, 0.3 };

/* Of the by-wire sedan of dbc/mkz_bywire: vehicle.toml [nominal] and [limits]. */
static const double WHEELBASE_M = 2.8448, STEER_RATIO = 16.0, REST_FRAC = 0.15, STEER_LIMIT_DEG = 470.0;
static const double THROTTLE_LIMIT_FRAC = 0.8, BRAKE_LIMIT_FRAC = 0.5, TICK_S = 0.01, DEG_PER_RAD = 57.29577951308232;
/* Rough slopes of its pedals; the integral takes up what they miss. */
static const double THROTTLE_PER_MPS2 = 0.09, BRAKE_PER_MPS2 = 0.03, BRAKE_STEP_FRAC = 0.05, DEAD_MPS2 = 0.3;

static double within(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* Pure pursuit: the arc through the rear axle that meets the path ld ahead has curvature 2 y / ld^2. */
static double steer_deg(Drive *drive, const Path *path, const double *parameters, const Seen *seen)
{
    double wanted_m = fmax(parameters[LOOK_AHEAD_LEAST_M], parameters[LOOK_AHEAD_S] * seen->speed_mps);
    const Point *goal = path->points + path_ahead(path, drive->nearest, wanted_m);
    double dx = goal->x_m - seen->x_m, dy = goal->y_m - seen->y_m;
    double side_m = -sin(seen->heading_rad) * dx + cos(seen->heading_rad) * dy;
    double away2 = fmax(dx * dx + dy * dy, 1.0);
    double road_wheel_rad = atan(WHEELBASE_M * 2.0 * side_m / away2);
    return within(STEER_RATIO * road_wheel_rad * DEG_PER_RAD, -STEER_LIMIT_DEG, STEER_LIMIT_DEG);
}

Command drive_step(Drive *drive, const Path *path, const double parameters[PARAMETERS], const Seen *seen, int k)
{
    drive->nearest = path_nearest(path, seen->x_m, seen->y_m, drive->nearest);
    const Point *near = path->points + drive->nearest;
    const Point *now = path->points + (k < path->count ? k : path->count - 1);
    drive->lateral_m = -sin(near->heading_rad) * (seen->x_m - near->x_m) + cos(near->heading_rad) * (seen->y_m - near->y_m);
    drive->heading_rad = remainder(seen->heading_rad - near->heading_rad, 6.283185307179586);

    double station_m = now->station_m - near->station_m;
    double error_mps = now->speed_mps - seen->speed_mps + parameters[STATION_KP] * station_m;
    double wish = now->accel_mps2 + parameters[SPEED_KP] * error_mps + drive->integral_mps2;
    if (fabs(wish) < 4.0) /* no wind-up where the pedals are at their ends */
        drive->integral_mps2 += parameters[SPEED_KI] * error_mps * TICK_S;

    Command command = { REST_FRAC, REST_FRAC, steer_deg(drive, path, parameters, seen) };
    if (now->speed_mps < 0.05 && seen->speed_mps < 0.3)
        command.brake_frac = 0.3; /* stand */
    else if (wish > 0.0)
        command.throttle_frac = within(REST_FRAC + THROTTLE_PER_MPS2 * wish, REST_FRAC, THROTTLE_LIMIT_FRAC);
    else if (wish < -DEAD_MPS2)
        command.brake_frac = within(REST_FRAC + BRAKE_STEP_FRAC - BRAKE_PER_MPS2 * wish, REST_FRAC, BRAKE_LIMIT_FRAC);
    return command;
}
