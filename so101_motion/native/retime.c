/* Times a path as fast as the limits allow, with bounded jerk, and measures motions: retime.py and
 * verify.py.
 *
 * 1. Speed along the path (TOPP-RA: Pham and Pham, A New Approach to Time-Optimal Path Parameterization
 * Based on Reachability Analysis, 2018). With x the squared speed along the path and u its acceleration,
 * velocity limits cap x; acceleration and torque limits are rows |a u + b x + c| <= 1. The path is cut
 * into intervals of constant u, at every knot among others, and both ends of each must keep the limits: a
 * coarser grid, or one not aligned to the knots, exceeds them in between or stalls. One pass from the end
 * finds the largest x from which the arm can still stop; it needs no lower bound, as the arm ends at rest
 * and u = x = 0 is allowed everywhere. One pass from the start then accelerates as hard as it may below
 * that. On an even interval nothing varies, so the best motion along it is known: full acceleration, top
 * speed, full braking. It is one interval for both passes, and is cut afterwards where these phases meet.
 *
 * 2. Motion in time. Constant u gives time, velocity and acceleration exactly; a quintic connects them.
 *
 * 3. Bounded jerk by a moving average over time (L. Biagiotti, C. Melchiorri, FIR filters for online
 * trajectory planning with time- and frequency-domain specifications, 2012). A step of acceleration of da
 * becomes a ramp of slope da / w. Averaging only mixes values of the motion itself, so no joint goes
 * faster, accelerates harder or leaves its range; the motion leaves the path by at most a w^2 / 24 and
 * takes w longer. In the middle a joint may change from +a to -a and needs w = 2 a / j; at the ends, next
 * to rest, the step is only a and half the width is enough, and only the widths at the ends lengthen the
 * motion. So w varies with time: the average is (Q(t + w/2) - Q(t - w/2)) / w, where Q is the integral of
 * the motion, and its derivatives give velocity and acceleration without approximation. A changing width
 * distorts the average by w', so it changes slowly, and the result is measured.
 *
 * 4. The result is measured at 1 kHz, and its time stretched by what it exceeds a limit.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

#define GRID_POINTS 800  /* intervals of all winding pieces of a path together, evenly shared */
#define LEAST_WINDING 16 /* fewest and most on one of them; fewer cost more than 1 % in time */
#define MOST_WINDING 300
#define ON_ROUNDS 120 /* intervals of all parabolas that round corners together */
#define LEAST_ROUND 12 /* fewest and most on one of them; that costs less than 0.2 % in time */
#define MOST_ROUND 40
#define SPEED_MARGIN (1.0 - 1e-4) /* share of the speed limits; covers the excess between cuts */
#define SHORTEST 1e-6             /* parts of an even interval below this share are not cut off */
#define LARGEST 1e6               /* squared speed in scaled units where nothing bounds it */
#define LEAST 1e-12               /* a row with a smaller factor of u, in scaled units, bounds x alone */
#define LEAST_NOW 1e-9            /* the same where x is known: the pass from the end has seen to it */

/* Share of the acceleration limits used near the ends, where the changing width of the average adds
 * acceleration; chosen together with RAMP. Only up to a tenth of a path is eased: where more were needed,
 * steps of acceleration would follow each other too closely for a narrow window anyway. */
#define EASED 0.97
#define EASED_PART 0.1
#define RAMP 2.5 /* time in which the width changes, in widths; quicker costs what it saves */

#define WIDTH_MARGIN 1.004 /* differences at 1 kHz show up to 0.3 % more jerk at one phase than another */
#define NARROWEST 0.012    /* average [s] at any jerk limit; samples at 1 kHz resolve half of it */
#define CHECK_STEP 1e-3    /* [s] */
#define JERK_SHARE 0.985   /* with which a narrower window is accepted: peaks are shorter than samples */
#define TOLERANCE 1e-3     /* as in verify.py */
#define MOST_SAMPLES 1e8
#define CORRECTIONS 3      /* of 5700 random paths one in fifty needed one, none two */

enum { SAMPLES, TOOL_SPEEDS, ROWS, CHECKPOINT };
enum { DONE, ENDED, NO_SPEED, NO_MEMORY, EXCEEDS };

/* Asks for room for `count` samples: positions, velocities, accelerations; for the tool's speed at `count`
 * points from q and q_s; for further rows there, a, then b, then c, and how many each point has; or whether
 * to go on. Null ends the work. */
typedef double *(*Supply)(int what, int count, const double *q, const double *q_s, const double *q_ss,
                          int *rows);

typedef struct {
    int pieces, n;
    const double *knots, *coefficients;
} Path;

/* velocity, acceleration and jerk of each joint; of the tool 0 if it has none. */
typedef struct {
    const double *velocity, *acceleration, *jerk;
    double tool;
} Caps;

typedef struct {
    int piece, even; /* whether nothing varies along it */
    double from, to; /* on its piece of the path */
    double share;    /* of the acceleration caps that is used */
} Interval;

/* A path cut into intervals. `begin` and `end`: q, q_s, q_ss of each, 3 * n numbers; curvature may jump
 * between them. `speed`: at each cut. */
typedef struct {
    int count;
    Interval *interval;
    double *begin, *end, *speed;
} Grid;

/* A motion of quintic pieces in time; the first and the last are rest. On piece k its integral is
 * sum_i c[k][i][joint] u^i with u = (t - begins[k]) / lengths[k]. Lengths are kept because differences of
 * times would lose the last digits of a millisecond. */
typedef struct {
    int pieces, n;
    double *begins, *lengths, *c, duration;
} Curve;

/* Width of the average: `middle`, and narrower towards the two ends. */
typedef struct {
    double first, middle, last, ramp, duration;
} Window;

/* All memory of a call. */
typedef struct {
    void *block[32];
    int used;
} Room;

static void *more(Room *room, size_t bytes) {
    void *block = malloc(bytes + 1);
    if (block) room->block[room->used++] = block;
    return block;
}

static double *numbers(Room *room, size_t count) { return more(room, count * sizeof(double)); }

/* ---- 1. speed along the path ---- */

static void evaluate(const Path *path, int piece, double u, double *at) {
    const int n = path->n;
    const double *c = path->coefficients + (size_t)piece * 4 * n;
    for (int j = 0; j < n; j++) {
        const double c1 = c[n + j], c2 = c[2 * n + j], c3 = c[3 * n + j];
        at[j] = c[j] + u * (c1 + u * (c2 + u * c3));
        at[n + j] = c1 + u * (2.0 * c2 + (3.0 * u) * c3);
        at[2 * n + j] = 2.0 * c2 + (6.0 * u) * c3;
    }
}

static int among(int value, int low, int high) { return value < low ? low : value > high ? high : value; }

/* Whether a piece of the path bends (from power 2), or winds (from 3). */
static int has_power(const Path *path, int piece, int power) {
    const double *c = path->coefficients + (size_t)piece * 4 * path->n;
    for (int k = power * path->n; k < 4 * path->n; k++)
        if (c[k] != 0.0) return 1;
    return 0;
}

static int is_inside(double after, double step) {
    return after > SHORTEST * step && after < (1.0 - SHORTEST) * step;
}

/* Cuts curved pieces evenly, with `fine` the straight ones as well, because limits vary along them.
 * Otherwise these are cut `near` [rad] from the ends of the path, where accelerations are eased. */
static int cut(const Path *path, int fine, double near, Room *room, Grid *grid) {
    const double length = path->knots[path->pieces], cuts[2] = {near, length - near};
    int bends = 0, most = 2;
    for (int k = 0; k < path->pieces; k++) bends += has_power(path, k, 2);
    const int many = among(GRID_POINTS / path->pieces, LEAST_WINDING, MOST_WINDING);
    const int some = among(ON_ROUNDS / (bends ? bends : 1), LEAST_ROUND, MOST_ROUND);
    for (int k = 0; k < path->pieces; k++)
        most += fine || has_power(path, k, 3) ? many : has_power(path, k, 2) ? some : 1;
    if (!(grid->interval = more(room, most * sizeof(Interval)))) return NO_MEMORY;
    double s = 0.0;
    Interval *next = grid->interval;
    for (int piece = 0; piece < path->pieces; piece++) {
        const int even = !fine && !has_power(path, piece, 2);
        const int parts = fine || has_power(path, piece, 3) ? many : even ? 1 : some;
        const double step = (path->knots[piece + 1] - path->knots[piece]) / parts;
        for (int k = 0; k < parts; k++) {
            const double begin = k * step, length_here = (k + 1) * step - begin;
            double from = begin;
            for (int which = 0; which < 3; which++) {
                const double after = which < 2 ? cuts[which] - s : length_here;
                if (which < 2 && !(even && is_inside(after, length_here))) continue;
                const double middle = s + 0.5 * (from - begin + after);
                const double share = fmin(middle, length - middle) < near ? EASED : 1.0;
                *next++ = (Interval){piece, even, from, which < 2 ? begin + after : (k + 1) * step, share};
                from = begin + after;
            }
            s += length_here;
        }
    }
    grid->count = next - grid->interval;
    return DONE;
}

static int evaluate_all(const Path *path, Room *room, Grid *grid) {
    const size_t size = (size_t)grid->count * 3 * path->n;
    if (!(grid->begin = numbers(room, 2 * size))) return NO_MEMORY;
    grid->end = grid->begin + size;
    for (int i = 0; i < grid->count; i++) {
        const Interval *each = &grid->interval[i];
        evaluate(path, each->piece, each->from, grid->begin + i * 3 * path->n);
        evaluate(path, each->piece, each->to, grid->end + i * 3 * path->n);
    }
    return DONE;
}

/* The largest x up to `cap` with a u that keeps the m rows and 0 <= x + 2 step u <= next; 0 if there is
 * none. At a given x each row bounds u from above and below by a line p - r x. The gap between the lowest
 * upper and the highest lower bound is concave in x, so Newton's method from the cap gets exactly to the
 * largest x without a negative gap, after a few steps. */
double so101_largest_square(const double *a, const double *b, const double *c, int m, double step,
                            double cap, double next) {
    double above[m], below[m], slope[m], x = cap;
    const double to_next = 0.5 / step;
    int lines = 0;
    for (int k = 0; k < m; k++) {
        if (fabs(a[k]) > LEAST) {
            const double side = copysign(1.0, a[k]), per = 1.0 / a[k];
            slope[lines] = b[k] * per;
            above[lines] = (side - c[k]) * per;
            below[lines++] = (-side - c[k]) * per;
        } else if (b[k] != 0.0) {
            x = fmin(x, (1.0 - copysign(1.0, b[k]) * c[k]) / fabs(b[k]));
        }
    }
    for (;;) {
        double top = to_next * (next - x), top_slope = to_next, bottom = -to_next * x, slope_below = to_next;
        for (int k = 0; k < lines; k++) {
            const double r = slope[k], high = above[k] - r * x, low = below[k] - r * x;
            if (high < top || (high == top && r < top_slope)) top = high, top_slope = r;
            if (low > bottom || (low == bottom && r > slope_below)) bottom = low, slope_below = r;
        }
        const double gap = top - bottom, rise = slope_below - top_slope;
        if (gap >= 0.0) return x;
        const double lower = x - gap / rise;
        if (!(rise < 0.0 && lower > 0.0)) return 0.0; /* nor below */
        if (lower >= (1.0 - 1e-15) * x) return x;     /* a step as small as rounding */
        x = lower;
    }
}

/* What `supply` says of the points at the beginnings or the ends, copied; null and 1 if it ends. */
static int asked(Supply supply, int what, const double *points, int count, int n, Room *room, int *rows,
                 double **said) {
    const size_t size = (size_t)count * n;
    double *parts = numbers(room, 3 * size);
    if (!parts) return NO_MEMORY;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++)
            memcpy(parts + k * size + (size_t)i * n, points + ((size_t)3 * i + k) * n, n * sizeof(double));
    const double *found = supply(what, count, parts, parts + size, parts + 2 * size, rows);
    if (!found) return ENDED;
    const size_t given = what == ROWS ? (size_t)3 * count * *rows : (size_t)count;
    if (!(*said = numbers(room, given))) return NO_MEMORY;
    memcpy(*said, found, given * sizeof(double));
    return DONE;
}

/* The linear programs of all intervals: m rows of each; the largest square at each cut; the largest u of
 * even intervals, 0 for others; the squares that are found. Lengths are in units of `length`, and `unit` is
 * the square of a speed of 1, so that the numbers are near one. */
typedef struct {
    int m;
    double *a, *b, *c, *cap, *hardest, *x, length, unit;
} Program;

static int state(const Path *path, const Caps *caps, int has_further, Supply supply, const Grid *grid,
                 Room *room, Program *p) {
    const int n = path->n, count = grid->count;
    int rows = 0, status, curves = 0;
    double curved = 0.0, all = 0.0, most = 0.0, *further[2] = {0, 0}, *tool = 0;
    for (int i = 0; i < count; i++) {
        const Interval *each = &grid->interval[i];
        all += each->to - each->from;
        if (!each->even) curved += each->to - each->from, curves++;
        for (int j = 0; j < n; j++) most = fmax(most, each->share * caps->acceleration[j]);
    }
    p->length = LEAST_WINDING * (curves ? curved / curves : all / count);
    p->unit = p->length * most;
    for (int side = 0; side < 2 && has_further; side++)
        if ((status = asked(supply, ROWS, side ? grid->end : grid->begin, count, n, room, &rows, &further[side])))
            return status;
    const int half = n + rows, m = p->m = 2 * half;
    const size_t size = (size_t)m * count;
    if (!(p->a = numbers(room, 3 * size + 3 * (count + 1)))) return NO_MEMORY;
    p->b = p->a + size, p->c = p->b + size, p->cap = p->c + size;
    p->hardest = p->cap + count + 1, p->x = p->hardest + count + 1;
    if (caps->tool > 0.0) {
        /* The last cut is the end of the last interval. */
        double *points = numbers(room, (size_t)3 * n * (count + 1));
        if (!points) return NO_MEMORY;
        memcpy(points, grid->begin, (size_t)3 * n * count * sizeof(double));
        memcpy(points + (size_t)3 * n * count, grid->end + (size_t)3 * n * (count - 1), 3 * n * sizeof(double));
        if ((status = asked(supply, TOOL_SPEEDS, points, count + 1, n, room, 0, &tool))) return status;
    }
    for (int i = 0; i <= count; i++) {
        const double *q_s = (i < count ? grid->begin + i * 3 * n : grid->end + (i - 1) * 3 * n) + n;
        double slowest = 0.0;
        for (int j = 0; j < n; j++) slowest = fmax(slowest, fabs(q_s[j]) / caps->velocity[j]);
        double speed = 1.0 / slowest; /* infinite where no joint moves */
        if (tool) speed = fmin(speed, caps->tool / tool[i]);
        p->cap[i] = fmin(SPEED_MARGIN * speed * (SPEED_MARGIN * speed) / p->unit, LARGEST);
    }
    for (int i = 0; i < count; i++) {
        const Interval *each = &grid->interval[i];
        double *a = p->a + (size_t)m * i, *b = p->b + (size_t)m * i, *c = p->c + (size_t)m * i, largest = 0.0;
        const double step = (each->to - each->from) / p->length;
        for (int side = 0; side < 2; side++) {
            const double *q_s = (side ? grid->end : grid->begin) + i * 3 * n + n, *q_ss = q_s + n;
            const int k = side * half;
            for (int j = 0; j < n; j++) {
                const double cap = each->share * caps->acceleration[j];
                a[k + j] = q_s[j] / cap, b[k + j] = q_ss[j] / cap, c[k + j] = 0.0;
            }
            for (int j = 0; j < rows; j++) {
                const double *from = further[side] + (size_t)i * rows + j;
                a[k + n + j] = from[0], b[k + n + j] = from[(size_t)count * rows];
                c[k + n + j] = from[(size_t)2 * count * rows];
            }
        }
        for (int k = 0; k < m; k++) {
            a[k] *= most, b[k] *= p->unit;
            /* An interval of constant u ends with x + 2 step u. */
            if (k >= half) a[k] += 2.0 * step * b[k];
            largest = fmax(largest, fabs(a[k]));
        }
        p->hardest[i] = each->even ? 1.0 / largest : 0.0;
    }
    return DONE;
}

/* Finds the largest squares. */
static int solve(const Grid *grid, Program *p) {
    const int count = grid->count, m = p->m;
    double *x = p->x, largest = 0.0;
    for (int i = count; i >= 0; i--) {
        const double step = i < count ? (grid->interval[i].to - grid->interval[i].from) / p->length : 0.0;
        const size_t k = (size_t)m * i;
        if (i < count)
            largest = p->hardest[i] > 0.0
                ? fmin(p->cap[i], largest + 2.0 * step * p->hardest[i])
                : so101_largest_square(p->a + k, p->b + k, p->c + k, m, step, p->cap[i], largest);
        x[i] = largest;
    }
    x[0] = 0.0;
    for (int i = 0; i < count; i++) {
        const double step = (grid->interval[i].to - grid->interval[i].from) / p->length;
        double u = p->hardest[i];
        if (!(u > 0.0)) {
            u = INFINITY;
            for (size_t k = (size_t)m * i; k < (size_t)m * (i + 1); k++)
                if (fabs(p->a[k]) > LEAST_NOW)
                    u = fmin(u, (copysign(1.0, p->a[k]) - p->c[k] - p->b[k] * x[i]) / p->a[k]);
        }
        x[i + 1] = fmax(0.0, fmin(x[i] + 2.0 * step * u, x[i + 1]));
        if (i + 1 < count && !(x[i + 1] > 0.0)) return NO_SPEED;
    }
    return DONE;
}

/* Cuts even intervals where full acceleration, top speed and full braking meet. */
static int divide(const Grid *grid, const Program *p, Room *room, Grid *divided) {
    Interval *next = divided->interval = more(room, 3 * grid->count * sizeof(Interval));
    double *speed = divided->speed = numbers(room, 3 * grid->count + 1);
    if (!next || !speed) return NO_MEMORY;
    for (int i = 0; i < grid->count; i++) {
        Interval each = grid->interval[i];
        const double first = p->x[i], last = p->x[i + 1], step = (each.to - each.from) / p->length;
        *speed++ = sqrt(first * p->unit);
        if (each.even) {
            const double rate = 2.0 * p->hardest[i], peak = 0.5 * (first + last + rate * step);
            const double top = fmin(p->cap[i], peak);
            const double after = (top - first) / rate, before = step - (top - last) / rate;
            const double cuts[2] = {after, before}, start = each.from;
            for (int k = 0; k < 2; k++) {
                if (!is_inside(cuts[k], step) || (k && !(before - after > SHORTEST * step))) continue;
                const double at = start + p->length * cuts[k];
                *next++ = (Interval){each.piece, 1, each.from, at, each.share};
                *speed++ = sqrt(top * p->unit);
                each.from = at;
            }
        }
        *next++ = each;
    }
    *speed = sqrt(p->x[grid->count] * p->unit);
    divided->count = next - divided->interval;
    return DONE;
}

/* The best speeds along a path: cut with `near`, see above. */
static int best_speeds(const Path *path, const Caps *caps, int has_further, double near, Supply supply,
                       Room *room, Grid *best) {
    Grid grid;
    Program program;
    int status = cut(path, caps->tool > 0.0 || has_further, near, room, &grid);
    if (!status) status = evaluate_all(path, room, &grid);
    if (!status) status = state(path, caps, has_further, supply, &grid, room, &program);
    if (!status && !supply(CHECKPOINT, 0, 0, 0, 0, 0)) status = ENDED;
    if (!status) status = solve(&grid, &program);
    if (!status) status = divide(&grid, &program, room, best);
    if (!status) status = evaluate_all(path, room, best);
    return status;
}

/* ---- 2. motion in time ---- */

#define POWERS 7

static int in_time(const Grid *grid, int n, double rest, Room *room, Curve *curve) {
    const int pieces = grid->count + 2;
    double *begins = numbers(room, pieces), *lengths = numbers(room, pieces);
    double *c = numbers(room, (size_t)pieces * POWERS * n);
    if (!begins || !lengths || !c) return NO_MEMORY;
    *curve = (Curve){pieces, n, begins, lengths, c, 0.0};
    memset(c, 0, (size_t)pieces * POWERS * n * sizeof(double));
    begins[0] = -rest, lengths[0] = lengths[pieces - 1] = rest;
    for (int j = 0; j < n; j++) {
        c[n + j] = rest * grid->begin[j];
        c[((size_t)(pieces - 1) * POWERS + 1) * n + j] = rest * grid->end[(grid->count - 1) * 3 * n + j];
    }
    double t = 0.0;
    for (int i = 0; i < grid->count; i++) {
        const double step = grid->interval[i].to - grid->interval[i].from;
        const double v0 = grid->speed[i], v1 = grid->speed[i + 1], u = (v1 * v1 - v0 * v0) / (2.0 * step);
        const double h = 2.0 * step / (v0 + v1);
        const double *from = grid->begin + i * 3 * n, *to = grid->end + i * 3 * n;
        /* Where pieces meet, both take the place and the direction from the one that begins. */
        const double *meet = i + 1 < grid->count ? from + 3 * n : to;
        double *out = c + (size_t)(i + 1) * POWERS * n;
        begins[i + 1] = t, lengths[i + 1] = h;
        t += h;
        for (int j = 0; j < n; j++) {
            const double q = from[j], v = from[n + j] * v0 * h, w = meet[n + j] * v1 * h;
            const double a = (from[n + j] * u + from[2 * n + j] * v0 * v0) * h * h;
            const double b = (to[n + j] * u + to[2 * n + j] * v1 * v1) * h * h;
            /* What the piece has to gain beyond the parabola. */
            const double dq = meet[j] - q - v - 0.5 * a, dv = w - v - a, da = b - a;
            out[n + j] = h * q, out[2 * n + j] = h * v / 2.0, out[3 * n + j] = h * a / 6.0;
            out[4 * n + j] = h * (10.0 * dq - 4.0 * dv + 0.5 * da) / 4.0;
            out[5 * n + j] = h * (-15.0 * dq + 7.0 * dv - da) / 5.0;
            out[6 * n + j] = h * (6.0 * dq - 3.0 * dv + 0.5 * da) / 6.0;
        }
    }
    begins[pieces - 1] = curve->duration = t;
    for (int i = 0; i + 1 < pieces; i++) {
        const double *here = c + (size_t)i * POWERS * n;
        for (int j = 0; j < n; j++) {
            double sum = 0.0;
            for (int k = 1; k < POWERS; k++) sum += here[k * n + j];
            c[(size_t)(i + 1) * POWERS * n + j] = here[j] + sum;
        }
    }
    return DONE;
}

/* ---- 3. the average ---- */

/* The piece at t; `piece`: one that begins no later. */
static int piece_at(const Curve *curve, double t, int piece) {
    while (piece + 1 < curve->pieces && curve->begins[piece + 1] <= t) piece++;
    return piece;
}

static inline void horner(const double *c, double u, int n, double *value) {
    for (int j = 0; j < n; j++) value[j] = c[6 * n + j];
    for (int k = POWERS - 2; k >= 0; k--)
        for (int j = 0; j < n; j++) value[j] = value[j] * u + c[k * n + j];
}

/* The integral at t. */
static void integral_at(const Curve *curve, double t, int piece, double *value) {
    const double u = (t - curve->begins[piece]) / curve->lengths[piece];
    const double *c = curve->c + (size_t)piece * POWERS * curve->n;
    if (curve->n == ARM_JOINTS)
        horner(c, u, ARM_JOINTS, value);
    else
        horner(c, u, curve->n, value);
}

/* Integral, position and velocity of a joint at t. */
static void motion_at(const Curve *curve, double t, int piece, int joint, double out[3]) {
    const double h = curve->lengths[piece], u = (t - curve->begins[piece]) / h;
    const double *c = curve->c + (size_t)piece * POWERS * curve->n + joint;
    double q = 0.0, qd = 0.0, qdd = 0.0;
    for (int k = POWERS - 1; k >= 0; k--) {
        qdd = qdd * u + 2.0 * qd; /* twice the derivative of what is summed up so far */
        qd = qd * u + q;
        q = q * u + c[k * curve->n];
    }
    out[0] = q, out[1] = qd / h, out[2] = qdd / (h * h);
}

/* The width at t and its two derivatives. It grows only once the step from rest has left the window,
 * along a quintic step. */
static void width_at(const Window *w, double t, double out[3]) {
    out[0] = w->middle, out[1] = out[2] = 0.0;
    for (int end = 0; end < 2; end++) {
        const double narrow = end ? w->last : w->first, depth = w->middle - narrow;
        const double clock = end ? w->duration - 0.5 * narrow - t : t - 0.5 * narrow;
        if (!(depth > 0.0) || clock >= w->ramp) continue;
        const double u = fmax(clock / w->ramp, 0.0), rate = depth / w->ramp;
        out[0] -= depth * (1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0)));
        out[1] += (end ? -1.0 : 1.0) * rate * 30.0 * (u * (1.0 - u)) * (u * (1.0 - u));
        out[2] += rate / w->ramp * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u);
    }
}

/* Positions of the averaged motion from `begin` on, `step` apart. */
static void averaged(const Curve *curve, const Window *window, double begin, double step, int count,
                     double *q) {
    const int n = curve->n;
    double early[n], width[3];
    int ahead = 0, behind = 0;
    for (int k = 0; k < count; k++, q += n) {
        const double t = begin + k * step;
        width_at(window, t, width);
        const double half = 0.5 * width[0], per = 1.0 / width[0];
        integral_at(curve, t + half, ahead = piece_at(curve, t + half, ahead), q);
        integral_at(curve, t - half, behind = piece_at(curve, t - half, behind), early);
        for (int j = 0; j < n; j++) q[j] = (q[j] - early[j]) * per;
    }
}

static double begin_of(const Window *w) { return -0.5 * w->first; }
static double end_of(const Window *w) { return w->duration + 0.5 * w->last; }

/* The averaged motion, `stretch` times slower, sampled every dt. */
static void sample(const Curve *curve, const Window *window, double stretch, double dt, int count,
                   double *q, double *qd, double *qdd) {
    const int n = curve->n;
    double width[3];
    int ahead = 0, behind = 0;
    for (int k = 0; k < count; k++, q += n, qd += n, qdd += n) {
        const double t = fmin(begin_of(window) + k * (dt / stretch), end_of(window));
        width_at(window, t, width);
        const double w = width[0], w_t = width[1], w_tt = width[2], up = 1.0 + 0.5 * w_t, down = 1.0 - 0.5 * w_t;
        ahead = piece_at(curve, t + 0.5 * w, ahead), behind = piece_at(curve, t - 0.5 * w, behind);
        for (int j = 0; j < n; j++) {
            double late[3], early[3];
            motion_at(curve, t + 0.5 * w, ahead, j, late);
            motion_at(curve, t - 0.5 * w, behind, j, early);
            q[j] = (late[0] - early[0]) / w;
            const double rate = (late[1] * up - early[1] * down - w_t * q[j]) / w;
            const double bend = late[2] * up * up - early[2] * down * down + 0.5 * w_tt * (late[1] + early[1]);
            qd[j] = rate / stretch;
            qdd[j] = (bend - w_tt * q[j] - 2.0 * w_t * rate) / w / (stretch * stretch);
            if (k > 0 && k < count - 1) continue;
            motion_at(curve, k ? curve->duration : 0.0, k ? curve->pieces - 1 : 1, j, late);
            q[j] = late[1], qd[j] = qdd[j] = 0.0;
        }
    }
}

/* ---- 4. measuring ---- */

static double larger(double peak, double value) {
    value = fabs(value);
    return value > peak || value != value ? value : peak; /* what is no number stays */
}

/* The largest difference quotients of positions, each n: first, second, third. `starts`: the motion rests
 * before its beginning, `rests`: after its end; otherwise nothing is known of that. */
static inline void peaks_of(const double *q, int count, int n, double dt, int starts, int rests, double *peak) {
    const double per = 1.0 / dt;
    double last[n], speed[n], bend[n];
    int known = starts ? 3 : 0; /* differences that precede */
    for (int j = 0; j < n; j++) last[j] = q[j], speed[j] = bend[j] = 0.0;
    for (int k = 0; k < 3 * n; k++) peak[k] = 0.0;
    for (int k = 1; k < count + 3 * rests; k++, known++) {
        const double *now = q + (size_t)(k < count ? k : count - 1) * n;
        for (int j = 0; j < n; j++) {
            const double v = (now[j] - last[j]) * per, a = (v - speed[j]) * per, jerk = (a - bend[j]) * per;
            peak[j] = larger(peak[j], v);
            peak[n + j] = larger(peak[n + j], known >= 1 ? a : 0.0);
            peak[2 * n + j] = larger(peak[2 * n + j], known >= 2 ? jerk : 0.0);
            last[j] = now[j], speed[j] = v, bend[j] = a;
        }
    }
}

static void difference_peaks(const double *q, int count, int n, double dt, int starts, int rests,
                             double *peak) {
    if (n == ARM_JOINTS)
        peaks_of(q, count, ARM_JOINTS, dt, starts, rests, peak); /* unrolled by the compiler */
    else
        peaks_of(q, count, n, dt, starts, rests, peak);
}

/* The largest speed, acceleration and jerk of each joint in a motion, by differences of its positions and
 * by its own velocities and accelerations; then its least and largest positions: each n. */
void so101_peaks(const double *q, const double *qd, const double *qdd, int count, int n, double dt,
                 double *peak) {
    int starts = 1;
    for (int j = 0; j < n; j++) starts &= qd[j] == 0.0 && qdd[j] == 0.0;
    difference_peaks(q, count, n, dt, starts, 1, peak);
    double *least = peak + 3 * n, *most = peak + 4 * n;
    for (int j = 0; j < n; j++) least[j] = most[j] = q[j];
    for (int k = 0; k < count; k++, q += n, qd += n, qdd += n) {
        for (int j = 0; j < n; j++) {
            peak[j] = larger(peak[j], qd[j]);
            peak[n + j] = larger(peak[n + j], qdd[j]);
            if (k) peak[2 * n + j] = larger(peak[2 * n + j], (qdd[j] - qdd[j - n]) / dt);
            if (q[j] < least[j]) least[j] = q[j];
            if (q[j] > most[j]) most[j] = q[j];
        }
    }
}

/* The largest share of the caps of speed, acceleration and jerk that peaks use. */
static void shares(const double *peak, const Caps *caps, int n, double share[3]) {
    share[0] = share[1] = share[2] = 0.0;
    for (int j = 0; j < n; j++) {
        share[0] = larger(share[0], peak[j] / caps->velocity[j]);
        share[1] = larger(share[1], peak[n + j] / caps->acceleration[j]);
        share[2] = larger(share[2], peak[2 * n + j] / caps->jerk[j]);
    }
}

/* How much slower the motion must be to keep the caps. */
static double slower(const double share[3]) { return fmax(share[0], fmax(sqrt(share[1]), cbrt(share[2]))); }

/* The shortest window that keeps the caps, judged at each end for itself: half the width is enough, unless
 * a large step of acceleration comes before the window has grown. */
static int fitting_window(const Curve *curve, double width, const Caps *caps, Room *room, Window *window) {
    const double ramp = RAMP * width, reach = (RAMP + 2.0) * width, step = fmax(CHECK_STEP, width / 40.0);
    const Window even = {width, width, width, ramp, curve->duration};
    *window = even;
    if (curve->duration < 2.0 * reach) return DONE;
    const int count = (int)ceil((reach + 6.0 * step) / step);
    double *q = numbers(room, (size_t)count * curve->n), *peak = numbers(room, 3 * curve->n), share[3];
    if (!q || !peak) return NO_MEMORY;
    for (int end = 0; end < 2; end++) {
        Window tried = even;
        *(end ? &tried.last : &tried.first) = 0.5 * width;
        const double begin = end ? end_of(&tried) - (count - 4) * step : begin_of(&tried) - 3.0 * step;
        averaged(curve, &tried, begin, step, count, q);
        difference_peaks(q, count, curve->n, step, 0, 0, peak);
        shares(peak, caps, curve->n, share);
        if (share[1] <= 1.0 && share[2] <= JERK_SHARE) *(end ? &window->last : &window->first) = 0.5 * width;
    }
    return DONE;
}

/* The tool's largest share of its cap in positions CHECK_STEP apart. Each value may cost a Jacobian: every
 * fourth first, then all near the highest ones. */
static int tool_share(const double *q, int count, int n, const Caps *caps, Supply supply, Room *room,
                      double *share) {
    const int steps = count - 1, few = (steps + 3) / 4;
    double *middle = numbers(room, (size_t)2 * steps * n), *coarse = numbers(room, few), highest = 0.0;
    if (!middle || !coarse) return NO_MEMORY;
    double *rate = middle + (size_t)steps * n;
    for (int pass = 0; pass < 2; pass++) {
        int kept = 0;
        for (int k = 0; k < steps; k++) {
            int wanted = !pass && k % 4 == 0;
            for (int i = (k - 4) / 4; pass && i <= (k + 4) / 4; i++)
                if (i >= 0 && i < few && k >= 4 * i - 4 && k <= 4 * i + 7) wanted |= coarse[i] > 0.98 * highest;
            if (!wanted) continue;
            for (int j = 0; j < n; j++) {
                const double a = q[(size_t)k * n + j], b = q[(size_t)(k + 1) * n + j];
                middle[(size_t)kept * n + j] = 0.5 * (a + b), rate[(size_t)kept * n + j] = (b - a) / CHECK_STEP;
            }
            kept++;
        }
        const double *said = supply(TOOL_SPEEDS, kept, middle, rate, 0, 0);
        if (!said) return ENDED;
        for (int k = 0; k < kept; k++) {
            if (!pass) coarse[k] = said[k];
            highest = larger(highest, said[k]);
        }
    }
    *share = highest / caps->tool;
    return DONE;
}

/* Width of the average and, in `share`, of the acceleration caps: a joint may turn from full acceleration
 * to full braking at once, so w = 2 a / j; its distance from the path is then at most a w^2 / 24, which must
 * stay within `deviation`. Lowering a lowers w with it, so the distance goes with the cube of the share. */
static double width_of_average(const Caps *caps, int n, double deviation, double *share) {
    double width = 0.0, most = 0.0;
    for (int j = 0; j < n; j++) {
        width = fmax(width, WIDTH_MARGIN * (2.0 * caps->acceleration[j] / caps->jerk[j]));
        most = fmax(most, caps->acceleration[j]);
    }
    width = fmax(NARROWEST, width);
    *share = fmin(1.0, cbrt(deviation / (most * width * width / 24.0)));
    return width * *share;
}

/* Length at both ends where acceleration is eased: what the joints can travel before the average has its
 * full width; 0 for none. */
static double eased_length(double length, double most, int n, double width) {
    const double time = (RAMP + 0.5) * width, near = 0.5 * most * time * time * sqrt(n);
    return near <= EASED_PART * length ? near : 0.0;
}

/* A path whose parameter is time is passed at a speed of 1. */
static int as_it_is(const Path *path, Room *room, Grid *grid) {
    grid->count = path->pieces;
    grid->interval = more(room, path->pieces * sizeof(Interval));
    grid->speed = numbers(room, path->pieces + 1);
    if (!grid->interval || !grid->speed) return NO_MEMORY;
    for (int k = 0; k <= path->pieces; k++) grid->speed[k] = 1.0;
    for (int k = 0; k < path->pieces; k++)
        grid->interval[k] = (Interval){k, 0, 0.0, path->knots[k + 1] - path->knots[k], 1.0};
    return evaluate_all(path, room, grid);
}

static int make(const Path *path, const Caps *caps, int timed, double dt, double deviation, int has_further,
                Supply supply, Room *room, double *duration) {
    const int n = path->n;
    Grid grid;
    Curve curve;
    Window window;
    double share, most = 0.0, used[3], *lower = numbers(room, n), *peak = numbers(room, 5 * n);
    if (!lower || !peak) return NO_MEMORY;
    const double width = width_of_average(caps, n, deviation, &share);
    for (int j = 0; j < n; j++) most = fmax(most, lower[j] = share * caps->acceleration[j]);
    const Caps eased = {caps->velocity, lower, caps->jerk, caps->tool};
    const double near = eased_length(path->knots[path->pieces], most, n, width);
    int status = timed ? as_it_is(path, room, &grid)
                       : best_speeds(path, &eased, has_further, near, supply, room, &grid);
    if (!status) status = in_time(&grid, n, 2.0 * width, room, &curve);
    if (!status) status = fitting_window(&curve, width, caps, room, &window);
    if (status) return status;
    if (!supply(CHECKPOINT, 0, 0, 0, 0, 0)) return ENDED;
    const double begin = begin_of(&window) - 4.0 * CHECK_STEP, end = end_of(&window) + 4.0 * CHECK_STEP;
    if (!(end - begin < MOST_SAMPLES * CHECK_STEP)) return NO_MEMORY;
    int count = (int)ceil((end - begin) / CHECK_STEP);
    double *q = numbers(room, (size_t)count * n), tool = 0.0;
    if (!q) return NO_MEMORY;
    averaged(&curve, &window, begin, CHECK_STEP, count, q);
    difference_peaks(q, count, n, CHECK_STEP, 0, 0, peak);
    shares(peak, caps, n, used);
    if (caps->tool > 0.0 && (status = tool_share(q, count, n, caps, supply, room, &tool))) return status;
    double stretch = fmax(1.0, fmax(slower(used), tool / SPEED_MARGIN));
    for (int tries = 0; tries <= CORRECTIONS; tries++) {
        *duration = stretch * (end_of(&window) - begin_of(&window));
        if (!(*duration < MOST_SAMPLES * dt)) return NO_MEMORY;
        count = (int)ceil(*duration / dt - 1e-9) + 1;
        if (!(q = supply(SAMPLES, count, 0, 0, 0, 0))) return ENDED;
        double *qd = q + (size_t)count * n, *qdd = qd + (size_t)count * n;
        sample(&curve, &window, stretch, dt, count, q, qd, qdd);
        so101_peaks(q, qd, qdd, count, n, dt, peak);
        shares(peak, caps, n, used);
        if (used[0] <= 1.0 && fmax(used[1], used[2]) <= 1.0 + TOLERANCE) return DONE;
        stretch *= slower(used) * (1.0 + 0.5 * TOLERANCE);
    }
    return EXCEEDS;
}

static void leave(Room *room) {
    while (room->used) free(room->block[--room->used]);
}

/* Times a path, or averages one that is `timed` already; `caps`: velocity, acceleration and jerk, each n.
 * Returns one of the codes above; the last samples that were asked for are the motion. */
int so101_retime(int pieces, int n, const double *knots, const double *coefficients, const double *caps,
                 double tool, int has_further, Supply supply, int timed, double dt, double deviation,
                 double *duration) {
    const Path path = {pieces, n, knots, coefficients};
    const Caps limits = {caps, caps + n, caps + 2 * n, tool};
    Room room = {.used = 0};
    const int status = make(&path, &limits, timed, dt, deviation, has_further, supply, &room, duration);
    leave(&room);
    return status;
}

/* The width of the average, and the share of the accelerations for a motion that is averaged. */
double so101_averaging(const double *caps, int n, double deviation, double *share) {
    const Caps limits = {caps, caps + n, caps + 2 * n, 0.0};
    const double width = width_of_average(&limits, n, deviation, share);
    *share *= EASED;
    return width;
}
