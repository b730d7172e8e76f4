/* Computes how joints come to rest, each as fast as it can by itself: stop_paths.py in C.
 *
 * Every joint has its own acceleration and jerk caps. Let `excess` be the velocity that would be left
 * if its acceleration were taken back to zero at once. The joint accelerates against that, up to a peak
 * or to its cap, where it stays as long as it has to, and back to zero. An acceleration beyond the cap
 * is brought back to it first.
 */
#include <math.h>
#include <string.h>

#include "native.h"

#define PHASES 3
#define MOST 8 /* joints; as in stop_paths.py */

/* The times at which the phases begin and the last one ends, the state then, and the jerk in each. */
typedef struct {
    double t[PHASES + 1], q[PHASES + 1], qd[PHASES + 1], qdd[PHASES + 1], jerk[PHASES];
} Stop;

static Stop stop_of(double q, double qd, double qdd, double cap, double jerk) {
    const double excess = qd + qdd * fabs(qdd) / (2.0 * jerk);
    const double way = excess > 0.0 || (excess == 0.0 && qdd > 0.0) ? -1.0 : 1.0;
    const double before = way * qdd; /* accelerations from here on are along `way` */
    const double peak = sqrt(jerk * fabs(excess) + pow(fmax(before, 0.0), 2.0)), most = fmin(peak, cap);
    const double turn = most < before ? -1.0 : 1.0;
    const double gained = (turn * (most * most - before * before) + most * most) / (2.0 * jerk);
    const double lasts[PHASES] = {turn * (most - before) / jerk,
                                  peak > cap ? fmax(-way * qd - gained, 0.0) / cap : 0.0, most / jerk};
    Stop s = {.q = {q}, .qd = {qd}, .qdd = {qdd}, .jerk = {way * turn * jerk, 0.0, -way * jerk}};
    for (int k = 0; k < PHASES; k++) {
        const double t = lasts[k];
        s.t[k + 1] = s.t[k] + t;
        s.q[k + 1] = s.q[k] + t * (s.qd[k] + t * (s.qdd[k] / 2.0 + t * s.jerk[k] / 6.0));
        s.qd[k + 1] = s.qd[k] + t * (s.qdd[k] + t * s.jerk[k] / 2.0);
        s.qdd[k + 1] = k == 1 ? s.qdd[k] : way * most * (k == 0);
    }
    s.qd[PHASES] = s.qdd[PHASES] = 0.0;
    return s;
}

static void state_at(const Stop *s, double t, double *q, double *qd, double *qdd) {
    int k = 0;
    while (k < PHASES && t >= s->t[k + 1]) k++;
    *q = s->q[k], *qd = s->qd[k], *qdd = s->qdd[k];
    if (k == PHASES) return;
    const double dt = t - s->t[k], jerk = s->jerk[k];
    *q += dt * (*qd + dt * (*qdd / 2.0 + dt * jerk / 6.0));
    *qd += dt * (*qdd + dt * jerk / 2.0);
    *qdd += dt * jerk;
}

/* `given`: the period, the largest time between samples; of `n` joints the position, velocity,
 * acceleration, and the caps of acceleration and jerk. `told` gets the time between the samples; position,
 * velocity and acceleration a period later; the least and the largest position; then the samples.
 * Returns their number, which is more than `most` if there is no room for them, and 0 if it fails. */
int so101_path_to_rest(const double *given, int n, int most, double *told) {
    const double dt = given[0], every = given[1], *state = given + 2, *caps = state + 3 * n;
    double *after = told + 1, *least = after + 3 * n, *largest = least + n, *sample = largest + n;
    Stop stop[MOST];
    double lasts = 0.0;
    for (int j = 0; j < n; j++) {
        stop[j] = stop_of(state[j], state[n + j], state[2 * n + j], caps[j], caps[n + j]);
        if (!isfinite(stop[j].q[PHASES])) return 0;
        lasts = fmax(lasts, stop[j].t[PHASES]);
    }
    const double steps = fmax(1.0, ceil(lasts / every));
    if (!(steps < 1e6)) return 0;
    const int count = (int)steps + 1;
    if (count > most) return count;
    told[0] = lasts / steps;
    for (int j = 0; j < n; j++) {
        double qd, qdd;
        state_at(&stop[j], lasts <= dt ? lasts : dt, &after[j], &after[n + j], &after[2 * n + j]);
        least[j] = largest[j] = state[j];
        for (int k = 0; k < count; k++) {
            double *q = &sample[n * k + j];
            state_at(&stop[j], k < count - 1 ? k * told[0] : lasts, q, &qd, &qdd);
            least[j] = fmin(least[j], *q), largest[j] = fmax(largest[j], *q);
        }
    }
    return count;
}
