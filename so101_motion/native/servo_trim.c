/* Servo models, and offsets against weight and friction; servo_model.py and gravity_compensation.py say why. */
#include "servos.h"

/* An integral gain [1/s]: an error shrinks to a tenth in 0.3 s. Chosen; the servo's own response, its delay
 * included, is twice as fast. */
#define GAIN 8.0
/* While the command moves, what is not known is found from the errors of all joints at once, each counted by how
 * well it is known otherwise (a Kalman filter): of each servo by which share it is weaker and its friction greater
 * than its type's, what else is off [N m], how much later it comes [s]; the mass in the gripper [kg]; and by how
 * much the zeros of the joints that lift are off, which shifts their weights [rad]. Standard
 * deviations beforehand; servos whose own figures are known differ by a share of them. Chosen: emulated servos differ
 * by a fifth at most, and the two types come later by 0.05 and 0.04 s. */
#define WEAKER 0.12
#define ROUGHER 0.12
#define OTHERWISE 0.08
#define COMES_LATER 0.05 /* all of them alike */
#define ITS_OWN 0.003
#define CARRIED 0.1
#define OFF_ZERO (3.0 * DEG)
#define KNOWN 0.3
/* How these change in a second: heat and supply, what is gripped. Chosen. */
#define DRIFTS 0.01
#define DRIFTS_OTHERWISE 0.03
#define DRIFTS_LATER 0.002
#define DRIFTS_CARRIED 0.02
#define DRIFTS_OFF_ZERO (0.02 * DEG)
/* Errors have other reasons of about so much [N m], and of twice the friction near rest, less by 1/e for each so
 * much speed [rad/s]; they last so long [s]. Chosen by trial. */
#define NOISE 0.25
#define UNCLEAR 2.0
#define CLEARS 0.3
#define LASTS 0.1
#define MOST_OFF_ZERO (9.0 * DEG) /* most that is taken for a zero that is off [rad]; chosen */
#define MOST_SHARE 0.3      /* most that a servo may be weaker or its friction greater; chosen */
#define BEARING 0.3         /* joints that bear less weight learn less while they follow a target [N m]; chosen */
#define DEG (3.141592653589793 / 180.0)
#define MOVING_ERROR (4.0 * DEG)    /* a moving joint with a larger error is blocked [rad]; chosen */
/* How fast friction is turned over to the other side at rest [rad/s]. Chosen: done in 0.2 s under the arm's
 * weight, and not 4 ticks too far when the joint breaks loose. */
#define TURNING (10.0 * DEG)
/* Share of that speed after each time that a joint went past its goal, but for the first times after it was switched
 * on: then its load is not known. Chosen. */
#define CALMS 0.6
#define BEGINS (1.0 / (CALMS * CALMS))
#define DEAD_BAND (2.5 * 2.0 * 3.141592653589793 / 4096.0) /* smaller errors are ignored [rad]; chosen */
#define LATE 0.45    /* how long after the last command small errors are still corrected [s]; chosen */
#define RECENT 0.05         /* rates are known over no more time than this [s] */
#define FELT_AFTER 0.06     /* a changed goal acts after so long [s]; chosen */
#define CATCHES_UP 0.4      /* after a silence of all servos, which may have missed goals [s]; chosen */
#define LATEST 0.07         /* most that joints may come later [s]; chosen, the two types differ by 0.05 */
#define GENTLY 0.03         /* a changed lead makes joints faster than planned by this share at most; chosen */
/* But by up to the first share where they are planned to be faster soon, or where it makes them slower: so much of
 * it for each second [1/s] by which they come later than is made up for, and than the third share of that figure's
 * standard deviation. The servo answers to such a change so long after it [s], so the lead is that far ahead. All
 * chosen by trial on both types: servos taken for the other one are known after 0.2 s of motion. */
#define QUICKLY 0.2
#define EAGER 15.0
#define SURE 0.3
#define ANSWERS 0.12
#define STILL 0.06          /* how long the command must have stood still [s]: twice a servo's delay. Chosen. */
#define AT_REST (4.0 * DEG) /* a faster joint moves [rad/s]; chosen, above the scatter of a resting one */
#define CARRIES 0.3         /* unknown mass that the gripper may carry [kg]; chosen */
/* Error of the modelled weight of a joint [N m], plus a twentieth of that weight. Chosen: the change of an
 * unloaded arm's weight over 5 deg. Pan and roll bear no weight in any pose. */
#define UNSURE 0.05
/* A smaller load leaves an output where its motor drags it [N m]. Chosen: the emulator's limit is 0.01, less
 * the effect of 0.3 kg with a roll zero that is off by 5 deg. */
#define WEIGHTLESS 0.008
/* Largest play of gears that were not measured [rad]; safety factor for a measured play. Chosen: an
 * identification may find a tenth too little. */
#define PLAY (1.0 * DEG)
#define PLAY_MARGIN 1.2
#define FREED 0.04 /* friction that a motor overcomes alone once its load no longer helps [N m]; chosen */
/* Change of the load while the motor crosses the play [N m]. Chosen, as FREED, so that no emulated joint that
 * crosses its play seems to have hit something: test_servo_model.py lists how far such joints fell behind. */
#define CHANGED 0.045

static double full_torque(const Servo *s) { return s->volts * s->torque_per_volt; }

double so101_servo_stiffness(const Servo *s) { return full_torque(s) / s->full_drive_error; }

double so101_servo_error_for(const Servo *s, double torque) {
    return least(torque / full_torque(s), 1.0) * s->full_drive_error;
}

/* How long a joint lags behind its setpoint without compensation [s]. */
double so101_servo_lag(const Servo *s) { return s->goal_delay + s->back_emf / s->volts * s->full_drive_error; }

double so101_servo_distance(const Servo *s, double torque, double speed) {
    const double share = (torque / s->torque_per_volt + s->back_emf * speed) / s->volts;
    const double duty = pow(fabs(share), s->over_shape) - s->start_duty;
    if (duty <= 0.0) return 0.0;
    const double error = duty * s->full_drive_error + s->dead_zone;
    return share > 0.0 ? error : -error;
}

double so101_servo_friction(const Servo *s, double load, double way, double speed) {
    const double still = speed != 0.0 ? exp(-fabs(speed) / s->stribeck_speed) : 1.0;
    const double world = s->load_external * load, world_still = s->still_external * load;
    double friction = 0.0, motor = load;
    for (int k = 0; k < 2; k++) { /* what the motor exerts depends on the friction, a little */
        friction = s->coulomb + fabs(world + s->load_motor * motor) +
                   still * fabs(world_still + s->still_motor * motor);
        motor = load + way * friction;
    }
    return friction;
}

double so101_servo_stray(const Servo *s, double speed) {
    const double play = isnan(s->play) ? PLAY : PLAY_MARGIN * s->play;
    if (speed == 0.0) return play;
    const double brake = s->torque_per_volt * s->back_emf, stiff = so101_servo_stiffness(s);
    const double late = s->loop_delay + s->armature / (brake + s->viscous) + FREED / (stiff * speed);
    const double h = stiff / brake, more = most(play / speed - late, 0.0);
    const double through = late + (sqrt(1.0 + 2.0 * h * more) - 1.0) / h;
    return least(speed * through, play) + CHANGED / stiff;
}

double so101_servo_drive(const Servo *s, double distance) {
    const double error = fabs(distance) - s->dead_zone;
    return error > 0.0 ? error / s->full_drive_error + s->start_duty : 0.0;
}

static void find(Trim *t, int i) {
    const Servo *s = t->servo[i];
    double torque = t->weights[i];
    if (t->ways[i] != 0.0) {
        const double load = torque + t->rest[i] * so101_servo_stiffness(s);
        torque += t->ways[i] * (1.0 + t->rougher[i]) * so101_servo_friction(s, load, t->ways[i], t->qd[i]);
    }
    torque *= 1.0 + t->weaker[i];
    t->torque[i] = torque;
    t->without_speed[i] = so101_servo_distance(s, torque, 0.0);
    t->known[i] = limited(t->without_speed[i], so101_servo_error_for(s, s->largest_load));
}

/* Where in `doubt` what is not known of a joint stands, the mass, and the first zero. */
enum { SHARE, ROUGH, REST, LATER, EACH, MASS = EACH * JAW, ZERO, NEEDS = EACH + 1 + LIFTING };

static void doubt_anew(Trim *t, int from, int to) {
    for (int r = from; r < to; r++)
        for (int c = 0; c < UNKNOWN; c++) t->doubt[r][c] = t->doubt[c][r] = 0.0;
}

/* Forget what was learnt of servo i, which was replaced, and how late all come. */
void so101_trim_forget(Trim *t, int i) {
    t->weaker[i] = t->rougher[i] = 0.0;
    if (i >= JAW) return;
    const double unknown = t->servo[i]->is_known != 0.0 ? KNOWN : 1.0;
    const double sd[] = {unknown * WEAKER, unknown * ROUGHER, OTHERWISE};
    doubt_anew(t, EACH * i, EACH * (i + 1));
    for (int k = 0; k < LATER; k++) t->doubt[EACH * i + k][EACH * i + k] = sd[k] * sd[k];
    if (0 < i && i <= LIFTING) {
        const int at = ZERO + i - 1;
        t->zero[i] = 0.0;
        doubt_anew(t, at, at + 1);
        t->doubt[at][at] = OFF_ZERO * OFF_ZERO;
    }
    for (int j = 0; j < JAW; j++) {
        doubt_anew(t, EACH * j + LATER, EACH * (j + 1));
        t->later[j] = t->later_seen[j] = t->later_felt[j] = 0.0;
    }
    for (int j = 0; j < JAW; j++)
        for (int k = 0; k < JAW; k++)
            t->doubt[EACH * j + LATER][EACH * k + LATER] =
                COMES_LATER * COMES_LATER + (j == k ? ITS_OWN * ITS_OWN : 0.0);
}

/* `own`: torques that hold the pose; `per_kg`: what each kilogram carried adds. */
static void take_up(Trim *t, const double *goal, const double *own, const double *per_kg, double now) {
    t->since = now, t->has_goal = 1.0;
    for (int i = 0; i < SERVOS; i++) {
        t->goal[i] = goal[i], t->arrived[i] = 0.0, t->pace[i] = 1.0, t->side[i] = 0.0, t->per_kg[i] = per_kg[i];
        t->weights[i] = own[i] + t->carried * per_kg[i];
    }
}

void so101_trim_start(Trim *t, const double *goal, const double *sag, const double *own, const double *per_kg,
                      double now) {
    t->carried = 0.0;
    for (int i = 0; i < SERVOS; i++) t->gives_way[i] = t->qd[i] = t->unfelt[i] = 0.0;
    for (int i = 0; i < JAW; i++) {
        const int at = EACH * i + REST;
        doubt_anew(t, at, at + 1);
        t->doubt[at][at] = OTHERWISE * OTHERWISE;
    }
    doubt_anew(t, MASS, MASS + 1);
    t->doubt[MASS][MASS] = CARRIED * CARRIED;
    take_up(t, goal, own, per_kg, now);
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
        t->pace[i] = BEGINS;
        t->ways[i] = t->rest[i] = t->weight_rate[i] = 0.0;
        find(t, i);
        if (isnan(sag[i])) continue;
        const double off = limited(sag[i], so101_servo_error_for(s, s->largest_load));
        const double friction = so101_servo_friction(s, t->weights[i], 0.0, 0.0);
        t->ways[i] = limited((off - t->known[i]) * so101_servo_stiffness(s) / friction, 1.0);
        for (int k = 0; k < 3; k++) { /* friction grows with what is not known of the load */
            find(t, i);
            t->rest[i] = off - t->known[i];
        }
    }
}

void so101_trim_command(Trim *t, const double *goal, const double *qd, const double *way, const double *own,
                        const double *per_kg, double now) {
    const double dt = now - t->since;
    double before[JAW];
    for (int i = 0; i < JAW; i++) {
        before[i] = t->weights[i];
        const double step = t->has_goal != 0.0 ? goal[i] - t->goal[i] : 0.0;
        t->ways[i] = isnan(way[i]) ? limited(t->ways[i] + step / t->engaging, 1.0) : way[i];
        if (step != 0.0) t->gives_way[i] = 0.0;
    }
    take_up(t, goal, own, per_kg, now);
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
        const double side = t->ways[i] * copysign(1.0, t->weights[i]); /* friction grows with the weight, too */
        const double grows = (1.0 + t->weaker[i]) * (1.0 + side * (s->load_external + s->load_motor));
        t->weight_rate[i] = 0.0 < dt && dt < RECENT ? grows * (t->weights[i] - before[i]) / so101_servo_stiffness(s) / dt : 0.0;
        t->qd[i] = qd[i];
        find(t, i);
    }
}

void so101_trim_give_way(Trim *t, int i) {
    t->gives_way[i] = 1.0, t->ways[i] = 0.0;
    find(t, i);
}

/* How much more torque joint i needs for each of what is not known of it, and where in `doubt` that stands. */
typedef struct { double by[NEEDS]; int at[NEEDS]; } Need;

static Need need(const Trim *t, int i) {
    const Servo *s = t->servo[i];
    const double weaker = 1.0 + t->weaker[i], way = t->ways[i], stiff = so101_servo_stiffness(s);
    const double friction = so101_servo_friction(s, t->weights[i] + t->rest[i] * stiff, way, t->qd[i]);
    const double grows = 1.0 + way * copysign(s->load_external + s->load_motor, t->weights[i]);
    const int at = EACH * i;
    Need n = {{t->torque[i] / weaker, way * friction * weaker, 1.0, t->qd[i] * stiff, t->per_kg[i] * weaker * grows},
              {at + SHARE, at + ROUGH, at + REST, at + LATER, MASS}};
    for (int j = 0; j < LIFTING; j++)
        n.by[EACH + 1 + j] = t->by_angle[j][i] * weaker * grows, n.at[EACH + 1 + j] = ZERO + j;
    return n;
}

/* What all that is not known has to do with what joint i needs; returns that need's variance. */
static double related(const Trim *t, const Need *n, double *k) {
    double variance = 0.0;
    for (int r = 0; r < UNKNOWN; r++) {
        k[r] = 0.0;
        for (int c = 0; c < NEEDS; c++) k[r] += t->doubt[r][n->at[c]] * n->by[c];
    }
    for (int c = 0; c < NEEDS; c++) variance += n->by[c] * k[n->at[c]];
    return variance;
}

/* Change what is known by `change`. The joints `stay` do not move for it: friction bears what it can. */
static void take(Trim *t, const double *change, uint32_t stay) {
    const double before = t->carried;
    double turned[LIFTING];
    t->carried = limited(before + change[MASS], t->heaviest);
    for (int j = 0; j < LIFTING; j++) {
        turned[j] = -t->zero[1 + j];
        t->zero[1 + j] = limited(t->zero[1 + j] + change[ZERO + j], MOST_OFF_ZERO);
        turned[j] += t->zero[1 + j];
    }
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
        const double stiff = so101_servo_stiffness(s), bound = so101_servo_error_for(s, t->largest_drive);
        const double *own = change + EACH * i, rest = t->rest[i], was = t->known[i] + rest;
        t->weights[i] += (t->carried - before) * t->per_kg[i];
        for (int j = 0; j < LIFTING; j++) t->weights[i] += turned[j] * t->by_angle[j][i];
        t->weaker[i] = limited(t->weaker[i] + own[SHARE], MOST_SHARE);
        t->rougher[i] = limited(t->rougher[i] + own[ROUGH], MOST_SHARE);
        t->later_seen[i] = limited(t->later_seen[i] + own[LATER], LATEST);
        /* One that began beyond its bound may only come back. */
        t->rest[i] = least(most(rest + own[REST] / stiff, least(rest, -bound)), most(rest, bound));
        find(t, i);
        if (holds(stay, i)) {
            const double friction = so101_servo_friction(s, t->weights[i], t->ways[i], 0.0);
            if (t->gives_way[i] == 0.0)
                t->ways[i] = limited(t->ways[i] - (t->known[i] + t->rest[i] - was) * stiff / friction, 1.0);
            find(t, i);
        }
        t->unfelt[i] += (t->known[i] + t->rest[i] - was) * stiff;
    }
}

/* Increase the offsets of resting joints by `steps` [rad], as their reasons are likely. */
static void learn(Trim *t, const double *steps) {
    double was[JAW], k[UNKNOWN];
    uint32_t stay = 0;
    for (int i = 0; i < JAW; i++) was[i] = t->known[i] + t->rest[i], stay |= (uint32_t)(steps[i] == 0.0) << i;
    for (int i = 0; i < JAW; i++) {
        if (steps[i] == 0.0) continue;
        Need n = need(t, i);
        double change[UNKNOWN] = {0};
        n.by[LATER] = 0.0;
        related(t, &n, k);
        double all = 0.0;
        for (int c = 0; c < NEEDS; c++) all += n.by[c] * k[n.at[c]];
        /* A mass that another joint felt has moved it already. */
        const double left = (steps[i] + was[i] - t->known[i] - t->rest[i]) * so101_servo_stiffness(t->servo[i]);
        for (int c = 0; c < NEEDS; c++)
            if (c != LATER) change[n.at[c]] = left * k[n.at[c]] / all;
        take(t, change, stay);
    }
}

static void learn_moving(Trim *t, const double *q, uint32_t fresh, double dt, double now) {
    if (!fresh) t->missed = now;
    const int is_planned = t->is_planned != 0.0, is_sure = now - t->missed > CATCHES_UP;
    const double felt = least(dt / FELT_AFTER, 1.0);
    double change[UNKNOWN] = {0}, k[UNKNOWN];
    t->doubt[MASS][MASS] += DRIFTS_CARRIED * DRIFTS_CARRIED * dt;
    for (int j = 0; j < LIFTING; j++) t->doubt[ZERO + j][ZERO + j] += DRIFTS_OFF_ZERO * DRIFTS_OFF_ZERO * dt;
    for (int i = 0; i < JAW; i++) {
        const int at = EACH * i;
        t->doubt[at + SHARE][at + SHARE] += DRIFTS * DRIFTS * dt;
        t->doubt[at + ROUGH][at + ROUGH] += DRIFTS * DRIFTS * dt;
        t->doubt[at + REST][at + REST] += DRIFTS_OTHERWISE * DRIFTS_OTHERWISE * dt;
        for (int j = 0; j < JAW; j++) t->doubt[at + LATER][EACH * j + LATER] += DRIFTS_LATER * DRIFTS_LATER * dt;
        t->unfelt[i] -= felt * t->unfelt[i];
    }
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
        const double error = t->goal[i] - t->lags[i] - q[i], qd = t->qd[i];
        if (!holds(fresh, i) || !(fabs(error) < MOVING_ERROR) || qd == 0.0) continue;
        const double demand = so101_servo_distance(s, t->torque[i], qd) + t->rest[i] + error;
        /* It can do no more; what was learnt then would throw it past its goal. */
        if (demand * error > 0.0 && so101_servo_drive(s, demand) >= s->most_drive) continue;
        Need n = need(t, i);
        if (!is_planned || !is_sure) n.by[LATER] = 0.0;
        const double unclear = UNCLEAR * n.by[ROUGH] * exp(-fabs(qd) / CLEARS);
        const double bears = is_planned ? 1.0 : least(fabs(t->weights[i]) / BEARING, 1.0);
        if (bears == 0.0) continue;
        const double noise = (NOISE * NOISE + unclear * unclear) / (bears * bears) * LASTS / dt;
        double variance = related(t, &n, k) + noise;
        double left = (error - (t->later_seen[i] - t->later_felt[i]) * qd) * so101_servo_stiffness(s) - t->unfelt[i];
        for (int c = 0; c < NEEDS; c++) left -= n.by[c] * change[n.at[c]];
        for (int r = 0; r < UNKNOWN; r++) {
            change[r] += k[r] * left / variance;
            for (int c = 0; c < UNKNOWN; c++) t->doubt[r][c] -= k[r] * k[c] / variance;
        }
    }
    take(t, change, 0);
    for (int i = 0; i < JAW; i++) {
        const int at = EACH * i + LATER;
        const double off = t->later_seen[i] - t->later[i], sure = fabs(off) - SURE * sqrt(t->doubt[at][at]);
        const double may = off < 0.0 ? QUICKLY : least(QUICKLY, GENTLY + t->room);
        const double rate = most(GENTLY, least(may, EAGER * sure));
        t->hurry[i] = ANSWERS * copysign(rate - GENTLY, off);
        t->later[i] += limited(off, rate * dt);
        t->later_felt[i] += felt * (t->later[i] - t->later_felt[i]);
    }
}

/* Turn the friction of joint i over; return what to learn once that is done [rad]. */
static double turn_over(Trim *t, int i, double error, double dt) {
    const Servo *s = t->servo[i];
    const double side = error > 0.0 ? 1.0 : -1.0;
    /* A joint that broke loose and went past its goal is brought back more slowly each time, or it would go to and
     * fro: its friction is less than is taken for likely. */
    if (t->side[i] * side < 0.0) t->pace[i] *= CALMS;
    t->side[i] = side;
    if (t->ways[i] * side >= 1.0) return least(t->pace[i], 1.0) * GAIN * dt * error;
    const double load = t->weights[i] + t->rest[i] * so101_servo_stiffness(s);
    const double speed = least(t->pace[i], 1.0) * TURNING;
    const double turn = speed * dt * so101_servo_stiffness(s) / so101_servo_friction(s, load, side, 0.0);
    t->ways[i] = limited(t->ways[i] + side * turn, 1.0);
    find(t, i);
    return 0.0;
}

void so101_trim_measure(Trim *t, const double *q, const double *qd, uint32_t fresh, double now) {
    const double dt = least(now - t->last, 0.05), still = now - t->since;
    double steps[JAW] = {0};
    t->last = now;
    if (t->has_goal == 0.0) return;
    if (still < STILL) {
        learn_moving(t, q, fresh, dt, now);
        return;
    }
    for (int i = 0; i < JAW; i++) {
        const double error = t->goal[i] - q[i];
        double dead = DEAD_BAND;
        if (still >= LATE) {
            if (fabs(error) <= t->settle_position) t->arrived[i] = 1.0;
            dead = t->arrived[i] != 0.0 ? t->left_alone : t->settle_position;
        }
        const int is_droop = dead < fabs(error) && fabs(error) < so101_servo_error_for(t->servo[i], t->servo[i]->largest_load);
        if (is_droop && t->gives_way[i] == 0.0 && fabs(qd[i]) < AT_REST && holds(fresh, i))
            steps[i] = turn_over(t, i, error, dt);
    }
    learn(t, steps);
}

uint32_t so101_trim_in_play(const Trim *t) {
    uint32_t found = 0;
    for (int i = 0; i < JAW; i++) {
        const double own = t->weights[i] - t->carried * t->per_kg[i], full = own + CARRIES * t->per_kg[i];
        const double unsure = i == 0 || i == 4 ? 0.0 : UNSURE + 0.05 * fabs(own);
        const double low = least(own, full) - unsure, high = most(own, full) + unsure;
        const int is_lifted = -low < WEIGHTLESS && t->ways[i] >= 1.0;
        const int is_lowered = high < WEIGHTLESS && t->ways[i] <= -1.0;
        const int is_kept = most(low, -high) > 0.0 || most(-low, high) < WEIGHTLESS;
        found |= (uint32_t)!(is_lifted || is_lowered || is_kept) << i;
    }
    return found;
}
