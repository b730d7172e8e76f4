/* Whether two arms that move at the same time stay apart, and where they come too near.
 *
 * Each arm's motion is a row of configurations, evenly spaced in time and straight in between. For
 * every pair of bodies there is a time until which they cannot meet: as far apart as they are now,
 * they have to travel that far first, and how far a body travels in each step is known. Only when
 * that time has come the pair is looked at again (conservative advancement; B. Mirtich, Impulse-based
 * Dynamic Simulation of Rigid Body Systems, 1996). Far from each other a few looks clear a motion.
 *
 * Nobody is on time to the very instant. So what must stay free grows with the speed of the slower
 * of the two: `skew` is how much one may be early against the other, in steps.
 */
#include <math.h>
#include <string.h>

#include "native.h"

#define PART 0.5    /* of the margin: the least travel between two looks at a pair */
#define CLOSE 0.05  /* balls that are further apart than this beyond the need will do [m] */

typedef struct {
    const Scene *scene;
    const double *q, *travel; /* configurations; what each body travels in each step at most [m] */
    Pose pose[JOINTS + 1];
    double centre[MOST_BODIES][3];
} Arm;

static void look(Arm *arm, const double *placement, int n, double t) {
    const Scene *s = arm->scene;
    const int k = n > 1 && t > n - 2 ? n - 2 : (int)t;
    double q[JOINTS];
    for (int j = 0; j < JOINTS; j++) {
        const double *at = arm->q + JOINTS * k + j;
        q[j] = n > 1 ? at[0] + (t - k) * (at[JOINTS] - at[0]) : at[0];
    }
    so101_poses(s, q, arm->pose);
    for (int j = 0; placement && j <= JOINTS; j++) {
        const Pose own = arm->pose[j];
        Pose *here = &arm->pose[j];
        for (int r = 0; r < 3; r++) {
            const double *R = placement + 3 * r;
            for (int c = 0; c < 3; c++)
                here->R[3 * r + c] = R[0] * own.R[c] + R[1] * own.R[3 + c] + R[2] * own.R[6 + c];
            here->p[r] = placement[9 + r] + R[0] * own.p[0] + R[1] * own.p[1] + R[2] * own.p[2];
        }
    }
    for (int i = 0; i < s->bodies; i++) {
        const Body *b = &s->body[i];
        const Pose *pose = &arm->pose[b->joint];
        for (int r = 0; r < 3; r++) {
            const double *R = pose->R + 3 * r;
            arm->centre[i][r] =
                pose->p[r] + R[0] * b->centre[0] + R[1] * b->centre[1] + R[2] * b->centre[2];
        }
    }
}

static double between(const Arm *a, int i, const Arm *b, int j, double enough) {
    const Body *first = &a->scene->body[i], *second = &b->scene->body[j];
    double square = 0.0;
    for (int c = 0; c < 3; c++) square += pow(a->centre[i][c] - b->centre[j][c], 2.0);
    const double low =
        sqrt(square) - first->ball - second->ball - first->radius - second->radius - SLACK;
    if (low > enough) return low;
    return so101_gap(a->scene, a->pose, i, b->scene, b->pose, j, enough);
}

/* Until when a pair may go on that has `room` left to travel; `last` for ever. */
static double until(const Arm *a, int i, const Arm *b, int j, int n, double t, double room,
                    double skew) {
    const int bodies_a = a->scene->bodies, bodies_b = b->scene->bodies;
    for (int k = (int)t; k < n - 1; k++, t = k) {
        const double va = a->travel[k * bodies_a + i], vb = b->travel[k * bodies_b + j];
        const double left = (k + 1 - t) * (va + vb), late = skew * fmin(va, vb);
        if (!(left + late <= room)) return room > late ? t + (room - late) / (va + vb) : t;
        room -= left;
    }
    return INFINITY;
}

/* FREE if bodies keep `margin` apart throughout; TOUCHING fills `out`: when, in steps; how near;
 * which bodies. `placement`: where b's base is in a's, rotation by rows, then place. */
int so101_apart(const Scene *a, const Scene *b, const double *placement, int n, const double *qa,
                const double *qb, const double *travel_a, const double *travel_b, double margin,
                double skew, double *out) {
    Arm first = {.scene = a, .q = qa, .travel = travel_a};
    Arm second = {.scene = b, .q = qb, .travel = travel_b};
    double due[MOST_BODIES][MOST_BODIES], t = 0.0;
    memset(due, 0, sizeof due);
    while (t <= n - 1) {
        double next = INFINITY;
        look(&first, 0, n, t);
        look(&second, placement, n, t);
        const int k = t > n - 2 ? (n > 1 ? n - 2 : 0) : (int)t;
        for (int i = 0; i < a->bodies; i++)
            for (int j = 0; j < b->bodies; j++) {
                if (due[i][j] <= t) {
                    if (!a->body[i].joint && !b->body[j].joint) {
                        due[i][j] = INFINITY;
                        continue;
                    }
                    double need = margin;
                    if (n > 1)
                        need += skew * fmin(travel_a[k * a->bodies + i], travel_b[k * b->bodies + j]);
                    const double gap = between(&first, i, &second, j, need + CLOSE);
                    if (!(gap >= need)) {
                        out[0] = t, out[1] = gap, out[2] = i, out[3] = j;
                        return TOUCHING;
                    }
                    due[i][j] = fmax(until(&first, i, &second, j, n, t, gap - margin, skew),
                                     until(&first, i, &second, j, n, t, PART * margin, 0.0));
                }
                next = fmin(next, due[i][j]);
            }
        if (t < n - 1 && next > n - 1 && next < INFINITY) next = n - 1;
        t = next;
    }
    return FREE;
}
