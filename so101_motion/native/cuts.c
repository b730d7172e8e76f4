/* Makes a motion along a path and shortens it in time.
 *
 * A motion is a chain of pieces of constant acceleration. The first one stops at every corner of the
 * path. Then two instants of it are taken at random, and each joint goes from its state (angle and
 * speed) at the first to its state at the second as fast as its limits allow, all in the same time. If
 * that is shorter and free of contact, it replaces what was between them.
 *
 * Jerk is bounded later, by an average over a window of time (retime.c), which rounds what is
 * planned here; so that average is what is checked for contact.
 *
 * Sources: K. Hauser, V. Ng-Thow-Hing, Fast Smoothing of Manipulator Trajectories using Optimal
 * Bounded-Acceleration Shortcuts, ICRA 2010.
 *
 * The same path and seed give the same motion on every machine, as in search.c.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

#define MORE_KNOTS 512 /* than the first motion has */
#define MOST_PHASES (2 * ARM_JOINTS + 1)
#define AT_ONCE 16
#define GAIN 2e-4 /* a cut that saves less than this share of the motion is not checked */

/* The state where a piece begins, its acceleration, and the integral of the angles up to there. */
typedef struct {
    double t, q[ARM_JOINTS], v[ARM_JOINTS], a[ARM_JOINTS], sum[ARM_JOINTS];
} Knot;

typedef struct {
    double velocity[ARM_JOINTS], acceleration[ARM_JOINTS], lower[ARM_JOINTS], upper[ARM_JOINTS];
    double half; /* of the window [s] */
    uint64_t random;
    int count, room; /* of knots; the last one is the end */
    Knot *knot, *other;
} Motion;

/* One joint's way from one state to another: acceleration a, then none, then -a. */
typedef struct {
    double a, first, last; /* [rad/s^2]; how long the two take [s] */
} Phases;

/* The least time for a joint, without regard to others. */
static double least_time(double d, double v0, double v1, double V, double A) {
    const double direct = fabs(v1 - v0) * (v0 + v1) / (2.0 * A), sign = d >= direct ? 1.0 : -1.0;
    d *= sign, v0 *= sign, v1 *= sign;
    const double square = A * d + 0.5 * (v0 * v0 + v1 * v1);
    if (square <= V * V) return (2.0 * sqrt(fmax(square, 0.0)) - v0 - v1) / A;
    return d / V + ((V - v0) * (V - v0) + (V - v1) * (V - v1)) / (2.0 * A * V);
}

/* The gentlest way in a given time; whether there is one of this form within the limits. */
static int timed(double d, double v0, double v1, double T, double V, double A, Phases *p) {
    const double b = 2.0 * d - T * (v0 + v1), step = v1 - v0;
    const double root = sqrt(b * b + T * T * step * step);
    double best = INFINITY;
    for (int k = 0; k < 2; k++) {
        double a = (b + (k ? -root : root)) / (T * T);
        if (fabs(a) >= best) continue;
        if (fabs(step) > fabs(a) * T * (1.0 + 1e-12)) continue;
        double first = a != 0.0 ? fmin(fmax(0.5 * (T + step / a), 0.0), T) : T, last = T - first;
        const double peak = v0 + a * first, sign = peak > 0.0 ? 1.0 : -1.0;
        if (sign * peak > V) {
            const double up = fmax(V - sign * v0, 0.0), down = fmax(V - sign * v1, 0.0);
            const double left = V * T - sign * d;
            if (left <= 0.0) continue;
            a = (up * up + down * down) / (2.0 * left);
            if (a <= 0.0) continue;
            first = up / a, last = down / a, a *= sign;
            if (first + last > T * (1.0 + 1e-9)) continue;
        }
        if (fabs(a) > A * (1.0 + 1e-9)) continue;
        best = fabs(a);
        *p = (Phases){a, first, last};
    }
    return best < INFINITY;
}

static void forward(const Knot *from, double dt, Knot *to) {
    for (int j = 0; j < ARM_JOINTS; j++) {
        const double q = from->q[j], v = from->v[j], a = from->a[j];
        to->q[j] = q + dt * (v + 0.5 * dt * a);
        to->v[j] = v + dt * a;
        to->sum[j] = from->sum[j] + dt * (q + dt * (0.5 * v + dt * a / 6.0));
    }
}

static int piece_at(const Knot *k, int n, double t) {
    int low = 0, high = n - 1; /* k[low].t <= t < k[high].t */
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (k[middle].t <= t) low = middle;
        else high = middle;
    }
    return low;
}

/* The integral of the angles at a time, `at` its piece or an earlier one; at rest outside. */
static int integral(const Knot *k, int n, double t, int at, double *sum) {
    while (at < n - 1 && k[at + 1].t <= t) at++;
    const Knot *from = k + at;
    const double dt = t - from->t;
    for (int j = 0; j < ARM_JOINTS; j++) {
        const double v = from->v[j], a = from->a[j];
        sum[j] = dt < 0.0 || at == n - 1
                     ? from->sum[j] + dt * from->q[j]
                     : from->sum[j] + dt * (from->q[j] + dt * (0.5 * v + dt * a / 6.0));
    }
    return at;
}

/* Whether the averaged motion is free from `begin` to `end`. */
static int is_free(const Checker *c, const Knot *k, int n, double half, double begin, double end) {
    double fastest = 0.0;
    const int from = piece_at(k, n, begin - half);
    for (int i = from; i < n && (i == from || k[i - 1].t < end + half); i++) {
        double rate = 0.0;
        for (int j = 0; j < ARM_JOINTS; j++) rate += fabs(k[i].v[j]) * c->reach[j];
        fastest = fmax(fastest, rate);
    }
    const int count = (int)((end - begin) * fastest / c->spacing) + 1;
    const int stride = (count + AT_ONCE) / AT_ONCE;
    for (int offset = 0; offset < stride; offset++) {
        double q[AT_ONCE * JOINTS], early[ARM_JOINTS], late[ARM_JOINTS];
        uint8_t verdict[AT_ONCE];
        int m = 0, a = from, b = from;
        for (int i = offset; i <= count; i += stride, m++) {
            const double t = begin + (end - begin) * i / count;
            a = integral(k, n, t - half, a, early);
            b = integral(k, n, t + half, b, late);
            for (int j = 0; j < ARM_JOINTS; j++)
                q[JOINTS * m + j] = (late[j] - early[j]) / (2.0 * half);
            q[JOINTS * m + ARM_JOINTS] = c->q_jaw;
        }
        if (m && so101_check(c->scene, c->levels, q, m, 1, verdict)) return 0;
    }
    return 1;
}

static int compare(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Writes the pieces between two states; returns their number. `k[0]` is the first state. */
static int connect(Knot *k, double T, const Phases *p) {
    double ends[2 * ARM_JOINTS + 2];
    int n = 0, count = 0;
    ends[n++] = 0.0, ends[n++] = T;
    for (int j = 0; j < ARM_JOINTS; j++) ends[n++] = p[j].first, ends[n++] = T - p[j].last;
    qsort(ends, n, sizeof *ends, compare);
    const double t0 = k[0].t;
    for (int i = 0; i + 1 < n; i++) {
        const double dt = ends[i + 1] - ends[i], middle = 0.5 * (ends[i] + ends[i + 1]);
        if (dt < 1e-9 || ends[i] < 0.0 || ends[i + 1] > T) continue;
        for (int j = 0; j < ARM_JOINTS; j++)
            k[count].a[j] = middle < p[j].first ? p[j].a : middle > T - p[j].last ? -p[j].a : 0.0;
        forward(k + count, dt, k + count + 1);
        k[count + 1].t = t0 + ends[i + 1];
        count++;
    }
    return count;
}

static int within(const Motion *h, const Knot *k, int n) {
    for (int i = 0; i <= n; i++)
        for (int j = 0; j < ARM_JOINTS; j++) {
            double low = k[i].q[j], high = low;
            if (i < n && k[i].v[j] * k[i + 1].v[j] < 0.0) {
                const double turn = low - 0.5 * k[i].v[j] * k[i].v[j] / k[i].a[j];
                low = fmin(low, turn), high = fmax(high, turn);
            }
            if (low < h->lower[j] - 1e-9 || high > h->upper[j] + 1e-9) return 0;
        }
    return 1;
}

static int try_cut(const Team *m, Motion *h) {
    const double total = h->knot[h->count - 1].t;
    const double x = so101_drawn(&h->random), y = so101_drawn(&h->random);
    const double begin = fmin(x, y) * total, end = fmax(x, y) * total;
    const int i = piece_at(h->knot, h->count, begin), e = piece_at(h->knot, h->count, end);
    if (i == e || h->knot[e + 1].t - end < 1e-9) return 0;
    Knot from = h->knot[i], to = h->knot[e];
    forward(h->knot + i, begin - h->knot[i].t, &from);
    forward(h->knot + e, end - h->knot[e].t, &to);
    from.t = begin;
    const double room = end - begin - GAIN * total;
    double T = 0.0;
    for (int j = 0; j < ARM_JOINTS; j++) {
        T = fmax(T, least_time(to.q[j] - from.q[j], from.v[j], to.v[j], h->velocity[j],
                               h->acceleration[j]));
        if (T >= room) return 0;
    }
    if (T < 1e-6) return 0;
    Phases p[ARM_JOINTS];
    for (int j = 0; j < ARM_JOINTS; j++)
        if (!timed(to.q[j] - from.q[j], from.v[j], to.v[j], T, h->velocity[j], h->acceleration[j],
                   p + j))
            return 0;
    if (h->count + MOST_PHASES + 2 > h->room) return 0;
    Knot *k = h->other;
    int n = i + (begin - h->knot[i].t > 1e-9);
    memcpy(k, h->knot, n * sizeof *k);
    k[n] = from;
    const int pieces = connect(k + n, T, p);
    if (!within(h, k + n, pieces)) return 0;
    n += pieces;
    /* The rest of the motion, earlier. */
    const double earlier = end - begin - T;
    double more[ARM_JOINTS];
    for (int j = 0; j < ARM_JOINTS; j++) more[j] = k[n].sum[j] - to.sum[j], to.sum[j] = k[n].sum[j];
    to.t = begin + T;
    k[n++] = to;
    for (int next = e + 1; next < h->count; next++, n++) {
        k[n] = h->knot[next];
        k[n].t -= earlier;
        for (int j = 0; j < ARM_JOINTS; j++) k[n].sum[j] += more[j];
    }
    if (!is_free(m->arm, k, n, h->half, begin - h->half, begin + T + h->half)) return 0;
    h->other = h->knot, h->knot = k, h->count = n;
    return 1;
}

void so101_motion_free(Motion *h) {
    if (!h) return;
    free(h->knot), free(h->other), free(h);
}

/* The motion along n points, at rest at each. `limits`: velocities, accelerations, lower, upper. */
Motion *so101_motion_new(const double *points, int n, const double *limits, double window,
                         uint64_t seed) {
    Motion *h = calloc(1, sizeof *h);
    if (!h) return 0;
    h->room = 3 * n + MORE_KNOTS;
    h->knot = malloc(h->room * sizeof *h->knot), h->other = malloc(h->room * sizeof *h->knot);
    if (!h->knot || !h->other) {
        so101_motion_free(h);
        return 0;
    }
    memcpy(h->velocity, limits, 4 * ARM_JOINTS * sizeof *limits);
    h->half = 0.5 * window, h->random = seed;
    Knot *k = h->knot;
    memset(k, 0, sizeof *k);
    memcpy(k->q, points, sizeof k->q);
    for (int i = 1; i < n; i++) {
        const double *a = points + ARM_JOINTS * (i - 1), *b = a + ARM_JOINTS;
        double V = INFINITY, A = INFINITY;
        for (int j = 0; j < ARM_JOINTS; j++) {
            const double d = fabs(b[j] - a[j]);
            V = fmin(V, h->velocity[j] / d), A = fmin(A, h->acceleration[j] / d);
        }
        if (!(V < INFINITY)) continue;
        const double peak = fmin(V, sqrt(A)), ramp = peak / A, flat = fmax(1.0 / peak - ramp, 0.0);
        const double lengths[] = {ramp, flat, ramp};
        for (int part = 0; part < 3; part++) {
            if (lengths[part] < 1e-9) continue;
            for (int j = 0; j < ARM_JOINTS; j++) k->a[j] = (1 - part) * A * (b[j] - a[j]);
            forward(k, lengths[part], k + 1);
            k[1].t = k->t + lengths[part];
            k++;
        }
        memcpy(k->q, b, sizeof k->q);
        memset(k->v, 0, sizeof k->v);
    }
    memset(k->a, 0, sizeof k->a);
    h->count = (int)(k - h->knot) + 1;
    return h;
}

/* Tries some cuts. Returns the motion's duration [s], negative if stopped. */
double so101_motion_cut(const Team *m, Motion *h, int tries) {
    for (int k = 0; k < tries && h->count > 1 && !so101_team_is_over(m); k++) {
        m->arm->scene->next_ask--; /* a try that is not checked for contact takes as long */
        try_cut(m, h);
    }
    return so101_team_is_over(m) == STOPPED ? -1.0 : h->knot[h->count - 1].t;
}

/* Copies when its n pieces begin and end (n + 1), and the powers of time on each (n, 4, joints), if there is
 * room; returns n. */
int so101_motion_pieces(const Motion *h, double *t, double *powers) {
    for (int i = 0; t && i < h->count; i++) t[i] = h->knot[i].t;
    for (int i = 0; t && i < h->count - 1; i++, powers += 4 * ARM_JOINTS) {
        const Knot *k = h->knot + i;
        for (int j = 0; j < ARM_JOINTS; j++) {
            powers[j] = k->q[j], powers[ARM_JOINTS + j] = k->v[j];
            powers[2 * ARM_JOINTS + j] = 0.5 * k->a[j];
        }
    }
    return h->count - 1;
}
