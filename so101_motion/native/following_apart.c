/* Proves that an arm that follows a target keeps apart from another arm, or only moves away from it,
 * and finds the near bodies. See following_apart.py.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apart.h"

#define SAME 1e-7   /* distances that differ by less are equal [m]; as in apart.py */
#define BARELY 1e-6 /* bodies whose hulls are nearer than this may overlap [m] */
#define TENTH 1e-4  /* to which so101_gap knows distances [m] */

/* Whether two bodies are at least as far apart as at the start, or as `room`; `now` is their distance
 * at the start to a tenth of a millimetre. UNKNOWN if they touch, or if it is too close to decide.
 * `lie` as in Known; `limit`: exact bounds of that distance, 0 if not yet computed. */
static int pair_parts(const Arm *first, const Arm *at, int i, int j, double now, double room,
                      double *limit, double *lie) {
    const Scene *a = at[0].scene, *b = at[1].scene;
    const double radii = a->body[i].radius + b->body[j].radius, rough = fmin(now + 2.0 * TENTH, room);
    double along;
    if (so101_between(&at[0], i, &at[1], j, rough, rough, lie, &along) >= rough) return FREE;
    if (limit[1] == 0.0) {
        const Closest found =
            so101_closest_bodies(a, first[0].pose, i, b, first[1].pose, j, room + radii);
        const double low = found.low - radii, high = found.length - radii;
        if (!(found.length > BARELY)) return UNKNOWN;
        limit[0] = fmin(low, room) - SAME;
        limit[1] = (low > room ? room : fmin(high, room)) - SAME;
    }
    const Closest found =
        so101_closest_bodies(a, at[0].pose, i, b, at[1].pose, j, limit[1] + radii);
    if (found.low - radii >= limit[1]) return FREE;
    if (!(found.length > BARELY)) return UNKNOWN;
    return found.length - radii < limit[0] ? TOUCHING : UNKNOWN;
}

/* Whether two arms only move apart, see only_part in following_apart.py: checked every half step at
 * first, then every step. `nearest` gets their distance at the start. */
static int arms_part(const Course *both, const Scene *a, const Scene *b, const double *placement,
                     double since, double step, double room, Known *known, double *nearest) {
    double q[2][JOINTS], limit[MOST_BODIES][MOST_BODIES][2], along;
    Arm first[2] = {{.scene = a, .q = q[0]}, {.scene = b, .q = q[1]}}, at[2];
    const double lasts =
        fmax(both[0].t + both[0].dt * (both[0].n - 1), both[1].t + both[1].dt * (both[1].n - 1)) - since;
    *nearest = INFINITY;
    memset(limit, 0, sizeof limit);
    for (double t = 0.0;;) {
        for (int which = 0; which < 2; which++) so101_course_at(&both[which], since + t, q[which]);
        memcpy(at, first, sizeof at);
        so101_look(&at[0], 0, 1, 0.0);
        so101_look(&at[1], placement, 1, 0.0);
        for (int i = 0; i < a->bodies; i++)
            for (int j = 0; j < b->bodies; j++) {
                if (!a->body[i].joint && !b->body[j].joint) continue;
                double *low = &known->low[i][j], *lie = known->lie[i][j];
                if (t == 0.0) {
                    if (*low < room)
                        *low = so101_between(&at[0], i, &at[1], j, room, room, lie, &along);
                    *nearest = fmin(*nearest, *low);
                    continue;
                }
                if (known->due[i][j] == INFINITY) continue; /* far enough from here on */
                const int answer = pair_parts(first, at, i, j, *low, room, limit[i][j], lie);
                if (answer != FREE) return answer;
            }
        if (t == 0.0) memcpy(first, at, sizeof at);
        if (!(t < lasts)) return FREE;
        t = fmin(t + (t < 1.9 * step ? 0.5 * step : step), lasts);
    }
}

int so101_beside_size(void) { return sizeof(Beside); }

/* Remembers the configurations of both arms, and how much nearer their bodies may have come since. */
static void come_to(Beside *beside, const double *qa, const double *qb) {
    const double *now[2] = {qa, qb};
    double moved[2][MOST_BODIES];
    for (int which = 0; which < 2; which++) {
        double both[2][JOINTS];
        memcpy(both[0], beside->q[which], sizeof both[0]);
        memcpy(both[1], now[which], sizeof both[1]);
        memcpy(beside->q[which], both[1], sizeof both[1]);
        so101_travelled(beside->scene[which], beside->levers[which], 2, both[0], moved[which]);
    }
    for (int i = 0; i < beside->scene[0]->bodies; i++)
        for (int j = 0; j < beside->scene[1]->bodies; j++)
            beside->known.low[i][j] -= moved[0][i] + moved[1][j];
}

/* Finds the near bodies of both arms at the remembered configurations. */
static void find_near(Beside *beside) {
    Arm arm[2] = {{.scene = beside->scene[0], .q = beside->q[0]},
                  {.scene = beside->scene[1], .q = beside->q[1]}};
    so101_look(&arm[0], 0, 1, 0.0);
    so101_look(&arm[1], beside->placement, 1, 0.0);
    beside->near = so101_near_arm(arm[0].scene, arm[0].pose, arm[1].scene, arm[1].pose,
                                  beside->known.low, beside->known.lie, beside->within,
                                  beside->margin, beside->gap, beside->row);
}

/* Only finds what is near at `since`. */
void so101_near_beside(Beside *beside) {
    double q[2][JOINTS];
    for (int which = 0; which < 2; which++)
        so101_course_at(&beside->course[which], beside->since, q[which]);
    come_to(beside, q[0], q[1]);
    find_near(beside);
}

/* Whether an arm that follows a target may stop along its course, as following_apart.py says. Like
 * so101_courses_apart; `told` gets time, distance and bodies. UNKNOWN: the caller has to decide. */
int so101_following_apart(Beside *beside) {
    const Scene *a = beside->scene[0], *b = beside->scene[1];
    const double *levers_a = beside->levers[0], *levers_b = beside->levers[1];
    const double *placement = beside->placement, since = beside->since, step = beside->step;
    Known *known = &beside->known;
    double nearest, *told = beside->told;
    int n;
    double *q = so101_sampled(beside->course, since, step, &n);
    if (!q) return UNKNOWN;
    come_to(beside, q, q + JOINTS * n);
    int found = so101_known_apart(a, b, placement, levers_a, levers_b, n, q, q + JOINTS * n,
                                  beside->margin, beside->skew / step, known, told);
    if (found == TOUCHING && told[0] > 0.0) {
        beside->gained = 0.0; /* now they are far enough from each other */
    } else if (found == TOUCHING) {
        found = arms_part(beside->course, a, b, placement, since, step, beside->margin, known, &nearest);
        const double before = nearest < beside->pushed * beside->gained ? 0.0 : beside->gained;
        const double now = fmax(before, nearest - beside->parting);
        if (!(nearest < beside->margin))
            beside->gained = 0.0, found = TOUCHING;
        else if (found == TOUCHING && now > 0.0)
            found = so101_known_apart(a, b, placement, levers_a, levers_b, n, q, q + JOINTS * n, now,
                                      0.0, known, told);
        if (found == FREE) beside->gained = now;
    }
    find_near(beside);
    free(q);
    if (found != FREE) told[0] = since + step * told[0];
    return found;
}
