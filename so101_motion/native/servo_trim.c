/* Servo models, and offsets against weight and friction; servo_model.py and gravity_compensation.py say why. */
#include "servos.h"

/* An integral gain [1/s]: an error shrinks to a tenth in 0.3 s. Chosen; the servo's own response, its delay
 * included, is twice as fast. */
#define GAIN 8.0
/* The same while the command moves, for joints that bear weight: an unknown load acts on them too. The error
 * of the others is lag, which ends when they rest. Chosen: with 4 a shoulder that follows as hard as it can
 * swings farther past. */
#define GAIN_MOVING 2.0
/* The same for servos whose own figures are known, and the share of it for errors that no mass in the gripper
 * explains: such a servo seldom has another error. Chosen by trial. */
#define GAIN_KNOWN 4.0
#define REST_KNOWN 0.2
#define BEARING 0.3                 /* joints that bear less weight learn less while they move [N m]; chosen */
#define DEG (3.141592653589793 / 180.0)
#define MOVING_ERROR (4.0 * DEG)    /* a moving joint with a larger error is blocked [rad]; chosen */
/* How fast friction is turned over to the other side at rest [rad/s]. Chosen: done in 0.2 s under the arm's
 * weight, and not 4 ticks too far when the joint breaks loose. */
#define TURNING (10.0 * DEG)
#define DEAD_BAND (2.5 * 2.0 * 3.141592653589793 / 4096.0) /* smaller errors are ignored [rad]; chosen */
#define LATE 0.45    /* how long after the last command small errors are still corrected [s]; chosen */
/* Where a kilogram adds this torque [N m], half of an error is taken for carried mass and half for something
 * else; less where it adds less. Chosen by trial: without that, errors near the upright looked like 0.2 kg. */
#define DOUBT 2.0
/* An error of a servo that drives with so much [N m] is half taken for a servo that is weaker than its type; more if
 * it drives more. At most it is weaker by so much. Chosen by trial. */
#define STRONG 0.3
#define WEAKEST 0.3
#define RECENT 0.05         /* rates are known over no more time than this [s] */
/* How much later joints come is looked for in the errors of those faster than this [rad/s]. Other reasons cause
 * errors of about so much [rad], and those of unknown mass; they last about so long [s]. What was found changes
 * with heat and supply, by so much in a second [s]. A changed lead acts after so long [s]. Chosen. */
#define MOVES 0.03
#define OTHERWISE (0.5 * DEG)
#define LASTS 0.1
#define DRIFTS 0.002
#define FELT_AFTER 0.06
#define CATCHES_UP 0.4      /* after a silence of all servos, which may have missed goals [s]; chosen */
#define LATEST 0.07         /* most that joints may come later [s]; chosen, the two types differ by 0.05 */
#define GENTLY 0.03         /* a changed lead makes joints faster than planned by this share at most; chosen */
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
        torque += t->ways[i] * so101_servo_friction(s, load, t->ways[i], t->qd[i]);
    }
    torque *= 1.0 + t->weaker[i];
    t->torque[i] = torque;
    t->without_speed[i] = so101_servo_distance(s, torque, 0.0);
    t->known[i] = limited(t->without_speed[i], so101_servo_error_for(s, s->largest_load));
}

/* `own`: torques that hold the pose; `per_kg`: what each kilogram carried adds. */
static void take_up(Trim *t, const double *goal, const double *own, const double *per_kg, double now) {
    t->since = now, t->has_goal = 1.0;
    for (int i = 0; i < SERVOS; i++) {
        t->goal[i] = goal[i], t->arrived[i] = 0.0, t->per_kg[i] = per_kg[i];
        t->weights[i] = own[i] + t->carried * per_kg[i];
    }
}

void so101_trim_start(Trim *t, const double *goal, const double *sag, const double *own, const double *per_kg,
                      double now) {
    t->carried = 0.0;
    for (int i = 0; i < SERVOS; i++) t->gives_way[i] = t->qd[i] = 0.0;
    take_up(t, goal, own, per_kg, now);
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
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

/* Increase the offsets by `steps` [rad]: as carried mass first, then joint by joint. */
static void learn(Trim *t, const double *steps, int moving) {
    double heaviness = 0.0, more = 0.0;
    int any = 0;
    for (int i = 0; i < JAW; i++) {
        any |= steps[i] != 0.0;
        heaviness += t->per_kg[i] * t->per_kg[i];
        more += t->per_kg[i] * (steps[i] * so101_servo_stiffness(t->servo[i]));
    }
    if (!any) return;
    const double before = t->carried;
    t->carried = limited(before + more / (heaviness + DOUBT * DOUBT), t->heaviest);
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
        const double change = (t->carried - before) * t->per_kg[i], rest = t->rest[i];
        const double bound = so101_servo_error_for(s, t->largest_drive);
        t->weights[i] += change;
        const double stiff = so101_servo_stiffness(s);
        double step = (steps[i] - change / stiff) * (moving && s->is_known != 0.0 ? REST_KNOWN : 1.0);
        if (s->is_known == 0.0 && t->torque[i] != 0.0) {
            const double torque = t->torque[i] / (1.0 + t->weaker[i]), was = t->weaker[i];
            const double share = torque / (torque * torque + STRONG * STRONG);
            t->weaker[i] = limited(was + share * step * stiff, WEAKEST);
            step -= (t->weaker[i] - was) * torque / stiff;
        }
        /* One that began beyond its bound may only come back. */
        t->rest[i] = least(most(rest + step, least(rest, -bound)), most(rest, bound));
        find(t, i);
    }
}

static void learn_moving(Trim *t, const double *q, uint32_t fresh, double dt, double now) {
    if (!fresh) t->missed = now;
    const int follows_plan = t->is_planned != 0.0 && now - t->missed > CATCHES_UP;
    double steps[JAW] = {0}, seen = 0.0, later = 0.0;
    for (int i = 0; i < JAW; i++) {
        const Servo *s = t->servo[i];
        const double error = t->goal[i] - t->lags[i] - q[i], qd = t->qd[i];
        if (!holds(fresh, i) || !(fabs(error) < MOVING_ERROR)) continue;
        const double demand = so101_servo_distance(s, t->torque[i], qd) + t->rest[i] + error;
        /* It can do no more; what was learnt then would throw it past its goal. */
        if (demand * error > 0.0 && so101_servo_drive(s, demand) >= s->most_drive) continue;
        if (follows_plan && fabs(qd) > MOVES) {
            const double load = CARRIES * t->per_kg[i] / so101_servo_stiffness(s);
            const double weight = dt / LASTS / (OTHERWISE * OTHERWISE + load * load);
            seen += weight * qd * qd, later += weight * qd * (error + (t->later_felt - t->later_seen) * qd);
        }
        if (fabs(error) <= DEAD_BAND) continue;
        const double bears = least(fabs(t->weights[i]) / BEARING, 1.0);
        steps[i] = bears * (s->is_known != 0.0 ? GAIN_KNOWN : GAIN_MOVING) * dt * error;
    }
    learn(t, steps, 1);
    t->doubt = 1.0 / (1.0 / (t->doubt + DRIFTS * DRIFTS * dt) + seen);
    t->later_seen = limited(t->later_seen + t->doubt * later, LATEST);
    t->later += limited(t->later_seen - t->later, GENTLY * dt);
    t->later_felt += (t->later - t->later_felt) * least(dt / FELT_AFTER, 1.0);
}

/* Turn the friction of joint i over; return what to learn once that is done [rad]. */
static double turn_over(Trim *t, int i, double error, double dt) {
    const Servo *s = t->servo[i];
    const double side = error > 0.0 ? 1.0 : -1.0;
    if (t->ways[i] * side >= 1.0) return GAIN * dt * error;
    const double load = t->weights[i] + t->rest[i] * so101_servo_stiffness(s);
    const double turn = TURNING * dt * so101_servo_stiffness(s) / so101_servo_friction(s, load, side, 0.0);
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
    learn(t, steps, 0);
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
