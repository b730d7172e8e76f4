/* Whether joints that follow a target may take a step; control/following.py says how and why. */
#include <math.h>
#include <string.h>

#define MOST 8 /* joints; as in stop_paths.py */

enum { TOO_FAST = -1, NO_ROOM = -2, NO_STOP = -3 };

/* As _Step in following.py; rows have a number for each of n joints. */
typedef struct {
    double least[MOST], most[MOST], hardest[MOST], stop_jerk[MOST], fastest[MOST]; /* bounds */
    double jerk[MOST];     /* caps of the motion */
    double now[MOST];      /* the last setpoint */
    double braked[3][MOST]; /* the next one if the joints brake: position, velocity, acceleration */
    double target[2][MOST]; /* position and velocity */
    double step[3][MOST];   /* the next setpoint */
    double *given, *told;   /* of so101_path_to_rest, with room for so many samples */
    int n, room;
} Following;

int so101_path_to_rest(const double *given, int n, int most, double *told);

/* The speed of a joint once its acceleration has been taken back. */
static double speed_to_come(const Following *f, int j, double jerk) {
    return f->step[1][j] + 0.5 * f->step[2][j] * fabs(f->step[2][j]) / jerk;
}

/* Puts joints that have arrived at a goal that stands still exactly there, at rest. */
static void land(Following *f, double there) {
    for (int j = 0; j < f->n; j++) {
        double *q = &f->step[0][j], *qd = &f->step[1][j], *qdd = &f->step[2][j];
        if (f->target[1][j] == 0.0 && fabs(*qd) < there && fabs(*qdd) < 100.0 * there &&
            fabs(*q - f->target[0][j]) < there)
            *q = f->target[0][j], *qd = *qdd = 0.0;
    }
}

/* Lets joints brake that could not stop in time, or would turn round too hard; whether there are any. */
static int rein_in(Following *f) {
    const double *lowest = f->told + 1 + 3 * f->n, *highest = lowest + f->n;
    int any = 0;
    for (int j = 0; j < f->n; j++) {
        const double qd = f->step[1][j], qdd = f->step[2][j];
        /* One that has braked harder than it may speed up must not turn round with that. */
        const int turns = fabs(qdd) > f->hardest[j] &&
                          (speed_to_come(f, j, f->jerk[j]) * qd <= 0.0 || qdd * qd > 0.0);
        /* While its acceleration is taken back, a joint still gets faster. */
        if (!turns && !(lowest[j] < f->least[j]) && !(highest[j] > f->most[j]) &&
            !(fabs(speed_to_come(f, j, f->stop_jerk[j])) > f->fastest[j]))
            continue;
        any = 1;
        for (int k = 0; k < 3; k++) f->step[k][j] = f->braked[k][j];
    }
    return any;
}

static int path_to_rest(Following *f) {
    for (int k = 0; k < 3; k++) memcpy(f->given + 2 + k * f->n, f->step[k], f->n * sizeof *f->given);
    const int samples = so101_path_to_rest(f->given, f->n, f->room, f->told);
    return !samples ? NO_STOP : samples > f->room ? NO_ROOM : samples;
}

/* Changes the next setpoint to one from which joints can stop inside their range and below their speed caps,
 * and samples the path to rest from there; before it, instead of the largest angles, stands the last setpoint.
 * `hastily`: even if they are TOO_FAST at first. Returns the number of samples, or why there are none. */
int so101_following_step(Following *f, double there, int hastily) {
    for (int j = 0; j < f->n && !hastily; j++)
        if (fabs(speed_to_come(f, j, f->stop_jerk[j])) > f->fastest[j]) return TOO_FAST;
    land(f, there);
    int samples = path_to_rest(f);
    if (samples > 0 && rein_in(f)) samples = path_to_rest(f);
    memcpy(f->told + 1 + 4 * f->n, f->now, f->n * sizeof *f->told);
    return samples;
}
