/* Finds the step nearest to a wanted one that keeps linear bounds: nearest_within.py in C. */
#include <math.h>
#include <string.h>

#include "native.h"

#define MOST 8 /* bounds that are used */
#define ROUNDS 12
#define ROUNDING 1e-9
#define SINGULAR 1e-15

/* Writes the numbers of the bounds with the least room, in order; returns their number. */
static int with_least_room(const double *bounds, int n, int *near) {
    int count = 0;
    for (int k = 0; k < n; k++) {
        const double room = bounds[BOUND * k + ARM_JOINTS + 1];
        int at = count < MOST ? count++ : MOST;
        for (; at > 0 && bounds[BOUND * near[at - 1] + ARM_JOINTS + 1] > room; at--)
            if (at < MOST) near[at] = near[at - 1];
        if (at < MOST) near[at] = k;
    }
    return count;
}

/* Solves a symmetric system of `n` rows, whose right side is the last column; 0 if it is singular. */
static int solved(double row[MOST][MOST + 1], int n, double *x) {
    for (int i = 0; i < n; i++) {
        if (!(row[i][i] > SINGULAR)) return 0;
        for (int k = i + 1; k < n; k++) {
            const double share = row[k][i] / row[i][i];
            for (int j = i; j <= n; j++) row[k][j] -= share * row[i][j];
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        double rest = row[i][n];
        for (int j = i + 1; j < n; j++) rest -= row[i][j] * x[j];
        x[i] = rest / row[i][i];
    }
    return 1;
}

static double dot(const double *a, const double *b) {
    double sum = 0.0;
    for (int j = 0; j < ARM_JOINTS; j++) sum += a[j] * b[j];
    return sum;
}

/* `given`: the step, which is changed; room for the numbers of the active bounds; then all `n` bounds.
 * Returns the number of active bounds, or minus that if no step is found. */
int so101_nearest_within(double *given, int n) {
    double *step = given, *told = given + ARM_JOINTS;
    const double *bounds = told + MOST;
    double gram[MOST][MOST], wanted[MOST], lack[MOST], x[ARM_JOINTS], pull[MOST];
    int near[MOST], active[MOST], held = 0;
    const int count = with_least_room(bounds, n, near);
    memcpy(x, step, sizeof x);
    for (int i = 0; i < count; i++) {
        const double *row = bounds + BOUND * near[i];
        for (int j = 0; j < count; j++) gram[i][j] = dot(row, bounds + BOUND * near[j]);
        lack[i] = wanted[i] = row[ARM_JOINTS] - dot(row, step);
    }
    int found = 0;
    for (int round = 0; round < ROUNDS; round++) {
        int worst = 0, is_active = 0;
        for (int i = 1; i < count; i++)
            if (lack[i] > lack[worst]) worst = i;
        for (int i = 0; i < held; i++) is_active |= active[i] == worst;
        if (!count || !(lack[worst] > ROUNDING) || is_active) {
            found = 1;
            break;
        }
        active[held++] = worst;
        for (int weakest = 0;;) {
            double system[MOST][MOST + 1];
            for (int i = 0; i < held; i++) {
                for (int j = 0; j < held; j++) system[i][j] = gram[active[i]][active[j]];
                system[i][held] = wanted[active[i]];
            }
            if (!solved(system, held, pull)) goto ended;
            weakest = 0;
            for (int i = 1; i < held; i++)
                if (pull[i] < pull[weakest]) weakest = i;
            if (pull[weakest] >= 0.0) break;
            if (held == 1) goto ended;
            memmove(active + weakest, active + weakest + 1, sizeof *active * (held - weakest - 1));
            held--;
        }
        memcpy(x, step, sizeof x);
        for (int i = 0; i < held; i++)
            for (int j = 0; j < ARM_JOINTS; j++)
                x[j] += pull[i] * bounds[BOUND * near[active[i]] + j];
        for (int i = 0; i < count; i++) {
            const double *row = bounds + BOUND * near[i];
            lack[i] = row[ARM_JOINTS] - dot(row, x);
        }
    }
ended:
    for (int i = 0; i < held; i++) told[i] = near[active[i]];
    if (!found) return -held;
    memcpy(step, x, sizeof x);
    return held;
}
