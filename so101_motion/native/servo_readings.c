/* What servos report: which positions to believe, angles, velocities. position_check.py and joint_estimate.py
 * say how and why. Positions are in ticks. */
#include <string.h>

#include "servos.h"

#define TURN 4096
#define RAD_PER_TICK (2.0 * 3.141592653589793 / 4096.0)

/* Play that a joint may cross at once [tick]: 14.8 were measured on an SO-101 (robonine), 0.5 deg is specified.
 * A moving joint whose load changes sides crosses it in 10 ms. */
#define PLAY 15.0
#define RECENT 0.1     /* longest time for which the last sure velocity is used [s] */
#define SPACING 0.004  /* velocities come from readings at least so far apart [s]; chosen */
/* Measurements closer together than a sixteenth of the window are left out: at 100 a second none, at 200 every
 * other one. They would cost time and add little. */
#define NARROW 16.0
#define FEWEST 3 /* with two points the scatter would be the slope; slow polling keeps this many */

/* From one position to another, the short way. */
static int moved(int to, int from) { return ((to - from + TURN / 2) % TURN + TURN) % TURN - TURN / 2; }

void so101_position_begin(Position *p, int ticks, double t, int is_sure) {
    p->is_there = 1.0, p->is_sure = is_sure, p->t = p->last_t = t;
    p->ticks = p->last = ticks, p->sure_t = is_sure ? t : -INFINITY;
    p->v = p->last_v = p->count = 0.0;
}

/* Count readings in a row that agree with each other but not with the past. */
static void count_in(Position *p, int ticks, double asked) {
    const double way = moved(ticks, (int)p->last), dt = asked - p->last_t, on = p->last_v * dt;
    const double hands = 0.5 * p->fastest; /* largest speed between readings that agree with each other */
    if (p->count == 1.0 && fabs(way) <= p->close + hands * dt && dt <= RECENT) p->count = 2.0;
    else if (p->count > 1.0 && least(on, 0.0) - p->close <= way && way <= most(on, 0.0) + p->close) p->count += 1.0;
    else p->count = 1.0;
    if (p->count == 1.0 || dt >= SPACING) {
        p->last_v = p->count > 1.0 ? way / dt : 0.0;
        p->last = ticks, p->last_t = asked;
    }
}

/* Whether the joint can be there; if so, that becomes its known position. */
int so101_position_judge(Position *p, int ticks, double asked, double answered) {
    if (ticks < 0 || ticks >= TURN) return 0;
    const double way = moved(ticks, (int)p->ticks), dt = answered - p->sure_t;
    const double on = dt <= RECENT ? p->v * dt : 0.0;
    const double above = on > 0.0 ? way - on : way, below = on > 0.0 ? -way : on - way;
    const double beyond = above > below ? above : below;
    const int is_possible = fabs(way) <= p->scatter + p->fastest * dt;
    if (is_possible && beyond <= p->close) { /* it agrees with the past */
        const double since = asked - p->sure_t;
        if (since >= SPACING) p->v = way / since, p->ticks = ticks, p->sure_t = asked;
        p->t = asked, p->is_sure = 1.0, p->count = 0.0;
        return 1;
    }
    count_in(p, ticks, asked);
    if (!is_possible) return 0;
    if (p->count >= p->enough) {
        p->ticks = ticks, p->sure_t = asked, p->v = p->last_v;
        p->t = asked, p->is_sure = 1.0;
        return 1;
    }
    if (beyond <= p->scatter + PLAY + 0.5 * p->push * dt * dt) {
        p->t = asked, p->is_sure = 0.0;
        return 1;
    }
    return 0;
}

/* Take the positions in `answers`, whose bytes are `in`; returns the joints that cannot be there. */
uint32_t so101_estimate_hear(Estimate *e, const Answers *answers, const uint8_t *in, double asked, double when) {
    uint32_t doubted = 0;
    for (int i = 0; i < SERVOS; i++) {
        const int at = e->direction[i] != 0.0 ? answers->at[e->servo[i]] : 0;
        if (at <= 0) continue;
        const int ticks = e->ticks[i] = in[at] | in[at + 1] << 8; /* with its sign set none an encoder has */
        int is_credible = 0 <= ticks && ticks < TURN;
        if (e->known[i].is_there != 0.0) is_credible = so101_position_judge(&e->known[i], ticks, asked, when);
        else if (is_credible) so101_position_begin(&e->known[i], ticks, asked, 0);
        if (is_credible) e->fresh |= 1u << i;
        else doubted |= 1u << i;
    }
    return doubted;
}

/* Add a row of angles to those of the last `window` [s], and fit their slopes. */
static void slopes(Estimate *e, double now) {
    int n = (int)e->rows;
    if (n == 0 || now - e->time[n - 1] >= e->window / NARROW) {
        e->time[n] = now;
        memcpy(e->row[n++], e->q, sizeof e->q);
        int old = 0;
        while (n - old > FEWEST && e->time[old] < now - e->window - 1e-9) old++;
        n -= old;
        memmove(e->time, e->time + old, n * sizeof *e->time);
        memmove(e->row, e->row + old, n * sizeof *e->row);
        e->rows = n;
    }
    double middle = 0.0, spread = 0.0, t[ROWS];
    for (int k = 0; k < n; k++) middle += e->time[k];
    middle /= n;
    for (int k = 0; k < n; k++) t[k] = e->time[k] - middle, spread += t[k] * t[k];
    for (int i = 0; i < SERVOS; i++) {
        double sum = 0.0;
        for (int k = 0; k < n; k++) sum += t[k] * e->row[k][i];
        e->qd[i] = spread > 0.0 ? sum / spread : 0.0;
    }
}

double so101_estimate_angle(const Estimate *e, int i, int ticks) {
    const int seam = (int)e->seam[i];
    const int unrolled = seam + ((ticks - seam) % TURN + TURN) % TURN;
    return e->direction[i] * (unrolled - e->zero_ticks[i]) * RAD_PER_TICK;
}

/* The joints whose position no two answers have confirmed since then [s]. */
uint32_t so101_estimate_unconfirmed(const Estimate *e, double since) {
    uint32_t found = 0;
    for (int i = 0; i < SERVOS; i++) {
        const Position *p = &e->known[i];
        const int is_confirmed = p->is_there != 0.0 && p->is_sure != 0.0 && p->t >= since;
        found |= (uint32_t)(e->direction[i] != 0.0 && !is_confirmed) << i;
    }
    return found;
}

/* Update the estimate from credible answers; `wanted`: commanded angles. */
void so101_estimate_look(Estimate *e, const double *wanted, double now) {
    for (int i = 0; i < SERVOS; i++) {
        if (e->direction[i] == 0.0) continue; /* no servo */
        if (holds(e->fresh, i)) {
            e->q[i] = e->seen[i] = so101_estimate_angle(e, i, e->ticks[i]);
            e->seen_wanted[i] = wanted[i];
            continue;
        }
        const double q = e->seen[i], then = e->seen_wanted[i];
        e->q[i] = q;
        if (!isnan(wanted[i]) && !isnan(then))
            e->q[i] = least(most(q + wanted[i] - then, least(q, wanted[i])), most(q, wanted[i]));
    }
    slopes(e, now);
    e->unsure = so101_estimate_unconfirmed(e, -INFINITY);
    for (int i = 0; i < SERVOS; i++)
        e->sure[i] = e->direction[i] == 0.0 || holds(e->unsure, i) ? NAN : e->q[i];
}

/* All that a cycle has to do with answers in which every servo stands where it can be, without a fault: hear them,
 * look, and let `learns`, if it is given, learn from them. Others are only heard. Returns the joints that cannot be
 * there, plus 256 if the answers were only heard. */
uint32_t so101_estimate_take(Estimate *e, const Answers *answers, const uint8_t *in, double asked, double when,
                             const double *wanted, Trim *learns) {
    const uint32_t doubted = so101_estimate_hear(e, answers, in, asked, when);
    if (doubted || answers->faults || answers->found < answers->servos) return doubted | 256;
    so101_estimate_look(e, wanted, asked);
    if (learns) so101_trim_measure(learns, e->q, e->qd, e->fresh, asked);
    return 0;
}
