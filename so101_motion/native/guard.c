/* What a guard sees around the arm, and what follows from that without a check of a path; guard.py says how
 * and why. */
#include <math.h>
#include <string.h>

#include "guard.h"

/* Whether all torques between two corners surely stay below `share` of their limits. `load`: joint angles, the
 * torques there without signs, the limits, and how much each angle changes each torque at most. */
static int is_surely_borne(const double *load, double share, const double *low, const double *high) {
    const double *there = load, *borne = there + ARM_JOINTS, *limit = borne + ARM_JOINTS;
    const double *rate = limit + ARM_JOINTS;
    for (int i = 0; i < ARM_JOINTS; i++, rate += ARM_JOINTS) {
        double more = 0.0;
        for (int j = 0; j < ARM_JOINTS; j++) more += fmax(high[j] - there[j], there[j] - low[j]) * rate[j];
        if (!(more < share * limit[i] - borne[i])) return 0;
    }
    return 1;
}

int so101_surely_borne(const double *load, double share, const double *corners) {
    return is_surely_borne(load, share, corners, corners + ARM_JOINTS);
}

/* Sees what is near `g->q`; returns the number of pairs, or -1 if coal has to decide. `given` pairs have been
 * found already, unless it is negative. Also tells whether the step to `g->target` keeps all bounds. */
int so101_guard_look(Guard *g, double gap, int given) {
    const int n = given >= 0 ? given
                             : so101_near_bounds(g->scene, g->q, g->within, g->most, g->near, g->margin,
                                                 g->pair_of, gap, g->bound);
    g->free = g->within - g->widest;
    g->is_heavy = g->load && !is_surely_borne(g->load, g->nearly, g->q, g->q);
    g->is_kept = 1;
    for (int k = 0; k < n; k++) {
        const double *bound = g->bound + BOUND * k;
        double gained = 0.0;
        for (int j = 0; j < ARM_JOINTS; j++) gained += bound[j] * (g->target[j] - g->q[j]);
        g->is_kept &= !(bound[ARM_JOINTS] - gained > ROUNDING);
        g->free = fmin(g->free, bound[ARM_JOINTS + 1]);
    }
    return n;
}

/* Whether a path from q, then of n configurations, is surely BORNE, and CLEAR because it is so short. `extra`:
 * the margin that it must keep beyond the bodies' own, if servos may be `ahead` of it or not. */
int so101_guard_proves(Guard *g, const double *q, const double *path, int n, int ahead) {
    double low[ARM_JOINTS], high[ARM_JOINTS], travel = 0.0;
    for (int j = 0; j < ARM_JOINTS; j++) {
        low[j] = high[j] = q[j];
        for (int k = 0; k < n; k++) {
            low[j] = fmin(low[j], path[ARM_JOINTS * k + j]);
            high[j] = fmax(high[j], path[ARM_JOINTS * k + j]);
        }
        travel += fmax(high[j] - g->q[j], g->q[j] - low[j]) * g->reach[j];
    }
    g->extra = 0.0;
    if (travel > g->fast && g->bend > 0.0) {
        g->extra = g->inexact;
        /* In steps, because a check is built and kept for each value. */
        if (ahead) g->extra += fmin(g->step * ceil(g->share * travel / g->step), g->ahead);
    }
    return (!g->load || is_surely_borne(g->load, 1.0, low, high) ? BORNE : 0) |
           (travel <= g->free - g->extra ? CLEAR : 0);
}

/* By how much a pair that was seen is closer than its margin and `more` [m]; `number` is the caller's. */
static double lack_of(const Guard *g, int seen, double number, double margin, double more) {
    for (const double *row = g->near; row < g->near + NEAR_ROW * seen; row += NEAR_ROW)
        if (row[0] == number) return fmax(margin + more - row[1], 0.0);
    return 0.0;
}

/* Whether pairs that are too close where it was looked, of which `seen` were found, are all that a path from
 * there cannot clear: at none of its `places` is a pair closer than its margin and `more` by more than it was
 * there, and `closer` [m]. -1 if that cannot be told here, 0 also if no pair is too close. `room`: memory for
 * rows. */
int so101_guard_parts(const Guard *g, int seen, const double *path, int n, int places, double more, double closer,
                      double *room) {
    const int every = n / places > 1 ? n / places : 1;
    int any = 0;
    for (int k = 0; k < seen; k++) {
        const double *row = g->near + NEAR_ROW * k;
        if (row[1] == 0.0) return -1; /* perhaps in a surface */
        any |= g->bound[BOUND * k + ARM_JOINTS + 1] < more;
    }
    double q[JOINTS] = {[JOINTS - 1] = g->q[JOINTS - 1]};
    for (int k = n - 1; any && k > 0; k -= every) {
        memcpy(q, path + ARM_JOINTS * k, ARM_JOINTS * sizeof *q);
        const int found = so101_nearest(g->scene, q, g->widest + more, g->most, room);
        if (found < 0) return -1;
        for (const double *row = room; row < room + NEAR_ROW * found; row += NEAR_ROW) {
            const double number = g->pair_of[(int)row[0]], margin = g->margin[(int)row[0]];
            if (margin + more - row[1] > lack_of(g, seen, number, margin, more) + closer) return 0;
        }
    }
    return any;
}
