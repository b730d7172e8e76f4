/* Proves that two moving arms stay apart, or finds where they come too near.
 *
 * Each arm's motion is a list of configurations, evenly spaced in time and straight in between. Every
 * pair of bodies has a time before which they cannot meet: together they must first travel the
 * distance between them, and the travel of each body in each step is known. The pair is checked again
 * only at that time (conservative advancement; B. Mirtich, Impulse-based Dynamic Simulation of Rigid
 * Body Systems, 1996). A few checks clear a motion if the arms are far from each other. Near each
 * other, a plane that separates two bodies at both ends of a step clears that step.
 *
 * The arms do not keep their times exactly. So the distance to keep grows with the speed of the
 * slower of two bodies: `skew` is how much one arm may be ahead of the other, in steps.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apart.h"

#define PLACES 10      /* samples of a stop; explained in course.py, like HARDEST and AT_LEAST */
#define HARDEST 5.0
#define AT_LEAST 0.1
#define PART 0.25   /* of the margin: the least travel between two checks of a pair */
#define SOON 0.5    /* of the time until a pair is due: from then on it is checked with others */
#define LEVELS 4    /* stretches of 1, 2, 4 and 8 steps are cleared at once */
#define FORWARD 24    /* so many steps are cleared at once: another pair may meet before; chosen */
#define CLOSE 0.01  /* distances this far above the needed one need not be exact [m]; chosen by trial */

/* fmin and fmax, which ask about NaN, are calls. */
static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }

void so101_look(Arm *arm, const double *placement, int n, double t) {
    const Scene *s = arm->scene;
    const int k = n > 1 && t > n - 2 ? n - 2 : (int)t;
    double q[JOINTS];
    for (int j = 0; j < JOINTS; j++) {
        const double *at = arm->q + JOINTS * k + j;
        q[j] = n > 1 ? at[0] + (t - k) * (at[JOINTS] - at[0]) : at[0];
    }
    so101_poses(s, q, placement, arm->pose);
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

/* A lower bound on the distance of two bodies, by balls around them. */
static double balls(const Arm *a, int i, const Arm *b, int j) {
    const Body *first = &a->scene->body[i], *second = &b->scene->body[j];
    double square = 0.0;
    for (int c = 0; c < 3; c++) square += pow(a->centre[i][c] - b->centre[j][c], 2.0);
    return sqrt(square) - first->ball - second->ball - first->radius - second->radius - SLACK;
}

double so101_between(const Arm *a, int i, const Arm *b, int j, double need, double enough, double *v,
                      double *along) {
    const double low = balls(a, i, b, j);
    *along = -INFINITY;
    if (low > enough) return low;
    return so101_gap(a->scene, a->pose, i, b->scene, b->pose, j, need, enough, v, along);
}

/* The step until which a pair may move on with `room` left to travel; INFINITY if to the end. */
static double until(const Arm *a, int i, const Arm *b, int j, int n, double t, double room,
                    double skew) {
    const int bodies_a = a->scene->bodies, bodies_b = b->scene->bodies;
    for (int k = (int)t; k < n - 1; k++, t = k) {
        const double va = a->travel[k * bodies_a + i], vb = b->travel[k * bodies_b + j];
        const double left = (k + 1 - t) * (va + vb), late = skew * smaller(va, vb);
        if (!(left + late <= room)) return room > late ? t + (room - late) / (va + vb) : t;
        room -= left;
    }
    return INFINITY;
}

/* Upper bounds on the travel of each body in each step, by the distances of its points from each axis. */
void so101_travelled(const Scene *s, const double *levers, int n, const double *q, double *travel) {
    for (int k = 0; k < n - 1; k++)
        for (int i = 0; i < s->bodies; i++) {
            double sum = 0.0;
            for (int j = 0; j < JOINTS; j++)
                sum += fabs(q[JOINTS * (k + 1) + j] - q[JOINTS * k + j]) * levers[JOINTS * i + j];
            travel[k * s->bodies + i] = sum;
        }
}

/* What is computed when first needed: the poses of both arms at each step, and for each arm, each level
 * and each step how far its bodies leave the straight way to their places 1 << level steps later. */
typedef struct {
    const Arm *arms;
    const double *placement, *levers[2];
    int n;
    Arm (*at)[2];
    double *bend[2];
    char *seen, *bent[2];
} Steps;

static const Arm *at_step(Steps *s, int k) {
    for (int which = 0; !s->seen[k] && which < 2; which++) {
        Arm *arm = &s->at[k][which];
        arm->scene = s->arms[which].scene, arm->q = s->arms[which].q;
        arm->travel = s->arms[which].travel;
        so101_look(arm, which ? s->placement : 0, s->n, k);
    }
    s->seen[k] = 1;
    return s->at[k];
}

/* Upper bounds on how far the points of each body leave, between two steps, the straight way in even time
 * between their places there. If the joints went straight it would be an eighth of the change of velocity:
 * the second derivative of a point by two joints is at most its distance from the axis of the later one. To
 * that comes how far the joints are from going straight. */
static const double *bends(Steps *s, int which, int k, int level) {
    const Arm *arm = &s->arms[which];
    const int bodies = arm->scene->bodies, steps = 1 << level;
    double *bend = s->bend[which] + (level * s->n + k) * bodies, by[JOINTS], off[JOINTS];
    char *bent = s->bent[which] + level * s->n + k;
    if (*bent) return bend;
    *bent = 1;
    for (int j = 0; j < JOINTS; j++) {
        const double *q = arm->q + JOINTS * k + j, all = q[JOINTS * steps] - q[0];
        by[j] = fabs(all), off[j] = 0.0;
        for (int m = 1; m < steps; m++)
            off[j] = larger(off[j], fabs(q[JOINTS * m] - q[0] - all * m / steps));
    }
    for (int i = 0; i < bodies; i++) {
        const double *levers = s->levers[which] + JOINTS * i;
        double turned = 0.0;
        bend[i] = 0.0;
        for (int j = 0; j < JOINTS; j++) {
            bend[i] += levers[j] * (off[j] + by[j] * (by[j] + 2.0 * turned) / 8.0);
            turned += by[j];
        }
    }
    return bend;
}

/* The distance along a direction at which two bodies must be at both ends of a stretch of 1 << level steps,
 * of which `share` is still to come, so that they keep apart in between. */
static double both_ends(Steps *s, int i, int j, int k, int level, double share, double margin, double skew) {
    const int bodies_a = s->arms[0].scene->bodies, bodies_b = s->arms[1].scene->bodies;
    double fastest = 0.0; /* of the slower body in each step */
    for (int m = k; m < k + (1 << level); m++) {
        const double va = s->arms[0].travel[m * bodies_a + i], vb = s->arms[1].travel[m * bodies_b + j];
        fastest = larger(fastest, smaller(va, vb));
    }
    return margin + skew * fastest +
           share * share * (bends(s, 0, k, level)[i] + bends(s, 1, k, level)[j]);
}

/* The step until which two bodies surely stay apart, from their `gap` at `t` and their distance `along` v:
 * they have to travel the gap first, or the same plane separates them at both ends of a stretch. Stretches
 * at whose end they are expected too near for that are not tried. */
static double clear_until(Steps *s, int i, int j, double t, double margin, double skew, double gap,
                          double along, const double *v) {
    const Arm *a = &s->arms[0], *b = &s->arms[1];
    const double enough = t + FORWARD;
    double slope = 0.0; /* of the distance along v, as it was last */
    for (int level = LEVELS - 1;;) {
        const double clear = until(a, i, b, j, s->n, t, gap - margin, skew);
        const int k = (int)t;
        if (clear > enough) return clear;
        double bound = -INFINITY;
        int end = (int)clear, l = t > k ? 0 : level;
        for (; l >= 0 && k + (1 << l) > end; l--) {
            if (k + (1 << l) >= s->n) continue;
            bound = both_ends(s, i, j, k, l, k + (1 << l) - t < 1.0 ? k + 1 - t : 1.0, margin, skew);
            if (along >= bound && along + slope * (k + (1 << l) - t) >= bound) break;
        }
        if (l >= 0 && k + (1 << l) > end)
            end = k + (1 << l);
        else
            bound = -INFINITY;
        if (!(end > t)) return clear;
        const Arm *then = at_step(s, end);
        const double next = so101_gap_along(a->scene, then[0].pose, i, b->scene, then[1].pose, j, v);
        slope = (next - along) / (end - t);
        if (next >= bound) {
            gap = along = next, t = end;
            level = l < LEVELS - 1 ? l + 1 : l;
        } else if (l > 0) {
            level = l - 1;
        } else {
            return clear;
        }
    }
}

/* Marks all pairs as due, except those so far apart at the start that their whole travel is less. */
static void begin(Known *known, const Arm *a, const Arm *b, int n, double margin, double skew) {
    const Arm *arms[2] = {a, b};
    double way[2][MOST_BODIES], fastest[2][MOST_BODIES];
    memset(way, 0, sizeof way);
    memset(fastest, 0, sizeof fastest);
    for (int which = 0; which < 2; which++) {
        const int bodies = arms[which]->scene->bodies;
        for (int k = 0; k < n - 1; k++)
            for (int i = 0; i < bodies; i++) {
                const double step = arms[which]->travel[k * bodies + i];
                way[which][i] += step;
                fastest[which][i] = larger(fastest[which][i], step);
            }
    }
    for (int i = 0; i < a->scene->bodies; i++)
        for (int j = 0; j < b->scene->bodies; j++) {
            const double need = margin + skew * smaller(fastest[0][i], fastest[1][j]);
            const int far = known->low[i][j] - way[0][i] - way[1][j] > need;
            known->due[i][j] = known->soon[i][j] = far ? INFINITY : 0.0;
        }
}

static int apart(Steps *s, double margin, double skew, Known *known, double *out) {
    const Scene *a = s->arms[0].scene, *b = s->arms[1].scene;
    const int n = s->n;
    Arm between[2] = {s->arms[0], s->arms[1]}; /* steps */
    double t = 0.0;
    begin(known, &between[0], &between[1], n, margin, skew);
    while (t <= n - 1) {
        double next = INFINITY;
        const int k = t > n - 2 ? (n > 1 ? n - 2 : 0) : (int)t;
        const Arm *now = between;
        if (t == (int)t) {
            now = at_step(s, (int)t);
        } else {
            so101_look(&between[0], 0, n, t);
            so101_look(&between[1], s->placement, n, t);
        }
        for (int i = 0; i < a->bodies; i++)
            for (int j = 0; j < b->bodies; j++) {
                double *due = &known->due[i][j], *soon = &known->soon[i][j], *lie = known->lie[i][j];
                if (*soon <= t) {
                    if (!a->body[i].joint && !b->body[j].joint) {
                        *due = *soon = INFINITY;
                        continue;
                    }
                    double need = margin, along;
                    if (n > 1)
                        need += skew * smaller(now[0].travel[k * a->bodies + i],
                                            now[1].travel[k * b->bodies + j]);
                    const double enough = need + (n > 1 ? CLOSE : 0.0);
                    const double gap = so101_between(&now[0], i, &now[1], j, need, enough, lie, &along);
                    if (!(gap >= need)) {
                        out[0] = t, out[1] = gap, out[2] = i, out[3] = j;
                        return TOUCHING;
                    }
                    if (t == 0.0) known->low[i][j] = gap;
                    *due = larger(clear_until(s, i, j, t, margin, skew, gap, along, lie),
                                until(&now[0], i, &now[1], j, n, t, PART * margin, 0.0));
                    *soon = smaller(t + SOON * (*due - t), *due);
                }
                next = smaller(next, *due);
            }
        if (t < n - 1 && next > n - 1 && next < INFINITY) next = n - 1;
        t = next;
    }
    return FREE;
}

int so101_known_apart(const Scene *a, const Scene *b, const double *placement,
                       const double *levers_a, const double *levers_b, int n, const double *qa,
                       const double *qb, double margin, double skew, Known *known, double *out) {
    const size_t of_a = (size_t)n * a->bodies, of_b = (size_t)n * b->bodies;
    double *travel = malloc(sizeof(double) * (1 + LEVELS) * (of_a + of_b) +
                            (sizeof(Arm[2]) + 1 + 2 * LEVELS) * n);
    if (!travel) return UNKNOWN;
    double *bend = travel + of_a + of_b, *end = bend + LEVELS * (of_a + of_b);
    so101_travelled(a, levers_a, n, qa, travel);
    so101_travelled(b, levers_b, n, qb, travel + of_a);
    const Arm arms[2] = {{.scene = a, .q = qa, .travel = travel}, {.scene = b, .q = qb, .travel = travel + of_a}};
    Steps steps = {arms, placement, {levers_a, levers_b}, n, (Arm(*)[2])end, {bend, bend + LEVELS * of_a}};
    steps.seen = memset(steps.at + n, 0, (1 + 2 * LEVELS) * n);
    steps.bent[0] = steps.seen + n, steps.bent[1] = steps.bent[0] + LEVELS * n;
    const int found = apart(&steps, margin, skew, known, out);
    free(travel);
    return found;
}

/* FREE if all bodies keep `margin` apart. TOUCHING fills `out`: time in steps, distance, the two
 * bodies. UNKNOWN: no memory. `placement`: b's base in a's, rotation by rows, then translation;
 * `levers`: bounds on the distance of each body's points from each joint's axis. */
int so101_apart(const Scene *a, const Scene *b, const double *placement, const double *levers_a,
                const double *levers_b, int n, const double *qa, const double *qb, double margin,
                double skew, double *out) {
    Known known;
    memset(&known, 0, sizeof known);
    return so101_known_apart(a, b, placement, levers_a, levers_b, n, qa, qb, margin, skew, &known, out);
}

/* Distances of every body of `a` from every body of `b` at each of `n` configurations, as so101_gap
 * gives them; `out`: n tables, a row for each body of `a`. The bases are infinitely far apart. */
void so101_gaps(const Scene *a, const Scene *b, const double *placement, int n, const double *qa,
                const double *qb, double need, double enough, double *out) {
    double lie[MOST_BODIES][MOST_BODIES][3], along;
    memset(lie, 0, sizeof lie);
    for (int k = 0; k < n; k++) {
        Arm first = {.scene = a, .q = qa + JOINTS * k}, second = {.scene = b, .q = qb + JOINTS * k};
        so101_look(&first, 0, 1, 0.0);
        so101_look(&second, placement, 1, 0.0);
        for (int i = 0; i < a->bodies; i++)
            for (int j = 0; j < b->bodies; j++)
                *out++ = a->body[i].joint || b->body[j].joint
                             ? so101_between(&first, i, &second, j, need, enough, lie[i][j],
                                             &along)
                             : INFINITY;
    }
}

void so101_course_at(const Course *c, double t, double *q) {
    const double place = fmin(fmax((t - c->t) / c->dt, 0.0), c->n - 1.0);
    const int k = place > c->n - 2 ? (c->n > 1 ? c->n - 2 : 0) : (int)place;
    const double *from = c->q + JOINTS * k, *to = c->n > 1 ? from + JOINTS : from;
    for (int j = 0; j < JOINTS; j++) q[j] = from[j] + (place - k) * (to[j] - from[j]);
}

/* The stop from `t` on along a course; returns how long it takes. */
static double stop_of(const Course *c, double t, double places[PLACES][JOINTS]) {
    double next[JOINTS], speed = 0.0;
    so101_course_at(c, t, places[0]);
    so101_course_at(c, t + c->dt, next);
    for (int j = 0; t >= c->t && j < 5; j++) /* the jaw does not count */
        speed = fmax(speed, fabs(next[j] - places[0][j]) / c->dt);
    const double duration = speed / HARDEST + AT_LEAST;
    for (int i = 1; i < PLACES; i++) {
        const double passed = duration * i / (PLACES - 1);
        const double on = t >= c->t ? passed - passed * passed / (2.0 * duration) : 0.0;
        so101_course_at(c, t + on, places[i]);
    }
    return duration;
}

/* Configurations of two arms every `step` seconds from `since` on, `n` of each; 0 without memory. */
double *so101_sampled(const Course *both, double since, double step, int *n) {
    const double end =
        fmax(both[0].t + both[0].dt * (both[0].n - 1), both[1].t + both[1].dt * (both[1].n - 1)) -
        since;
    *n = end > 0.0 ? (int)ceil(end / step - 1e-9) + 1 : 1;
    double *q = malloc(sizeof(double) * 2 * (size_t)*n * JOINTS);
    for (int which = 0; q && which < 2; which++)
        for (int i = 0; i < *n; i++)
            so101_course_at(&both[which], since + step * i, q + JOINTS * (which * *n + i));
    return q;
}

/* Like so101_apart, for two arms on their courses from `since` on, sampled every `step` seconds and
 * straight in between; see so101_stops_apart for the arguments. */
int so101_courses_apart(const Scene *a, const Scene *b, const double *placement,
                        const double *levers_a, const double *levers_b, const double *a_course,
                        int na, const double *qa, const double *b_course, int nb, const double *qb,
                        double since, double step, double margin, double skew, double *out) {
    const Course both[2] = {{a_course[0], a_course[1], na, qa}, {b_course[0], b_course[1], nb, qb}};
    int n;
    double *q = so101_sampled(both, since, step, &n);
    if (!q) return UNKNOWN;
    const int found = so101_apart(a, b, placement, levers_a, levers_b, n, q, q + JOINTS * n, margin,
                                  skew / step, out);
    free(q);
    if (found != FREE) out[0] = since + step * out[0];
    return found;
}

/* Whether two arms keep apart if both stop along their courses at any of the instants from `since` to
 * `end`, `every` apart; like so101_apart, but the time in `out` is in seconds, as are `skew` and
 * `step`. `a_course` and `b_course`: the start, and the time between their configurations. */
int so101_stops_apart(const Scene *a, const Scene *b, const double *placement,
                      const double *levers_a, const double *levers_b, const double *a_course,
                      int na, const double *qa, const double *b_course, int nb, const double *qb,
                      double since, double end, double every, double step, double margin,
                      double skew, double *out) {
    const Course first = {a_course[0], a_course[1], na, qa};
    const Course second = {b_course[0], b_course[1], nb, qb};
    double before[2][2][JOINTS], moved[2][MOST_BODIES]; /* last and present configurations; travel */
    Known known;
    memset(&known, 0, sizeof known);
    for (int k = 0; since + every * k < end; k++) {
        const double t = since + every * k;
        double stop[2][PLACES][JOINTS];
        const double lasts[2] = {stop_of(&first, t, stop[0]), stop_of(&second, t, stop[1])};
        for (int which = 0; which < 2; which++) {
            memcpy(before[which][1], stop[which][0], sizeof stop[which][0]);
            if (k)
                so101_travelled(which ? b : a, which ? levers_b : levers_a, 2, before[which][0],
                          moved[which]);
            memcpy(before[which][0], stop[which][0], sizeof stop[which][0]);
        }
        for (int i = 0; k && i < a->bodies; i++)
            for (int j = 0; j < b->bodies; j++) known.low[i][j] -= moved[0][i] + moved[1][j];
        const int n = (int)ceil(fmax(lasts[0], lasts[1]) / step - 1e-9) + 1;
        double *q = malloc(sizeof(double) * 2 * (size_t)n * JOINTS);
        if (!q) return UNKNOWN;
        for (int which = 0; which < 2; which++) {
            const Course way = {0.0, lasts[which] / (PLACES - 1), PLACES, stop[which][0]};
            for (int i = 0; i < n; i++)
                so101_course_at(&way, step * i, q + JOINTS * (which * n + i));
        }
        const int found = so101_known_apart(a, b, placement, levers_a, levers_b, n, q, q + JOINTS * n,
                                      margin, skew / step, &known, out);
        free(q);
        if (found != FREE) {
            out[0] = t + step * out[0];
            return found;
        }
    }
    return FREE;
}
