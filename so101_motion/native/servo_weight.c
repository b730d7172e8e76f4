/* The torques that hold an arm still; arm_weight.py. */
#include "servos.h"

static void turned(const double *R, const double *v, double *to) {
    for (int k = 0; k < 3; k++) to[k] = R[3 * k] * v[0] + R[3 * k + 1] * v[1] + R[3 * k + 2] * v[2];
}

/* The torque about an axis through `at` that holds a mass of 1 at `there`. */
static double held(const double *axis, const double *at, const double *there, const double *up) {
    const double x = there[0] - at[0], y = there[1] - at[1], z = there[2] - at[2];
    return up[0] * (axis[1] * z - axis[2] * y) + up[1] * (axis[2] * x - axis[0] * z) +
           up[2] * (axis[0] * y - axis[1] * x);
}

/* `own`: of the empty arm; `per_kg`: what each kilogram at the place of a load adds. */
void so101_weigh(const Weight *w, const double *q, double *own, double *per_kg) {
    double R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, p[3] = {0}, axis[SERVOS][3], at[SERVOS][3], there[SERVOS][3];
    double load[3] = {0}, way[3];
    for (int i = 0; i < SERVOS; i++) {
        const double c = cos(q[i]), s = sin(q[i]), *own_R = w->body[i].R;
        double next[9];
        turned(R, w->body[i].p, way);
        for (int k = 0; k < 3; k++) at[i][k] = p[k] += way[k];
        for (int k = 0; k < 9; k++) {
            const double *row = R + k / 3 * 3;
            next[k] = row[0] * own_R[k % 3] + row[1] * own_R[3 + k % 3] + row[2] * own_R[6 + k % 3];
        }
        for (int k = 0; k < 3; k++) {
            axis[i][k] = R[3 * k + 2] = next[3 * k + 2];
            R[3 * k] = c * next[3 * k] + s * next[3 * k + 1];
            R[3 * k + 1] = c * next[3 * k + 1] - s * next[3 * k];
        }
        turned(R, w->body[i].centre, way);
        for (int k = 0; k < 3; k++) there[i][k] = p[k] + way[k];
        if (i == JAW - 1) {
            turned(R, w->load, way);
            for (int k = 0; k < 3; k++) load[k] = p[k] + way[k];
        }
    }
    for (int i = 0; i < SERVOS; i++) {
        own[i] = 0.0, per_kg[i] = i < JAW ? held(axis[i], at[i], load, w->up) : 0.0;
        for (int k = i; k < SERVOS; k++) own[i] += w->body[k].mass * held(axis[i], at[i], there[k], w->up);
    }
}
