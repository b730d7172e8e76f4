/* Closed-form inverse kinematics of the three parallel joints (a planar 3R chain).
 *
 * Upper arm, forearm and hand have hinges at shoulder, elbow and wrist; the end of the hand shall be at
 * a point. Three joints and two equations leave one freedom, the pitch of the hand. For a given pitch
 * the wrist is where the hand begins, and shoulder, elbow and wrist form a triangle with three known
 * sides, hence two configurations, elbow up and elbow down (`bends`).
 *
 * Which pitches are possible? The distance from shoulder to wrist depends only on the angle between the
 * hand and the line from shoulder to target, so the elbow's limits allow one or two bands of pitch.
 * Within them a configuration can cease to exist only where the lift or the wrist is at a limit, and
 * each of these fixes the lengths of a triangle too: at most eight pitches in closed form. Between two
 * of them nothing changes (`intervals_of`), so one test in the middle decides for the whole interval.
 * Whether a point can be reached is thus decided exactly, without a grid that might miss a narrow gap.
 *
 * Joint angles are positive downwards (they turn x towards -z), elevations upwards. The pitch is lift +
 * elbow + wrist; the hand has the elevation `hand_elevation - pitch`. */

#include "arm_ik.h"

#define TINY 1e-12       /* lengths below this are this [m], so that no direction is undefined */
#define NEARLY 1e-6      /* how far a cosine may exceed 1 by rounding; chosen */
#define INSIDE 1e-6      /* how far inside an interval its ends are tried, as a share of it; chosen */
#define PITCH_STEP 0.2   /* distance between alternative pitches [rad]; chosen: 11 degrees */
#define FLAT 1e-4

#define PI 3.141592653589793

static bool allows(const Arm *arm, const double *angles)
{
    for (int i = 0; i < 3; i++)
        if (!(arm->lower[1 + i] - JOINT_SLACK <= angles[i] &&
              angles[i] <= arm->upper[1 + i] + JOINT_SLACK))
            return false;
    return true;
}

static int bends(const Arm *arm, Target t, double pitch, Bend *found)
{
    double elevation = t.hand_elevation - pitch;
    double x = t.x - t.hand * cos(elevation), z = t.z - t.hand * sin(elevation);
    double cosine = (x * x + z * z - arm->squares) / arm->twice;
    if (!(-1.0 <= cosine && cosine <= arm->cos_max))
        return 0;
    double fold = cosine < 1.0 ? acos(cosine) : 0.0;
    double lean = atan2(arm->b * sin(fold), arm->a + arm->b * cosine);
    int count = 0;
    for (int down = 0; down < 2; down++) {
        if (down)
            fold = -fold, lean = -lean;
        double elbow = arm->straight + fold;
        double lift = wrapped(arm->elevation_a - atan2(z, x) - lean);
        Bend bend = {{lift, elbow, wrapped(pitch - lift - elbow)}, !down};
        if (allows(arm, bend.angles))
            found[count++] = bend;
    }
    return fold == 0.0 && count > 1 ? 1 : count;
}

typedef struct {
    double away, low, high;
    bool elbow_up;
} Interval;

#define MOST_INTERVALS 24 /* 2 bands, each cut at 8 pitches at most */

static int ordered(const Interval *p, const Interval *q)
{
    double differences[] = {p->away - q->away, p->low - q->low, p->high - q->high,
                            (double)(p->elbow_up - q->elbow_up)};
    for (int i = 0; i < 4; i++)
        if (differences[i] != 0.0)
            return differences[i] < 0.0;
    return 1;
}

static void sort_intervals(Interval *list, int count)
{
    for (int i = 1; i < count; i++) {
        Interval each = list[i];
        int k = i;
        for (; k > 0 && !ordered(&list[k - 1], &each); k--)
            list[k] = list[k - 1];
        list[k] = each;
    }
}

/* The bands the elbow's limits allow, as angles of the hand below the line to the target: the more the
 * hand is turned out of that line, to either side, the farther the wrist is from the shoulder. */
static int bands_of(const Arm *arm, Target t, bool elbow_up, double bands[2][2])
{
    double square = t.x * t.x + t.z * t.z + t.hand * t.hand;
    double away = hypot(t.x, t.z);
    double twice = 2.0 * (away > TINY ? away : TINY) * (t.hand > TINY ? t.hand : TINY);
    double bent = (square - arm->shortest[elbow_up]) / twice;
    double straight = (square - arm->squares - arm->twice) / twice;
    if (bent < -1.0 - NEARLY || straight > 1.0 + arm->slack / twice)
        return 0;
    double inner = bent < 1.0 ? acos(bent > -1.0 ? bent : -1.0) : 0.0;
    double outer = straight <= -1.0 ? PI : acos(straight < 1.0 ? straight : 1.0);
    if (inner == 0.0) {
        bands[0][0] = -outer, bands[0][1] = outer;
        return 1;
    }
    if (outer == PI) {
        bands[0][0] = inner, bands[0][1] = TAU - inner;
        return 1;
    }
    bands[0][0] = inner, bands[0][1] = outer;
    bands[1][0] = -outer, bands[1][1] = -inner;
    return 2;
}

/* The angles that split the bands of a target, for both bends of the elbow. */
typedef struct {
    int count; /* -1: not computed yet */
    double at[8], aligned;
} Splits;

static void compute_splits(const Arm *arm, Target t, Splits *splits)
{
    double hand = t.hand > TINY ? t.hand : TINY, distance = hypot(t.x, t.z);
    double *found = splits->at;
    distance = distance > TINY ? distance : TINY;
    double elevation = atan2(t.z, t.x);
    int count = 0;
    for (int k = 0; k < 2; k++) {
        double limit = k ? arm->upper[3] : arm->lower[3];
        double bend = t.hand_elevation - arm->elevation_b - limit;
        double outer_x = arm->b + hand * cos(bend), outer_z = hand * sin(bend);
        double outer = hypot(outer_x, outer_z);
        outer = outer > TINY ? outer : TINY;
        double cosine = (distance * distance + outer * outer - arm->a * arm->a) /
                        (2.0 * distance * outer);
        if (-1.0 < cosine && cosine < 1.0) {
            double angle = acos(cosine), middle = atan2(outer_z, outer_x) - bend;
            found[count++] = middle - angle;
            found[count++] = middle + angle;
        }
    }
    for (int k = 0; k < 2; k++) {
        double lift = k ? arm->upper[1] : arm->lower[1];
        double dx = t.x - arm->a * cos(arm->elevation_a - lift);
        double dz = t.z - arm->a * sin(arm->elevation_a - lift);
        double d = hypot(dx, dz);
        d = d > TINY ? d : TINY;
        double cosine = (d * d + hand * hand - arm->b * arm->b) / (2.0 * d * hand);
        if (-1.0 < cosine && cosine < 1.0) {
            double angle = acos(cosine), middle = elevation - atan2(dz, dx);
            found[count++] = middle - angle;
            found[count++] = middle + angle;
        }
    }
    splits->count = count;
    splits->aligned = t.hand_elevation - elevation;
}

/* Python's %: between 0 and TAU whatever the sign. */
static double turned(double angle)
{
    if (0.0 <= angle && angle < TAU)
        return angle;
    double rest = fmod(angle, TAU);
    return rest < 0.0 ? rest + TAU : rest;
}

/* Intervals of pitch within which no configuration appears or vanishes, nearest first. Their ends may
 * lie beyond PI. Pitches that the elbow forbids are in none. */
static int intervals_of(const Arm *arm, Target t, double pitch, bool elbow_up, Splits *splits,
                        Interval *found)
{
    double bands[2][2];
    int n_bands = bands_of(arm, t, elbow_up, bands), count = 0;
    if (n_bands == 0)
        return 0;
    if (splits->count < 0)
        compute_splits(arm, t, splits);
    double aligned = splits->aligned, home = pitch - aligned;
    for (int i = 0; i < n_bands; i++) {
        double low = bands[i][0], high = bands[i][1], ends[9] = {high};
        int n_ends = 1;
        for (int k = 0; k < splits->count; k++) {
            double inside = turned(splits->at[k] - low) + low;
            if (inside < high) {
                int j = n_ends++;
                for (; j > 0 && ends[j - 1] > inside; j--)
                    ends[j] = ends[j - 1];
                ends[j] = inside;
            }
        }
        for (int k = 0; k < n_ends; k++) {
            double end = ends[k];
            double away = fabs(wrapped(home - 0.5 * (low + end))) - 0.5 * (end - low);
            away = away > 0.0 ? rint(away * 1e9) * 1e-9 : 0.0;
            found[count++] = (Interval){away, aligned + low, aligned + end, elbow_up};
            low = end;
        }
    }
    sort_intervals(found, count);
    return count;
}

int so101_nearest_pitch(const Arm *arm, Target t, double pitch, Bend *found)
{
    int count = bends(arm, t, pitch, found);
    if (count)
        return count;
    Interval all[2 * MOST_INTERVALS];
    Splits splits = {.count = -1};
    int n = intervals_of(arm, t, pitch, true, &splits, all);
    n += intervals_of(arm, t, pitch, false, &splits, all + n);
    sort_intervals(all, n);
    for (int i = 0; i < n; i++) {
        double middle = 0.5 * (all[i].low + all[i].high);
        count = bends(arm, t, middle, found);
        for (int k = 0; k < count; k++)
            if (found[k].elbow_up == all[i].elbow_up) {
                double half = (0.5 - INSIDE) * (all[i].high - all[i].low);
                double ahead = wrapped(pitch - middle);
                ahead = ahead > -half ? ahead : -half;
                return bends(arm, t, middle + (ahead < half ? ahead : half), found);
            }
    }
    return 0;
}

int so101_spread_bends(const Arm *arm, Target t, Bend *found)
{
    Splits splits = {.count = -1};
    int count = 0;
    for (int down = 0; down < 2; down++) {
        Interval all[MOST_INTERVALS];
        int n = intervals_of(arm, t, 0.0, !down, &splits, all);
        for (int i = 0; i < n; i++) {
            double low = all[i].low, wide = all[i].high - low;
            int parts = (int)(wide / PITCH_STEP) + 1;
            for (int k = 0; k < parts; k++) {
                Bend each[2];
                int more = bends(arm, t, low + wide * (k + 0.5) / parts, each);
                for (int j = 0; j < more; j++)
                    if (each[j].elbow_up == !down)
                        found[count++] = each[j];
            }
        }
    }
    return count;
}

/* ---- Nearest to the seed over all pitches ---- */

typedef struct {
    double slope, square, pitch, angles[3];
} Sample;

static Sample look(const Arm *arm, Target t, const double *seed, double pitch, bool elbow_up)
{
    Sample nowhere = {0.0, INFINITY, pitch, {NAN, NAN, NAN}};
    double elevation = t.hand_elevation - pitch;
    double hand_x = t.hand * cos(elevation), hand_z = t.hand * sin(elevation);
    double wrist_x = t.x - hand_x, wrist_z = t.z - hand_z;
    double cosine = (wrist_x * wrist_x + wrist_z * wrist_z - arm->squares) / arm->twice;
    if (!(-1.0 <= cosine && cosine <= arm->cos_max))
        return nowhere;
    double fold = cosine < 1.0 ? acos(cosine) : 0.0;
    if (!elbow_up)
        fold = -fold;
    double q_elbow = arm->straight + fold;
    double lean = atan2(arm->b * sin(fold), arm->a + arm->b * cosine);
    double q_lift = wrapped(arm->elevation_a - atan2(wrist_z, wrist_x) - lean);
    Sample here = {0.0, 0.0, pitch, {q_lift, q_elbow, wrapped(pitch - q_lift - q_elbow)}};
    if (!allows(arm, here.angles))
        return nowhere;
    elevation = arm->elevation_b - q_lift - q_elbow;
    double outer_x = arm->b * cos(elevation) + hand_x, outer_z = arm->b * sin(elevation) + hand_z;
    double rates[3] = {outer_x * hand_z - outer_z * hand_x, hand_x * t.z - hand_z * t.x,
                       t.x * outer_z - t.z * outer_x};
    double total = rates[0] + rates[1] + rates[2], along = 0.0;
    for (int i = 0; i < 3; i++) {
        double off = here.angles[i] - seed[i];
        along += off * rates[i];
        here.square += off * off;
    }
    here.slope = total != 0.0 ? along / total : 0.0;
    return here;
}

static Sample descend(const Arm *arm, Target t, const double *seed, bool elbow_up, Sample start,
                      double low, double high)
{
    if (start.slope == 0.0)
        return start;
    double near = start.pitch;
    Sample end = look(arm, t, seed, start.slope > 0.0 ? low : high, elbow_up);
    while (start.slope * end.slope >= 0.0) {
        if (end.square <= start.square)
            return end;
        end = look(arm, t, seed, 0.5 * (near + end.pitch), elbow_up);
    }
    double far = end.pitch, last_slope = start.slope, last = near;
    double pitch = near - start.slope * (far - near) / (end.slope - start.slope);
    for (;;) {
        Sample place = look(arm, t, seed, pitch, elbow_up);
        if (place.slope * start.slope > 0.0)
            near = pitch;
        else
            far = pitch;
        double change = place.slope - last_slope;
        double step = change != 0.0 ? place.slope * (last - pitch) / change : 0.0;
        if (fabs(step) < FLAT || fabs(far - near) < FLAT)
            return place;
        last_slope = place.slope, last = pitch;
        pitch += step;
        if (!(fmin(near, far) < pitch && pitch < fmax(near, far)))
            pitch = 0.5 * (near + far);
    }
}

bool so101_nearest_bend(const Arm *arm, Target t, const double *seed, double *ceiling, Bend *best)
{
    double home = seed[0] + seed[1] + seed[2];
    bool found = false;
    Splits splits = {.count = -1};
    for (int down = 0; down < 2; down++) {
        bool elbow_up = !down;
        double gap = elbow_up ? arm->straight - seed[1] : seed[1] - arm->straight;
        if (gap > 0.0 && gap * gap >= *ceiling)
            continue;
        Interval all[MOST_INTERVALS];
        int n = intervals_of(arm, t, home, elbow_up, &splits, all);
        for (int i = 0; i < n && all[i].away * all[i].away < 3.0 * *ceiling; i++) {
            double low = all[i].low, high = all[i].high;
            double pitch = 0.5 * (low + high), margin = INSIDE * (high - low);
            low += margin, high -= margin;
            if (all[i].away == 0.0)
                pitch = clipped(pitch + wrapped(home - pitch), low, high);
            Sample start = look(arm, t, seed, pitch, elbow_up);
            if (start.square < INFINITY) {
                Sample end = descend(arm, t, seed, elbow_up, start, low, high);
                if (end.square < *ceiling) {
                    *best = (Bend){{end.angles[0], end.angles[1], end.angles[2]}, elbow_up};
                    *ceiling = end.square;
                    found = true;
                }
            }
        }
    }
    return found;
}
