/* What the driver computes in each cycle; drivers/feetech/ and drivers/goal_limiter.py say how and why.
 *
 * Six joints, the jaw last. A number that is not known is NaN, a set of joints has a bit for each. */
#ifndef SO101_SERVOS_H
#define SO101_SERVOS_H

#include <math.h>
#include <stdint.h>

#define SERVOS 6
#define JAW 5
#define LIMP (-(1 << 20)) /* as in goal_compensation.py; a goal outside a joint's limits may be negative */

/* One servo, as ServoModel in servo_model.py. */
typedef struct {
    double torque_per_volt, back_emf, armature, viscous, coulomb, load_external, load_motor, still_external;
    double still_motor, stribeck_speed, goal_delay, loop_delay, over_shape, play, start_duty, dead_zone;
    double braking, full_drive_error, volts, most_drive, largest_load, is_known;
} Servo;

/* The bodies that six joints move, as ArmWeight in arm_weight.py: each joint's placement in the one before
 * (rotation by rows, then position; it turns about its z), its body's mass and centre. */
typedef struct {
    double up[3], load[3]; /* minus gravity, in the base; where a load sits on the last link of the arm */
    struct { double R[9], p[3], mass, centre[3]; } body[SERVOS];
} Weight;

#define LIFTING 3  /* joints that lift, from the second on */
#define UNKNOWN 24 /* four of each joint of the arm, a mass, and where the joints that lift have zero; servo_trim.c */

/* As Trim in gravity_compensation.py. */
typedef struct {
    double engaging, heaviest, largest_drive, settle_position, left_alone; /* constants of that file */
    double carried, since, last, has_goal;
    double lags[SERVOS], per_kg[SERVOS], weights[SERVOS], ways[SERVOS], torque[SERVOS];
    double without_speed[SERVOS], known[SERVOS], rest[SERVOS], goal[SERVOS], qd[SERVOS];
    double hurry[SERVOS], arrived[SERVOS], gives_way[SERVOS], weight_rate[SERVOS];
    double weaker[SERVOS], rougher[SERVOS], later[SERVOS], later_seen[SERVOS], later_felt[SERVOS], unfelt[SERVOS];
    double pace[SERVOS], side[SERVOS];
    double is_planned, room, missed, zero[SERVOS], by_angle[LIFTING][JAW], doubt[UNKNOWN][UNKNOWN];
    const Servo *servo[SERVOS];
    const Weight *arm; /* 0 if its torques are given */
} Trim;

/* As GoalLimiter in goal_limiter.py. */
typedef struct {
    double speed, acceleration, slack, catch_up, pause, offset_speed, lead_speed, seed; /* constants */
    double t, t_before, t_goal, spare, begins;
    double q[SERVOS], qd[SERVOS], goal[SERVOS], offset[SERVOS], lead[SERVOS], kept[SERVOS];
    double step, elapsed, allowed, before, asked; /* of a command that was refused */
} Limiter;

/* As GoalCompensation in goal_compensation.py. */
typedef struct {
    double delay, ahead, largest_offset, compensates; /* constants, and the joints' maps */
    double direction[SERVOS], zero_ticks[SERVOS], lower_ticks[SERVOS], upper_ticks[SERVOS];
    double t_begin, t_point, t_goals, has_qd, is_told, follows_target;
    double qd[JAW], qdd[JAW], side[JAW], crossing[JAW];
    double foreseen[SERVOS], setpoint_qd[SERVOS], lags[SERVOS];
    Trim *trim;
    Limiter *limiter;
    int servo[SERVOS], held[SERVOS]; /* its id, 0 if there is none; its goal [tick], or LIMP */
} Goals;

/* As KnownPosition in position_check.py. */
typedef struct {
    double scatter, fastest, push, close, enough; /* constants of that file */
    double is_there, is_sure, t, ticks, v, sure_t, last, last_t, last_v, count;
} Position;

#define ROWS 32 /* more than are kept of a tenth of a second */

/* As JointEstimate in joint_estimate.py. */
typedef struct {
    double window, direction[SERVOS], zero_ticks[SERVOS], seam[SERVOS]; /* a constant, and the joints' maps */
    double q[SERVOS], qd[SERVOS], sure[SERVOS], seen[SERVOS], seen_wanted[SERVOS];
    double rows, time[ROWS], row[ROWS][SERVOS];
    Position known[SERVOS];
    int servo[SERVOS], ticks[SERVOS]; /* its id; where each servo that has answered stands */
    uint32_t fresh, unsure;           /* which have answered, credibly; which have a servo and are not sure */
} Estimate;

/* As Answers in protocol.py. */
typedef struct {
    int count, skip, servos, found, skipped, rest;
    int faults, is_over; /* of all that have answered; whether the last one has */
    int at[256]; /* by servo: where its data begin among the bytes received; 0: nowhere, -1: not asked */
    uint8_t servo[256];
} Answers;

/* Of two numbers, as Python has it. */
static inline double least(double a, double b) { return b < a ? b : a; }
static inline double most(double a, double b) { return b > a ? b : a; }
static inline double limited(double value, double bound) {
    return value > bound ? bound : value < -bound ? -bound : value;
}
static inline double within_change(double wanted, double before, double change) {
    return wanted > before + change ? before + change : wanted < before - change ? before - change : wanted;
}
static inline int holds(uint32_t joints, int i) { return joints >> i & 1; }

double so101_servo_stiffness(const Servo *s); /* approximately what the goal adds for each radian [N m/rad] */
double so101_servo_error_for(const Servo *s, double torque);
double so101_servo_lag(const Servo *s);
double so101_servo_drive(const Servo *s, double distance);
double so101_servo_distance(const Servo *s, double torque, double speed);
double so101_servo_friction(const Servo *s, double load, double way, double speed);
double so101_servo_stray(const Servo *s, double speed);
void so101_weigh(const Weight *w, const double *q, double *own, double *per_kg);
void so101_trim_command(Trim *t, const double *goal, const double *qd, const double *way, const double *own,
                        const double *per_kg, double now);
void so101_trim_give_way(Trim *t, int i);
uint32_t so101_trim_in_play(const Trim *t);
int so101_limiter_follow(Limiter *l, const double *q, const double *qd, const double *here, uint32_t free,
                         double now);
void so101_trim_measure(Trim *t, const double *q, const double *qd, uint32_t fresh, double now);
int so101_sync_write_words(uint8_t *packet, int address, const int *servo, const int *word, int n);
void so101_limiter_goals(Limiter *l, const double *offset, const double *largest, const double *lead,
                         double now);
#endif
