/* The reference drive of an episode, as `tunefree-hil scenarios --export DIR` writes it. */
#ifndef PATH_H
#define PATH_H

typedef struct {
    double t_s, x_m, y_m, heading_rad, speed_mps, accel_mps2, curvature_1pm, station_m;
} Point;

typedef struct {
    int count; /* one point a tick */
    Point *points;
} Path;

/* Reads DIR/<start>.csv; start: the first 6 bytes of the scenario's hash. 0 when there is no such file. */
int path_load(Path *path, const char *folder, const unsigned char start[6]);

/* Index of the point nearest to (x, y), searched from `from` a little back and some way ahead. */
int path_nearest(const Path *path, double x_m, double y_m, int from);

/* Index of the first point at least ahead_m further along the path than point i; the last one at the end. */
int path_ahead(const Path *path, int i, double ahead_m);

#endif
