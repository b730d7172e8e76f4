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
    g->seen = n;
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

/* By how much a pair that was seen is closer than its margin and `extra` [m]; `number` is the caller's. */
static double lack_of(const Guard *g, double number, double margin) {
    for (const double *row = g->near; row < g->near + NEAR_ROW * g->seen; row += NEAR_ROW)
        if (row[0] == number) return fmax(margin + g->bend + g->extra - row[1], 0.0);
    return 0.0;
}

/* Whether some pairs are too close where a path of n configurations begins, and none is closer at any of its
 * `places`; -1 if that cannot be told here. `path`: without its first. */
static int is_parting(const Guard *g, const double *q, const double *path, int n) {
    const double more = g->bend + g->extra;
    const int every = n / g->places > 1 ? n / g->places : 1;
    int any = 0;
    if (!g->sees_enough || memcmp(q, g->q, ARM_JOINTS * sizeof *q)) return -1;
    for (int k = 0; k < g->seen; k++) {
        if (g->near[NEAR_ROW * k + 1] == 0.0) return -1; /* perhaps in a surface */
        any |= g->bound[BOUND * k + ARM_JOINTS + 1] < more;
    }
    double at[JOINTS] = {[JOINTS - 1] = g->q[JOINTS - 1]};
    for (int k = n - 1; any && k > 0; k -= every) {
        memcpy(at, path + ARM_JOINTS * (k - 1), ARM_JOINTS * sizeof *at);
        const int found = so101_nearest(g->scene, at, g->widest + more, g->most, g->room);
        if (found < 0) return -1;
        for (const double *row = g->room; row < g->room + NEAR_ROW * found; row += NEAR_ROW) {
            const double number = g->pair_of[(int)row[0]], margin = g->margin[(int)row[0]];
            if (margin + more - row[1] > lack_of(g, number, margin) + g->closer) return 0;
        }
    }
    return any;
}

/* Whether a path from q, then of n configurations, is surely BORNE, and CLEAR because it is so short or
 * bodies that are too close only part. `extra`: the margin that it must keep beyond the bodies' own, if servos
 * may be `ahead` of it or not. If it is_undecided, coal knows whether they part. */
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
    const int borne = !g->load || is_surely_borne(g->load, 1.0, low, high) ? BORNE : 0;
    if (travel <= g->free - g->extra) return borne | CLEAR;
    const int parts = is_parting(g, q, path, n + 1);
    g->is_undecided = parts < 0;
    return borne | (parts > 0 ? CLEAR : 0);
}
