/* One step of a jog; servo.py says how and why. */
#include <math.h>
#include <string.h>

#include "native.h"

#define N ARM_JOINTS
#define ROWS 8 /* as in servo_qp.py */

enum { POSE, POINT, TWIST };

/* As Jog in servo.py. */
typedef struct {
    double damping, closing, ease, lost, pull, slack[2], braking, far[2], spared, same, gap; /* constants */
    double dt, acceleration[N], velocity[N], lower[N], upper[N];
    double placement[12]; /* of the frame on the last joint of the arm: rotation by rows, translation */
    double kind, in_tool, target[12], goes_on; /* the target; whether it is the twist of the last step */
    double R[9], p[3];                         /* where that twist has led the frame */
    double q[N], qd[N], time;                  /* the unfiltered reference, and how long it brakes */
    double before[N], at[N], at_qd[N], at_qdd[N]; /* the last two setpoints */
    double J[6][N], wanted[N], is_damped, brake[N]; /* the task velocity, and that of braking */
    double low[N], high[N], G[ROWS][N], b[ROWS];    /* bounds of the velocity */
    double chosen[N], share;                        /* the velocity, and its share of the task's */
    double *trail, *passed, *path; /* what is averaged, oldest first; room for the two functions below */
    int steps, room, every, count, near[ROWS]; /* near: the rows that the bounds are of */
} Jog;

static double dot(const double *a, const double *b, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

static double length(const double *v) { return sqrt(dot(v, v, 3)); }

static double within(double x, double low, double high) { return fmin(fmax(x, low), high); }

/* Shortens a vector to `longest`; whether it was longer. */
static int cut(double *v, double longest) {
    const double is = length(v);
    for (int i = 0; i < 3 && is > longest; i++) v[i] *= longest / is;
    return is > longest;
}

static void times(const double *A, const double *B, double *to) {
    for (int k = 0; k < 9; k++) {
        const double *row = A + k / 3 * 3;
        to[k] = row[0] * B[k % 3] + row[1] * B[3 + k % 3] + row[2] * B[6 + k % 3];
    }
}

/* A times the transpose of B. */
static void beside(const double *A, const double *B, double *to) {
    for (int k = 0; k < 9; k++) to[k] = dot(A + k / 3 * 3, B + k % 3 * 3, 3);
}

/* As rotation_vector in geometry.py. */
static void vector_of(const double *R, double *v) {
    const double s[3] = {0.5 * (R[7] - R[5]), 0.5 * (R[2] - R[6]), 0.5 * (R[3] - R[1])};
    const double sine = length(s), angle = atan2(sine, 0.5 * (R[0] + R[4] + R[8] - 1.0));
    if (sine > 1e-6 || angle < 1.0) {
        for (int i = 0; i < 3; i++) v[i] = s[i] * (sine > 1e-6 ? angle / sine : 1.0);
        return;
    }
    const int k = R[4] > R[0] ? (R[8] > R[4] ? 2 : 1) : (R[8] > R[0] ? 2 : 0);
    for (int i = 0; i < 3; i++) v[i] = R[3 * i + k] + (i == k);
    const double is = length(v);
    for (int i = 0; i < 3; i++) v[i] *= angle / is;
}

/* Turns R by a rotation vector, as rotation_by in geometry.py. */
static void turn_by(const double *v, double *R) {
    const double angle = length(v), turn[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0};
    const double half = angle < 1e-9 ? 0.0 : sin(0.5 * angle) / (0.5 * angle);
    double by[9], twice[9], now[9];
    times(turn, turn, twice);
    for (int k = 0; k < 9; k++)
        by[k] = (k % 4 == 0) + (angle < 1e-9 ? 1.0 : sin(angle) / angle) * turn[k] + 0.5 * half * half * twice[k];
    times(by, R, now);
    memcpy(R, now, sizeof now);
}

/* Where the frame is, and its Jacobian. */
static void place(Jog *j, const Scene *s, double *R, double *p) {
    Pose pose[JOINTS + 1];
    double q[JOINTS] = {0};
    memcpy(q, j->q, sizeof j->q);
    so101_poses(s, q, 0, pose);
    const Pose *hand = &pose[N];
    times(hand->R, j->placement, R);
    for (int i = 0; i < 3; i++) p[i] = hand->p[i] + dot(hand->R + 3 * i, j->placement + 9, 3);
    for (int k = 0; k < N; k++) {
        const double *T = pose[k + 1].R, *at = pose[k + 1].p, z[3] = {T[2], T[5], T[8]};
        const double r[3] = {p[0] - at[0], p[1] - at[1], p[2] - at[2]};
        for (int i = 0; i < 3; i++) {
            j->J[i][k] = z[(i + 1) % 3] * r[(i + 2) % 3] - z[(i + 2) % 3] * r[(i + 1) % 3];
            j->J[3 + i][k] = z[i];
        }
    }
}

/* Completes `n` orthonormal rows to N of them. */
static void complete(double V[N][N], int n) {
    for (; n < N; n++) {
        double best = -1.0;
        for (int axis = 0; axis < N; axis++) {
            double v[N] = {0};
            v[axis] = 1.0;
            for (int twice = 0; twice < 2; twice++)
                for (int k = 0; k < n; k++) {
                    const double along = dot(v, V[k], N);
                    for (int i = 0; i < N; i++) v[i] -= along * V[k][i];
                }
            const double is = sqrt(dot(v, v, N));
            if (!(is > best)) continue;
            best = is;
            for (int i = 0; i < N; i++) V[n][i] = v[i] / is;
        }
    }
}

/* The singular values of three rows, the largest first; U has the left vectors as columns, the rows of V are
 * the right ones, and two more that the rows leave alone. By Jacobi's rotations of the rows, which find small
 * values exactly (J. Demmel and K. Veselic, 1992). */
static void decompose(const double J[3][N], double U[3][3], double *gain, double V[N][N]) {
    double A[3][N], W[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    memcpy(A, J, sizeof A);
    for (int sweep = 0, turned = 1; sweep < 30 && turned; sweep++) {
        turned = 0;
        for (int a = 0; a < 2; a++)
            for (int b = a + 1; b < 3; b++) {
                const double aa = dot(A[a], A[a], N), bb = dot(A[b], A[b], N), ab = dot(A[a], A[b], N);
                if (!(fabs(ab) > 4e-15 * sqrt(aa * bb))) continue;
                const double zeta = (bb - aa) / (2.0 * ab);
                const double t = (zeta < 0.0 ? -1.0 : 1.0) / (fabs(zeta) + sqrt(1.0 + zeta * zeta));
                const double c = 1.0 / sqrt(1.0 + t * t), s = c * t;
                turned = 1;
                for (int i = 0; i < N; i++) {
                    const double x = A[a][i], y = A[b][i];
                    A[a][i] = c * x - s * y, A[b][i] = s * x + c * y;
                }
                for (int i = 0; i < 3; i++) {
                    const double x = W[a][i], y = W[b][i];
                    W[a][i] = c * x - s * y, W[b][i] = s * x + c * y;
                }
            }
    }
    int order[3] = {0, 1, 2}, known = 3;
    double size[3];
    for (int a = 0; a < 3; a++) size[a] = sqrt(dot(A[a], A[a], N));
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2 - a; b++)
            if (size[order[b]] < size[order[b + 1]]) {
                const int other = order[b];
                order[b] = order[b + 1], order[b + 1] = other;
            }
    for (int k = 0; k < 3; k++) {
        const int from = order[k];
        gain[k] = size[from];
        for (int i = 0; i < 3; i++) U[i][k] = W[from][i];
        if (!(gain[k] > 1e-300) && k < known) known = k;
        for (int i = 0; i < N && k < known; i++) V[k][i] = A[from][i] / gain[k];
    }
    complete(V, known);
}

/* Joint velocities for a rate of the frame, and whether damping takes much of its speed. */
static int least_squares(const Jog *j, const double J[6][N], const double *linear, const double *angular,
                         double damping, double *qd) {
    double U[3][3], gain[3], V[N][N], softened[3], along[3], lost[3], y[2] = {0}, turning[3][2];
    decompose(J, U, gain, V);
    memset(qd, 0, N * sizeof *qd);
    for (int k = 0; k < 3; k++) {
        softened[k] = gain[k] + damping * damping / (gain[k] + 1e-9);
        along[k] = U[0][k] * linear[0] + U[1][k] * linear[1] + U[2][k] * linear[2];
        lost[k] = along[k] * (1.0 - gain[k] / softened[k]);
        for (int i = 0; i < N; i++) qd[i] += along[k] / softened[k] * V[k][i];
    }
    /* Far from singular configurations, damping takes nothing worth reporting. */
    const int is_lost = softened[2] * (1.0 - j->lost) > gain[2] && length(lost) > j->lost * length(linear);
    if (!angular) return is_lost;
    double a = j->ease * j->ease, b = 0.0, c = a;
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 2; k++) turning[i][k] = dot(J[3 + i], V[3 + k], N);
        const double left = angular[i] - dot(J[3 + i], qd, N);
        for (int k = 0; k < 2; k++) y[k] += turning[i][k] * left;
        a += turning[i][0] * turning[i][0], b += turning[i][0] * turning[i][1];
        c += turning[i][1] * turning[i][1];
    }
    const double scale = 1.0 / (a * c - b * b);
    for (int i = 0; i < N; i++)
        qd[i] += (c * y[0] - b * y[1]) * scale * V[3][i] + (a * y[1] - b * y[0]) * scale * V[4][i];
    return is_lost;
}

/* A twist in the axes of the base, for a frame turned as R. */
static void rate_of(const Jog *j, const double *R, double *rate) {
    memcpy(rate, j->target, 6 * sizeof *rate);
    for (int i = 0; i < 6 && j->in_tool; i++) rate[i] = dot(R + i % 3 * 3, j->target + i / 3 * 3, 3);
}

/* Follows the twist, and the reference that it has led. */
static void follow(Jog *j, const double *R, const double *p) {
    double rate[6], ahead[3], turn[3], off[9];
    if (!j->goes_on) memcpy(j->R, R, sizeof j->R), memcpy(j->p, p, sizeof j->p);
    j->goes_on = 1.0;
    rate_of(j, R, rate);
    int is_still = 1;
    for (int i = 0; i < 6; i++) is_still &= rate[i] == 0.0;
    if (is_still) return;
    for (int i = 0; i < 3; i++) ahead[i] = j->p[i] - p[i];
    beside(j->R, R, off);
    vector_of(off, turn);
    if (cut(ahead, j->slack[0]))
        for (int i = 0; i < 3; i++) j->p[i] = p[i] + ahead[i];
    if (cut(turn, j->slack[1])) memcpy(j->R, R, sizeof j->R), turn_by(turn, j->R);
    for (int i = 0; i < 3; i++) rate[i] += j->pull * ahead[i], rate[3 + i] += j->pull * turn[i];
    j->is_damped = least_squares(j, j->J, rate, rate + 3, j->damping, j->wanted);
}

/* Joint velocities along `dq` [rad] that can come to rest at its end. */
static void approach(Jog *j, const double *dq) {
    double share = INFINITY;
    for (int i = 0; i < N; i++) {
        const double distance = fabs(dq[i]), bend = j->braking * j->acceleration[i];
        /* In steps of dt, from this speed on, the joint stops within its path. */
        const double brakes = bend * (sqrt(j->dt * j->dt + 2.0 * distance / bend) - j->dt);
        if (distance > j->same) share = fmin(share, fmin(brakes, j->velocity[i]) / distance);
    }
    for (int i = 0; i < N && share < INFINITY; i++) j->wanted[i] = dq[i] * share;
}

/* Goes to a pose or a point. */
static void go(Jog *j, const double *R, const double *p) {
    double off[9], turn[3], way[3], dq[N], J[6][N], rest[N], ease[N];
    const double *angular = j->kind == POSE ? turn : 0;
    j->goes_on = 0.0;
    if (angular) beside(j->target, R, off), vector_of(off, turn), cut(turn, j->far[1]);
    for (int i = 0; i < 3; i++) way[i] = j->target[9 + i] - p[i];
    cut(way, j->far[0]);
    const double damping = j->closing * length(way);
    least_squares(j, j->J, way, angular, damping, dq);
    /* The other joints take over from a joint near its limit, if they can. */
    int is_eased = 0;
    for (int i = 0; i < N; i++) {
        rest[i] = j->q[i] + 0.5 * j->time * j->qd[i];
        const double left = dq[i] > 0.0 ? j->upper[i] - rest[i] : rest[i] - j->lower[i];
        ease[i] = within(left / j->spared, 1e-3, 1.0);
        is_eased |= ease[i] < 1.0;
    }
    if (is_eased) {
        for (int k = 0; k < 6 * N; k++) J[k / N][k % N] = j->J[k / N][k % N] * ease[k % N];
        least_squares(j, J, way, angular, damping, dq);
        for (int i = 0; i < N; i++) dq[i] *= ease[i];
    }
    approach(j, dq);
}

/* Computes the task velocity and that of braking; whether there is any task. */
int so101_jog_want(Jog *j, const Scene *s) {
    double R[9], p[3];
    const double slower = j->time > 0.0 ? fmax(0.0, 1.0 - j->dt / j->time) : 1.0;
    int is_wanted = 0;
    place(j, s, R, p);
    memset(j->wanted, 0, sizeof j->wanted);
    j->is_damped = 0.0;
    if (j->kind == TWIST) follow(j, R, p);
    else go(j, R, p);
    for (int i = 0; i < N; i++) {
        j->brake[i] = j->chosen[i] = j->qd[i] * slower;
        is_wanted |= j->wanted[i] != 0.0;
    }
    j->share = 1.0;
    return is_wanted;
}

/* Takes the bounds with the least room, in order, or all of few that are given in order. */
static void take_bounds(Jog *j, const double *bound, int n, int in_order) {
    j->count = 0;
    for (int k = 0; k < n; k++) {
        const double room = bound[BOUND * k + N + 1];
        int at = j->count < ROWS ? j->count++ : ROWS;
        for (; at > 0 && !in_order && bound[BOUND * j->near[at - 1] + N + 1] > room; at--)
            if (at < ROWS) j->near[at] = j->near[at - 1];
        if (at < ROWS) j->near[at] = k;
    }
    for (int k = 0; k < j->count; k++) {
        const double *row = bound + BOUND * j->near[k];
        memcpy(j->G[k], row, sizeof j->G[k]);
        j->b[k] = j->gap - row[N + 1];
    }
}

/* Bounds of the velocities that leave enough room to brake, also after this step. */
static void set_room(Jog *j) {
    /* The joints may become a step's worth faster, and would brake as much longer. */
    const double time = 1.5 * j->dt + 0.5 * j->time, left = fmax(0.0, j->time - j->dt);
    int is_late = 0;
    for (int k = 0; k < j->count; k++) {
        const double gain = dot(j->G[k], j->brake, N);
        j->b[k] /= time;
        /* A smaller violation does not endanger the proof. */
        is_late |= j->b[k] - 0.5 * j->gap / time > gain && gain < 0.0;
        j->b[k] = fmin(j->b[k], gain);
    }
    for (int i = 0; i < N; i++) {
        j->low[i] = (j->lower[i] - j->q[i]) / time, j->high[i] = (j->upper[i] - j->q[i]) / time;
        is_late |= j->low[i] > j->brake[i] || j->high[i] < j->brake[i];
    }
    for (int i = 0; i < N; i++) {
        const double change = j->acceleration[i] * j->dt;
        /* Something needs full braking now. The other joints go on if they can brake in time. */
        const double top = is_late ? fmin(j->velocity[i], j->acceleration[i] * left) : j->velocity[i];
        j->low[i] = fmax(fmax(j->qd[i] - change, -top), j->low[i]);
        j->high[i] = fmin(fmin(j->qd[i] + change, top), j->high[i]);
        /* Braking is always among them. */
        j->low[i] = fmin(j->low[i], j->brake[i]), j->high[i] = fmax(j->high[i], j->brake[i]);
    }
}

static int has_room(const Jog *j, const double *qd) {
    for (int i = 0; i < N; i++)
        if (qd[i] < j->low[i] || qd[i] > j->high[i]) return 0;
    for (int k = 0; k < j->count; k++)
        if (dot(j->G[k], qd, N) < j->b[k]) return 0;
    return 1;
}

/* The share of the task velocity that speed and acceleration limits allow now. Its direction is kept; a joint
 * that has to turn round gets no more than from rest. */
static double attainable(const Jog *j) {
    double share = 1.0;
    for (int i = 0; i < N; i++) {
        const double way = (j->wanted[i] > 0.0) - (j->wanted[i] < 0.0), size = fabs(j->wanted[i]);
        const double along = fmax(way * j->qd[i], 0.0) + j->acceleration[i] * j->dt;
        if (size > j->same) share = fmin(share, fmin(along, j->velocity[i]) / size);
    }
    return share;
}

/* Chooses the task velocity, or less of it, if it keeps these bounds (nearest.c) and all others; whether it
 * does. */
int so101_jog_choose(Jog *j, const double *bound, int n, int in_order) {
    take_bounds(j, bound, n, in_order);
    set_room(j);
    memcpy(j->chosen, j->wanted, sizeof j->chosen);
    if (has_room(j, j->chosen)) return 1;
    j->share = attainable(j);
    for (int i = 0; i < N; i++) j->chosen[i] *= j->share;
    return has_room(j, j->chosen);
}

static double time_to_brake(const Jog *j, const double *qd) {
    double time = 0.0;
    for (int i = 0; i < N; i++) time = fmax(time, fabs(qd[i]) / j->acceleration[i]);
    return time;
}

/* Writes the setpoints to come, step by step until they rest, if the unfiltered reference brakes for `time`
 * [s] from q at qd along a straight line, without the first `skip` of its steps. Returns their number, 0 if
 * there is no room for them; `end` is where the reference comes to rest. */
static int setpoints(Jog *j, const double *q, const double *qd, double time, int skip, double *to, double *end) {
    const double count = floor(time / j->dt) + 1.0;
    if (!(count < j->room)) return 0;
    int rows = j->steps, last = (int)count - 1;
    memcpy(j->passed, j->trail, rows * N * sizeof *to);
    for (int k = skip < last ? skip : last; k <= last; k++, rows++) {
        const double lost = time > 0.0 ? 0.5 * j->dt * k * (k + 1.0) / time : k;
        for (int i = 0; i < N; i++) end[i] = j->passed[N * rows + i] = q[i] + j->dt * (k - lost) * qd[i];
    }
    for (int k = 1; k < j->steps; k++, rows++) memcpy(j->passed + N * rows, end, N * sizeof *to);
    /* Relative to the end, so that it is exact when all are the same. */
    for (int k = 0; k < rows; k++)
        for (int i = 0; i < N; i++) {
            const double sum = j->passed[N * k + i] - end[i];
            j->passed[N * k + i] = k ? j->passed[N * (k - 1) + i] + sum : sum;
        }
    for (int k = j->steps; k < rows; k++)
        for (int i = 0; i < N; i++)
            to[N * (k - j->steps) + i] =
                end[i] + (j->passed[N * k + i] - j->passed[N * (k - j->steps) + i]) / j->steps;
    return rows - j->steps;
}

/* The path on which the arm would stop after a step with the chosen velocity. Writes its setpoints from the
 * present one on, and behind them every `every`th of these and the last. Returns how many there are, and in
 * `few` of the others; 0 if it leads out of the joints' range. */
int so101_jog_ahead(Jog *j, int *few) {
    double q[N], end[N], *all = j->path + N;
    for (int i = 0; i < N; i++) q[i] = j->q[i] + j->dt * j->chosen[i];
    const int n = setpoints(j, q, j->chosen, time_to_brake(j, j->chosen), 0, all, end);
    for (int i = 0; i < N && n; i++)
        if (end[i] < j->lower[i] - j->same || end[i] > j->upper[i] + j->same) return 0;
    if (!n) return 0;
    memcpy(j->path, j->at, sizeof j->at);
    double *path = all + N * n;
    memcpy(path, j->at, sizeof j->at);
    *few = 1;
    for (int k = j->every - 1; k < n - 1; k += j->every) memcpy(path + N * (*few)++, all + N * k, sizeof q);
    memcpy(path + N * (*few)++, all + N * (n - 1), sizeof q);
    return n;
}

/* The setpoints if the arm stops now, from the last but one on; returns how many. */
int so101_jog_to_rest(Jog *j) {
    double end[N];
    const int n = setpoints(j, j->q, j->qd, j->time, 1, j->path + 2 * N, end);
    memcpy(j->path, j->before, sizeof end), memcpy(j->path + N, j->at, sizeof end);
    return n + 2;
}

/* Goes on by a step with the chosen velocity. A twist's reference moves on by `share` of it, or starts anew if
 * that is 0. */
void so101_jog_take(Jog *j, double share) {
    const int last = N * (j->steps - 1);
    if (j->kind == TWIST && share > 0.0 && j->goes_on) {
        double rate[6];
        rate_of(j, j->R, rate);
        for (int i = 0; i < 6; i++) rate[i] *= share * j->dt;
        for (int i = 0; i < 3; i++) j->p[i] += rate[i];
        if (rate[3] != 0.0 || rate[4] != 0.0 || rate[5] != 0.0) turn_by(rate + 3, j->R);
    }
    if (!(share > 0.0)) j->goes_on = 0.0;
    memmove(j->trail, j->trail + N, last * sizeof *j->trail);
    j->time = time_to_brake(j, j->chosen);
    for (int i = 0; i < N; i++) {
        j->qd[i] = j->chosen[i];
        j->trail[last + i] = j->q[i] += j->dt * j->chosen[i];
        double sum = 0.0;
        for (int k = 0; k < j->steps; k++) sum += j->trail[N * k + i] - j->q[i];
        const double q = j->q[i] + sum / j->steps, qd = (q - j->at[i]) / j->dt;
        j->before[i] = j->at[i];
        j->at_qdd[i] = (qd - j->at_qd[i]) / j->dt;
        j->at[i] = q, j->at_qd[i] = qd;
    }
}
