/* Closed-form inverse kinematics for each kind of goal: position, approach, full pose. ik_closed.py
 * calls it, arm_geometry.py explains the arm.
 *
 * One call solves one goal: it fills a list of configurations, the best first. Nothing is allocated
 * and nothing is kept between calls. Metres and radians throughout. */

#include "arm_ik.h"

#define REACH_SLACK 1e-5 /* as in arm_geometry.py */
#define ROLLS 6 /* parts into which the roll's range is cut if its present angle does not work; chosen */
#define SETTLED 1e-10
#define ROUNDS 10

#define HALF_PI 1.5707963267948966

#define MOST 32 /* configurations for one goal: at most 5 rolls, 2 sides, 2 elbows */

enum { POSITION_ONLY, POSITION_AND_APPROACH, FULL_POSE };

/* A goal: `metric` is one of the above, R as wanted for the tool. */
typedef struct {
    double metric, point[3], R[9], angle_tolerance, seed[5];
} Goal;

typedef struct {
    double q[5];
} Configuration;

typedef struct {
    double lateral, length, elevation;
} Rolled;

typedef struct {
    double pan;
    Target target;
    bool back;
} Side;

/* ---- The gripper and the pan ---- */

static Rolled rolled(const Arm *arm, double roll)
{
    double c = cos(roll), s = sin(roll);
    double forward = arm->forward[0] + arm->forward[1] * c + arm->forward[2] * s;
    double left = arm->left[0] + arm->left[1] * c + arm->left[2] * s;
    double up = arm->up[0] + arm->up[1] * c + arm->up[2] * s;
    return (Rolled){left, hypot(forward, up), atan2(up, forward)};
}

static int rolls_with_lateral(const Arm *arm, double lateral, double *rolls)
{
    double swing = hypot(arm->left[1], arm->left[2]);
    if (swing < 1e-9)
        return 0;
    double turn = acos(clipped((lateral - arm->left[0]) / swing, -1.0, 1.0));
    double phase = atan2(arm->left[2], arm->left[1]);
    rolls[0] = wrapped(phase + turn);
    rolls[1] = wrapped(phase - turn);
    return 2;
}

static double clip_roll(const Arm *arm, double roll)
{
    double lower = arm->lower[4], upper = arm->upper[4];
    if (lower <= roll && roll <= upper)
        return roll;
    double middle = 0.5 * (lower + upper);
    return clipped(middle + wrapped(roll - middle), lower, upper);
}

static bool pan_allows(const Arm *arm, double pan)
{
    return arm->lower[0] - JOINT_SLACK <= pan && pan <= arm->upper[0] + JOINT_SLACK;
}

static bool can_reach(const Arm *arm, const double *point)
{
    double ahead = hypot(point[0] - arm->pan_x, point[1] - arm->pan_y) - fabs(arm->shoulder_x);
    return hypot(ahead > 0.0 ? ahead : 0.0, point[2] - arm->shoulder_z) < arm->longest;
}

static int sides(const Arm *arm, const double *point, Rolled frame, Side *found)
{
    double x = point[0] - arm->pan_x, y = point[1] - arm->pan_y, lateral = frame.lateral;
    double square = x * x + y * y - lateral * lateral;
    double forward = square > 0.0 ? sqrt(square) : 0.0;
    if (forward == 0.0 && hypot(x, y) < fabs(lateral) - REACH_SLACK)
        return 0;
    double heading = atan2(y, x) - arm->azimuth;
    int count = 0;
    for (int back = 0; back < 2; back++) {
        double along = back ? -forward : forward;
        double pan = arm->pan_sign * wrapped(heading - atan2(lateral, along));
        if (pan_allows(arm, pan)) {
            Target target = {along - arm->shoulder_x, point[2] - arm->shoulder_z, frame.length,
                             frame.elevation};
            found[count++] = (Side){pan, target, back};
        }
    }
    return count;
}

/* ---- The three kinds of goal ---- */

static Configuration configuration(Side side, Bend bend, double roll)
{
    return (Configuration){{side.pan, bend.angles[0], bend.angles[1], bend.angles[2], roll}};
}

static int spread_rolls(const Arm *arm, double *rolls)
{
    double step = (arm->upper[4] - arm->lower[4]) / ROLLS;
    for (int i = 0; i <= ROLLS; i++)
        rolls[i] = i == ROLLS ? arm->upper[4] : arm->lower[4] + i * step;
    return ROLLS + 1;
}

static int position_rolls(const Arm *arm, const double *point, double roll, double *rolls)
{
    double inside[2];
    rolls[0] = roll;
    if (arm->on_axis || !can_reach(arm, point))
        return 1;
    double others[ROLLS + 3];
    int count = spread_rolls(arm, others), n = rolls_with_lateral(arm, 0.0, inside);
    for (int i = 0; i < n; i++)
        others[count++] = clip_roll(arm, inside[i]);
    for (int i = 0; i < count; i++) {
        int k = i + 1;
        for (; k > 1 && fabs(rolls[k - 1] - roll) > fabs(others[i] - roll); k--)
            rolls[k] = rolls[k - 1];
        rolls[k] = others[i];
    }
    return count + 1;
}

static int nearest_position(const Arm *arm, const Goal *goal, Configuration *found)
{
    double rolls[ROLLS + 4];
    const double *seed = goal->seed;
    double first = clip_roll(arm, seed[4]);
    int n_rolls = 1;
    rolls[0] = first;
    for (int i = 0; i < n_rolls; i++) {
        Side side[2];
        double ceiling = INFINITY;
        int n = sides(arm, goal->point, rolled(arm, rolls[i]), side), count = 0;
        for (int k = 0; k < n; k++) {
            double turn = (side[k].pan - seed[0]) * (side[k].pan - seed[0]), rest = ceiling - turn;
            Bend bend;
            if (so101_nearest_bend(arm, side[k].target, seed + 1, &rest, &bend)) {
                ceiling = rest + turn;
                found[0] = configuration(side[k], bend, rolls[i]);
                count = 1;
            }
        }
        if (count)
            return 1;
        if (i == 0)
            n_rolls = position_rolls(arm, goal->point, first, rolls);
    }
    return 0;
}

static double distance(const double *q, const double *seed)
{
    double square = 0.0;
    for (int i = 0; i < 5; i++)
        square += (q[i] - seed[i]) * (q[i] - seed[i]);
    return sqrt(square);
}

static void sort_by_distance(Configuration *list, int count, const double *seed)
{
    for (int i = 1; i < count; i++) {
        Configuration each = list[i];
        double away = distance(each.q, seed);
        int k = i;
        for (; k > 0 && distance(list[k - 1].q, seed) > away; k--)
            list[k] = list[k - 1];
        list[k] = each;
    }
}

static int configurations(const Arm *arm, Side side, double pitch, double roll,
                          Configuration *found)
{
    Bend bend[2];
    int count = so101_nearest_pitch(arm, side.target, pitch, bend);
    for (int i = 0; i < count; i++)
        found[i] = configuration(side, bend[i], roll);
    return count;
}

static double azimuth_of(const Arm *arm, double pan)
{
    return arm->azimuth + arm->pan_sign * pan;
}

static int approach_rolls(const Arm *arm, const Goal *goal, double *rolls)
{
    double x = goal->R[2], y = goal->R[5];
    int count = 0;
    if (arm->on_axis || hypot(x, y) <= 1e-9)
        return 0;
    for (int k = 0; k < 2; k++) {
        double azimuth = k ? atan2(-y, -x) : atan2(y, x);
        if (pan_allows(arm, arm->pan_sign * wrapped(azimuth - arm->azimuth))) {
            double px = goal->point[0] - arm->pan_x, py = goal->point[1] - arm->pan_y;
            double lateral = py * cos(azimuth) - px * sin(azimuth);
            count += rolls_with_lateral(arm, lateral, rolls + count);
        }
    }
    for (int i = 0; i < count; i++)
        rolls[i] = clip_roll(arm, rolls[i]);
    return count;
}

/* Configurations near enough to the approach go to `found`, the others to `rest`. */
static int approach(const Arm *arm, const Goal *goal, const double *rolls, int n_rolls,
                    Configuration *found, Configuration *rest, int *n_rest)
{
    double x = goal->R[2], y = goal->R[5], z = goal->R[8];
    double out_of_plane = sin(goal->angle_tolerance < HALF_PI ? goal->angle_tolerance : HALF_PI);
    int count = 0;
    for (int i = 0; i < n_rolls; i++) {
        Side side[2];
        int n = sides(arm, goal->point, rolled(arm, rolls[i]), side);
        for (int k = 0; k < n; k++) {
            double azimuth = azimuth_of(arm, side[k].pan), c = cos(azimuth), s = sin(azimuth);
            double pitch = arm->approach_elevation - atan2(z, x * c + y * s);
            bool near = fabs(y * c - x * s) <= out_of_plane;
            Configuration *list = near ? found + count : rest + *n_rest;
            int more = configurations(arm, side[k], pitch, rolls[i], list);
            *(near ? &count : n_rest) += more;
        }
    }
    sort_by_distance(found, count, goal->seed);
    return count;
}

static int nearest_approach(const Arm *arm, const Goal *goal, Configuration *found)
{
    Configuration rest[MOST];
    double rolls[4], first = clip_roll(arm, goal->seed[4]);
    int n_rest = 0;
    int count = approach(arm, goal, &first, 1, found, rest, &n_rest);
    int n = approach_rolls(arm, goal, rolls);
    count += approach(arm, goal, rolls, n, found + count, rest, &n_rest);
    for (int i = 0; i < n_rest; i++)
        found[count++] = rest[i];
    return count;
}

/* ---- The wanted rotation; quaternions are w, x, y, z ---- */

static void quaternion(const double *R, double *q)
{
    double trace = R[0] + R[4] + R[8], largest = trace;
    int choice = 0;
    for (int i = 0; i < 3; i++)
        if (R[4 * i] > largest)
            largest = R[4 * i], choice = 1 + i;
    if (choice == 0) {
        q[0] = 1.0 + trace, q[1] = R[7] - R[5], q[2] = R[2] - R[6], q[3] = R[3] - R[1];
    } else {
        int i = choice - 1, j = (i + 1) % 3, k = (i + 2) % 3;
        q[0] = R[3 * k + j] - R[3 * j + k];
        q[1 + i] = 1.0 + R[4 * i] - R[4 * j] - R[4 * k];
        q[1 + j] = R[3 * j + i] + R[3 * i + j];
        q[1 + k] = R[3 * k + i] + R[3 * i + k];
    }
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    double divisor = q[0] >= 0.0 ? length : -length;
    for (int i = 0; i < 4; i++)
        q[i] /= divisor;
}

static void times(const double *a, const double *b, double *product)
{
    product[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    product[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    product[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    product[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

typedef struct {
    double left[4], right[4], pan_sign;
} Orientation;

static Orientation orientation(const Arm *arm, const double *R)
{
    Orientation fit = {.pan_sign = arm->pan_sign};
    double axes[4], turn[4], turned_by[9];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            turned_by[3 * i + k] = R[3 * i] * arm->R_base_tool[3 * k] +
                                   R[3 * i + 1] * arm->R_base_tool[3 * k + 1] +
                                   R[3 * i + 2] * arm->R_base_tool[3 * k + 2];
    quaternion(arm->R_base_axes, axes);
    quaternion(turned_by, turn);
    times(turn, axes, fit.right);
    fit.left[0] = axes[0];
    for (int i = 1; i < 4; i++)
        fit.left[i] = -axes[i];
    return fit;
}

static void remaining(const Orientation *fit, double pan, double *q)
{
    double half = -0.5 * fit->pan_sign * pan, about[4] = {cos(half), 0.0, 0.0, sin(half)}, first[4];
    times(fit->left, about, first);
    times(first, fit->right, q);
}

static double wanted_roll(const Orientation *fit, double pan)
{
    double q[4];
    remaining(fit, pan, q);
    return wrapped(atan2(q[1] + q[2], q[0] + q[3]) - atan2(q[2] - q[1], q[0] - q[3]));
}

static double roll_for(const Orientation *fit, double pan, double pitch)
{
    double q[4], c = cos(0.5 * pitch), s = sin(0.5 * pitch);
    remaining(fit, pan, q);
    return wrapped(2.0 * atan2(q[1] * c - q[3] * s, q[0] * c + q[2] * s));
}

static double pitch_for(const Orientation *fit, double pan, double roll)
{
    double q[4], c = cos(0.5 * roll), s = sin(0.5 * roll);
    remaining(fit, pan, q);
    return wrapped(2.0 * atan2(q[2] * c - q[3] * s, q[0] * c + q[1] * s));
}

static int settled(const Arm *arm, const Goal *goal, const Orientation *fit, Side side, double roll,
                   Configuration *found)
{
    bool back = side.back;
    for (int round = 0; round < ROUNDS; round++) {
        double wanted = clip_roll(arm, wanted_roll(fit, side.pan));
        if (fabs(wanted - roll) < SETTLED)
            return configurations(arm, side, pitch_for(fit, side.pan, roll), roll, found);
        roll = wanted;
        Side each[2];
        int n = sides(arm, goal->point, rolled(arm, roll), each), k = 0;
        while (k < n && each[k].back != back)
            k++;
        if (k == n)
            return 0;
        side = each[k];
    }
    return 0;
}

static int full_pose(const Arm *arm, const Goal *goal, Configuration *found)
{
    Orientation fit = orientation(arm, goal->R);
    double rolls[4];
    int n_rolls = approach_rolls(arm, goal, rolls), count = 0;
    if (n_rolls == 0)
        rolls[n_rolls++] = clip_roll(arm, goal->seed[4]);
    for (int i = 0; i < n_rolls; i++) {
        Side side[2];
        int n = sides(arm, goal->point, rolled(arm, rolls[i]), side);
        for (int k = 0; k < n; k++) {
            if (!arm->on_axis)
                count += configurations(arm, side[k], pitch_for(&fit, side[k].pan, rolls[i]),
                                        rolls[i], found + count);
            int more = settled(arm, goal, &fit, side[k], rolls[i], found + count);
            for (int j = count; arm->on_axis && j < count + more; j++) {
                double *q = found[j].q;
                q[4] = clip_roll(arm, roll_for(&fit, q[0], q[1] + q[2] + q[3]));
            }
            count += more;
        }
    }
    sort_by_distance(found, count, goal->seed);
    return count;
}

/* Writes configurations, at most MOST, the one nearest to the seed first; returns their number. For an
 * approach the seed's roll comes before all others, and what misses the approach last, for the error. */
int so101_ik_nearest(const Arm *arm, const Goal *goal, Configuration *found)
{
    if (goal->metric == POSITION_ONLY)
        return nearest_position(arm, goal, found);
    if (goal->metric == POSITION_AND_APPROACH)
        return nearest_approach(arm, goal, found);
    return full_pose(arm, goal, found);
}

/* Writes configurations spread over what the goal leaves free, in no order, at most MOST_SPREAD of
 * ik_closed.py; returns their number. */
int so101_ik_spread(const Arm *arm, const Goal *goal, Configuration *found)
{
    if (goal->metric == FULL_POSE)
        return full_pose(arm, goal, found);
    Configuration rest[2 * MOST];
    double rolls[ROLLS + 6] = {clip_roll(arm, goal->seed[4])};
    int n_rolls = 1, n_rest = 0, count = 0;
    if (goal->metric == POSITION_AND_APPROACH)
        n_rolls += approach_rolls(arm, goal, rolls + n_rolls);
    n_rolls += spread_rolls(arm, rolls + n_rolls);
    if (goal->metric == POSITION_AND_APPROACH)
        return approach(arm, goal, rolls, n_rolls, found, rest, &n_rest);
    for (int i = 0; i < n_rolls; i++) {
        Side side[2];
        int n = sides(arm, goal->point, rolled(arm, rolls[i]), side);
        for (int k = 0; k < n; k++) {
            Bend bend[MOST_BENDS];
            int more = so101_spread_bends(arm, side[k].target, bend);
            for (int j = 0; j < more; j++)
                found[count++] = configuration(side[k], bend[j], rolls[i]);
        }
    }
    return count;
}
