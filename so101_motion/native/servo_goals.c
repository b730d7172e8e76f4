/* The goals of the servos from commanded angles; goal_compensation.py, lag_compensation.py and
 * goal_limiter.py say how and why. */
#include "servos.h"

#define DEG (3.141592653589793 / 180.0)
#define TICKS_PER_RAD (4096.0 / (2.0 * 3.141592653589793))

/* How long before a joint turns round its friction begins to change sides, as a share of half the time that
 * the servo's set-point needs for that step. Chosen by trial, as the time in which it does [s]. */
#define EARLY 1.2
#define FLIP 0.04
#define CROSSING 0.06 /* time in which a motor is driven through the play as its joint goes [s]; by trial */
/* The same the other way, under a load that leads its joint on [s]. Chosen: if the load is not what the driver
 * takes it for, the joint is slower for that time instead of standing. */
#define TAKEN_BACK 0.25
#define STANDS (1.0 * DEG) /* nothing is predicted for a slower joint [rad/s]. Chosen. */
#define PRESSED 0.03       /* a smaller load may not keep the gears on its side [N m]; chosen by trial */
#define RECENT 0.05        /* a servo's set-point is predicted over no more time than this [s] */
/* Below this speed the lag is so small that its compensation may start and end at once [rad/s]. */
#define SLOW 0.03
#define BLEND 0.5 /* time in which it is faded in or out otherwise [s]; chosen, longer than a stop */
/* For a joint that follows a target: below the first [rad/s] its lag is compensated less, down to the second
 * as a share; and its set-point accelerates by at most the third, as a share of its braking. A servo that turns
 * round has to cross its play; with a set-point as far ahead as in a planned motion it would then accelerate
 * harder than any joint may. Chosen by trial. */
#define TURNING (60.0 * DEG)
#define FOLLOWING_SHARE 0.4
#define FOLLOWING_BRAKING 0.8
/* Largest lead over the command of a joint that follows a target [rad]. Chosen: 5 deg more than the slowest
 * braking servo needs at 180 deg/s without lag compensation. */
#define MOST_AHEAD (40.0 * DEG)
/* How much the firmware drops of a moving set-point on average [tick]: it counts finer than in ticks, divides,
 * and drops the remainder. Read in a reconstruction of the factory firmware, whose division the emulator copies;
 * at rest nothing is dropped, because goals are whole ticks. A slower set-point than the second is at its goal for
 * a part of every period, and loses less [rad/s]. Chosen: at this speed it is a tick behind. */
#define CUT_OFF 0.5
#define CUT_OFF_SPEED (10.0 * DEG)
#define GIVEN_UP 2.0 /* time in which the offset of uncompensated joints is faded out [s]; chosen, they sag slowly */
#define ROUNDING 1e-6 /* [rad] and [rad/s] */
#define TURN 1e-4     /* for differences of the weights [rad] */

/* Inertia that the moved links add to each joint [kg m^2]; chosen, averages. */
static const double INERTIA[JAW] = {0.012, 0.014, 0.007, 0.002, 0.001};

/* The limiter */

static double between(double value, double end) { return least(most(value, least(end, 0.0)), most(end, 0.0)); }

/* `qd`: of the first joints, 0 if there are none. Returns -1, or the joint that refuses, plus 8 if that is for
 * its velocity. */
int so101_limiter_follow(Limiter *l, const double *q, const double *qd, const double *here, uint32_t free,
                         double now) {
    double elapsed = most(now - l->t, 0.0), kept[SERVOS];
    /* The joints stand, so what comes now begins, or goes on, from rest. */
    if (elapsed > l->pause + l->catch_up) elapsed = l->catch_up;
    /* The pause may have ended just before the last command: nothing moved in a single period. */
    const int has_paused = now - l->t_before >= l->pause, known = qd ? JAW : 0;
    const double change = l->acceleration * (elapsed + l->catch_up);
    const double bend = 0.25 * l->acceleration * ((elapsed + l->slack) * (elapsed + l->slack));
    for (int i = 0; i < SERVOS; i++) {
        const double step = fabs(q[i] - l->q[i]), time = elapsed + l->kept[i];
        double v = l->speed, more = 0.0;
        kept[i] = l->catch_up;
        l->step = q[i] - l->q[i], l->elapsed = elapsed;
        if (i < known && !isnan(qd[i])) {
            const double before = l->qd[i], reached = has_paused ? between(qd[i], before) : before;
            if (!(fabs(qd[i]) <= l->speed + ROUNDING) || !(fabs(qd[i] - reached) <= change)) {
                l->before = before, l->asked = qd[i], l->allowed = change;
                if (!holds(free, i)) return i + 8;
            }
            v = least(most(fabs(qd[i]), fabs(before)), v), more = bend;
        } else if ((i < known || step > v * time) && fabs(q[i] - here[i]) <= l->seed) {
            l->lead[i] = 0.0; /* it is to stay there */
            continue;
        }
        const double allowed = v * time + more;
        if (!(step <= allowed + ROUNDING)) {
            if (holds(free, i)) continue;
            l->allowed = allowed;
            return i;
        }
        const double used = v > 0.0 && step > more ? (step - more) / v : 0.0;
        kept[i] = least(most(time - used, 0.0), l->catch_up);
    }
    for (int i = 0; i < SERVOS; i++) {
        l->q[i] = q[i], l->kept[i] = kept[i];
        l->qd[i] = i < known && !isnan(qd[i]) ? qd[i] : 0.0;
    }
    l->t_before = l->t, l->t = now;
    return -1;
}

void so101_limiter_goals(Limiter *l, const double *offset, const double *largest, const double *lead,
                         double now) {
    const double dt = now - l->t_goal + l->slack, change = l->lead_speed * l->speed * dt;
    for (int i = 0; i < SERVOS; i++) {
        const int begins = l->begins != 0.0; /* then they may jump to their values */
        const double wanted = begins ? offset[i] : within_change(offset[i], l->offset[i], l->offset_speed * dt);
        l->offset[i] = limited(wanted, largest[i]);
        l->lead[i] = begins ? lead[i] : within_change(lead[i], l->lead[i], change);
        l->goal[i] = l->q[i] + l->offset[i] + l->lead[i];
    }
    l->t_goal = now, l->begins = 0.0;
}

/* Goals of the first `n` joints while a hand guides them, from `goal`. */
void so101_limiter_yielded(Limiter *l, const double *goal, int n, double now) {
    const double time = most(now - l->t_goal, 0.0) + l->spare, change = l->speed * time;
    double farthest = 0.0;
    for (int i = 0; i < n; i++) {
        const double before = l->goal[i];
        l->goal[i] = within_change(goal[i], before, change);
        farthest = most(farthest, fabs(l->goal[i] - before));
    }
    l->spare = least(l->slack, most(time - farthest / l->speed, 0.0));
    l->t_goal = now;
}

/* Where joints turn round */

/* The side to which each joint's friction is to be compensated now, and how fully, -1 to 1; NaN for a joint that
 * hardly moves: it may be coming to rest, or creep on for long. `dt`: since the last time, 0 if the clock has
 * not gone on. */
static void foresee(Goals *g, double dt, double *ways) {
    const Trim *t = g->trim;
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
        const double weight = t->weights[i];
        double ahead = g->qd[i];
        ways[i] = NAN, g->crossing[i] = 0.0;
        if (g->qdd[i] != 0.0) {
            const double turn = 2.0 * so101_servo_friction(s, weight, 1.0, 0.0) /
                                so101_servo_stiffness(s);
            ahead += (g->delay + t->later[i] + s->goal_delay + EARLY * sqrt(turn / s->braking)) * g->qdd[i];
        }
        if (fabs(ahead) > STANDS) ways[i] = within_change(copysign(1.0, ahead), t->ways[i], 2.0 * dt / FLIP);
        if (s->play > 0.0 && dt > 0.0 && (fabs(ahead) > STANDS || fabs(weight) > PRESSED)) {
            const double before = g->side[i], wanted = copysign(1.0, fabs(weight) > PRESSED ? weight : ahead);
            g->side[i] = within_change(wanted, before, 2.0 * dt / (wanted * ahead >= 0.0 ? CROSSING : TAKEN_BACK));
            g->crossing[i] = 0.5 * s->play * (g->side[i] - before) / dt;
        }
    }
}

/* Take the next command. `given`: angles of six joints, velocities and accelerations of five, torques that hold
 * the pose then and what each kilogram adds, six each, unless the weight of the arm is known; `here`: confirmed
 * angles. Returns as so101_limiter_follow. */
int so101_goals_point(Goals *g, const double *given, const double *here, int has_qd, int has_qdd,
                      int follows_target, uint32_t free, double now) {
    const double *q = given, *qd = q + SERVOS, *qdd = qd + JAW, *own = qdd + JAW;
    const double dt = now - g->t_point;
    double ways[JAW], was[JAW];
    int moved = g->trim->has_goal == 0.0;
    const int refused = so101_limiter_follow(g->limiter, q, has_qd ? qd : 0, here, free, now);
    if (refused >= 0) return refused;
    for (int i = 0; i < JAW; i++) {
        was[i] = g->qd[i], ways[i] = NAN;
        g->qd[i] = has_qd && !isnan(qd[i]) ? qd[i] : 0.0;
        /* While lag compensation is faded out, a set-point must not run on as the joint slows. */
        const int changes = has_qd && g->has_qd != 0.0 && 0.0 < dt && dt < RECENT;
        g->qdd[i] = has_qdd ? qdd[i] : changes ? (g->qd[i] - was[i]) / dt : 0.0;
        g->crossing[i] = 0.0;
    }
    g->is_told = has_qdd, g->follows_target = follows_target;
    g->trim->is_planned = has_qdd && !follows_target;
    if (has_qd && has_qdd && !follows_target) foresee(g, dt < RECENT ? dt : g->limiter->slack, ways);
    g->has_qd = has_qd, g->t_point = now;
    for (int i = 0; i < SERVOS; i++) moved |= q[i] != g->trim->goal[i];
    if (moved && g->trim->arm) { /* where the joints will be when the goal acts */
        double then[SERVOS], torque[SERVOS], added[SERVOS], turned[SERVOS], turned_added[SERVOS];
        for (int i = 0; i < SERVOS; i++) then[i] = (i < JAW ? q[i] + g->ahead * g->qd[i] : q[i]) + g->trim->zero[i];
        so101_weigh(g->trim->arm, then, torque, added);
        for (int j = 0; j < LIFTING; j++) {
            then[1 + j] += TURN;
            so101_weigh(g->trim->arm, then, turned, turned_added);
            then[1 + j] -= TURN;
            for (int i = 0; i < JAW; i++) {
                const double more = turned[i] - torque[i] + g->trim->carried * (turned_added[i] - added[i]);
                g->trim->by_angle[j][i] = more / TURN;
            }
        }
        so101_trim_command(g->trim, q, g->qd, ways, torque, added, now);
    } else if (moved) so101_trim_command(g->trim, q, g->qd, ways, own, own + SERVOS, now);
    for (int i = 0; has_qd && i < JAW; i++)
        if (isnan(qd[i])) { /* it stays where it is */
            g->setpoint_qd[i] = 0.0;
            so101_trim_give_way(g->trim, i);
        }
    return -1;
}

/* What is added to commands */

/* How far a joint at qd [rad/s] goes while it brakes by `acceleration` [rad/s^2]. */
double so101_stopping_distance(double qd, double acceleration) { return qd * fabs(qd) / (2.0 * acceleration); }

/* The average that the firmware drops of a set-point moving at qd [rad/s], [rad]. */
double so101_cut_off(double qd) { return CUT_OFF / TICKS_PER_RAD * least(fabs(qd) / CUT_OFF_SPEED, 1.0); }

/* The lead that compensates the lag of joint i [rad]. */
static double lead(Goals *g, int i, double dt) {
    Trim *t = g->trim;
    const Servo *s = t->servo[i];
    const double qd = g->qd[i], qdd = g->qdd[i], before = g->setpoint_qd[i], wanted = g->is_told;
    const double delay = g->delay + (t->is_planned != 0.0 ? t->later[i] + t->hurry[i] : 0.0), late = delay + so101_servo_lag(s);
    const double lag = g->lags[i] + (qd * dt - least(dt / late, 1.0) * g->lags[i]);
    double share = g->foreseen[i];
    g->lags[i] = lag;
    t->lags[i] = (1.0 - share) * lag;
    if (fabs(qd) < SLOW) share = wanted;
    else if (share != wanted) /* one that follows a target at speed is not overtaken */
        share += least(most(wanted - share, -dt / BLEND), g->follows_target != 0.0 ? 0.0 : dt / BLEND);
    g->foreseen[i] = share;
    if (!(qd != 0.0 || qdd != 0.0 || before != 0.0 || g->crossing[i] != 0.0)) return 0.0;
    /* The set-point runs ahead of the joint; no faster than it can. */
    double faster = s->braking * dt;
    const double slower = faster;
    if (g->follows_target != 0.0) {
        faster *= g->is_told != 0.0 ? FOLLOWING_BRAKING : 1.0;
        share *= FOLLOWING_SHARE + (1.0 - FOLLOWING_SHARE) * least(fabs(qd) / TURNING, 1.0);
        t->lags[i] = (1.0 - share) * lag;
    }
    const double low = before > 0.0 ? slower : faster, high = before > 0.0 ? faster : slower;
    const double drift = qd != 0.0 && t->is_planned != 0.0 ? t->weight_rate[i] : 0.0;
    const double setpoint_qd = least(most(qd + share * (qdd * late + drift), before - low), before + high);
    g->setpoint_qd[i] = setpoint_qd;
    /* A goal sent now acts later, when the joint has moved on and is faster or slower. */
    const double later = delay + s->goal_delay, then = qd + qdd * later + g->crossing[i];
    const double torque = t->torque[i] + (s->viscous * then + (s->armature + INERTIA[i]) * qdd);
    const double behind = so101_servo_distance(s, torque, then) - t->without_speed[i];
    double ahead = so101_stopping_distance(setpoint_qd, s->braking);
    ahead += share * (behind + later * (qd + 0.5 * qdd * later));
    ahead += g->direction[i] * so101_cut_off(setpoint_qd);
    return g->follows_target != 0.0 ? least(most(ahead, -MOST_AHEAD), MOST_AHEAD) : ahead;
}

/* The goals to send [tick]; nothing is added to those of `weak` servos. */
void so101_goals(Goals *g, uint32_t weak, double now, int *ticks) {
    Trim *t = g->trim;
    const double dt = least(now - g->t_goals, RECENT);
    double offset[SERVOS], leads[SERVOS] = {0}, bound[SERVOS] = {0};
    g->t_goals = now;
    for (int i = 0; i < SERVOS; i++) {
        if (g->has_qd == 0.0) g->setpoint_qd[i] = g->lags[i] = t->lags[i] = 0.0;
        else if (i < JAW) leads[i] = lead(g, i, dt);
        offset[i] = t->known[i] + t->rest[i];
        if (g->compensates == 0.0) offset[i] *= most(1.0 - (now - g->t_begin) / GIVEN_UP, 0.0), leads[i] = 0.0;
        if (holds(weak, i)) offset[i] = leads[i] = 0.0;
        if (i < JAW) bound[i] = so101_servo_error_for(t->servo[i], g->largest_offset);
    }
    so101_limiter_goals(g->limiter, offset, bound, leads, now);
    for (int i = 0; i < SERVOS; i++) {
        const double there = rint(g->zero_ticks[i] + g->direction[i] * g->limiter->goal[i] * TICKS_PER_RAD);
        ticks[i] = (int)least(most(there, g->lower_ticks[i]), g->upper_ticks[i]);
    }
}

/* The packet that sends the goals to all servos but those `absent`; returns its size, 0 if there is none. */
int so101_goals_send(Goals *g, uint32_t weak, uint32_t absent, int address, double now, uint8_t *packet) {
    int ticks[SERVOS], servo[SERVOS], n = 0;
    so101_goals(g, weak, now, ticks);
    for (int i = 0; i < SERVOS; i++) {
        if (g->servo[i] == 0 || holds(absent, i)) continue;
        g->held[i] = ticks[i];
        servo[n] = g->servo[i], ticks[n++] = ticks[i];
    }
    return n ? so101_sync_write_words(packet, address, servo, ticks, n) : 0;
}

/* The joints that may stand in their play now; `stray`: how far they fall behind then [rad]. From bit 8 on those
 * that are held. */
uint32_t so101_goals_in_play(const Goals *g, double *stray) {
    uint32_t found = 0, held = 0;
    for (int i = 0; i < SERVOS; i++) held |= (uint32_t)(g->held[i] != LIMP) << i;
    if (g->follows_target == 0.0 && g->is_told != 0.0) {
        found = so101_trim_in_play(g->trim);
        for (int i = 0; i < JAW; i++) {
            found |= (uint32_t)(g->crossing[i] != 0.0) << i;
            if (holds(found, i)) stray[i] = so101_servo_stray(g->trim->servo[i], fabs(g->qd[i]));
        }
    }
    return found | held << 8;
}
