#include "path.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "link.h"

enum { LINE = 512 };
static const double BACK_M = 3.0, AHEAD_M = 10.0;

int path_load(Path *path, const char *folder, const unsigned char start[6])
{
    char name[1024], line[LINE];
    snprintf(name, sizeof name, "%s/%02x%02x%02x%02x%02x%02x.csv", folder, start[0], start[1], start[2], start[3],
             start[4], start[5]);
    FILE *file = fopen(name, "r");
    if (!file) {
        fprintf(stderr, "controller: there is no %s (written by `tunefree-hil scenarios --export %s`)\n", name, folder);
        return 0;
    }
    int room = 0;
    path->count = 0;
    free(path->points);
    path->points = NULL;
    if (!fgets(line, sizeof line, file) || strncmp(line, "t_s,x_m,y_m,heading_rad,speed_mps,accel_mps2,curvature_1pm", 57))
        fail(OWN_FAULT, "%s does not begin with the columns expected", name);
    while (fgets(line, sizeof line, file)) {
        if (path->count == room) {
            room = room ? 2 * room : 1024;
            path->points = realloc(path->points, (size_t)room * sizeof(Point));
            if (!path->points)
                fail(OWN_FAULT, "no memory");
        }
        Point *p = path->points + path->count;
        if (sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf,%lf", &p->t_s, &p->x_m, &p->y_m, &p->heading_rad, &p->speed_mps,
                   &p->accel_mps2, &p->curvature_1pm) != 7)
            fail(OWN_FAULT, "%s: line %d is not seven numbers", name, path->count + 2);
        p->station_m = path->count ? p[-1].station_m + hypot(p->x_m - p[-1].x_m, p->y_m - p[-1].y_m) : 0.0;
        path->count++;
    }
    fclose(file);
    if (path->count < 2)
        fail(OWN_FAULT, "%s holds no path", name);
    return 1;
}

int path_nearest(const Path *path, double x_m, double y_m, int from)
{
    const Point *points = path->points;
    int best = from < path->count ? from : path->count - 1;
    int i = best;
    double least_m = INFINITY, here_m = points[best].station_m;
    while (i > 0 && points[i - 1].station_m > here_m - BACK_M)
        i--;
    /* By metres, not by points: a stop is many points at one place. */
    for (; i < path->count && points[i].station_m < here_m + AHEAD_M; i++) {
        double away_m = hypot(points[i].x_m - x_m, points[i].y_m - y_m);
        if (away_m < least_m) {
            least_m = away_m;
            best = i;
        }
    }
    return best;
}

int path_ahead(const Path *path, int i, double ahead_m)
{
    double wanted_m = path->points[i].station_m + ahead_m;
    while (i < path->count - 1 && path->points[i].station_m < wanted_m)
        i++;
    return i;
}
