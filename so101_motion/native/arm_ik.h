/* Declarations shared by planar.c and arm_ik.c: an arm, and the closed forms of its parallel joints.
 *
 * Compile both without contraction of products and sums (-ffp-contract=off) and without
 * -ffast-math: if a comparison came out otherwise, another configuration would be chosen. */

#ifndef SO101_ARM_IK_H
#define SO101_ARM_IK_H

#include <math.h>
#include <stdbool.h>

#define TAU 6.283185307179586
#define JOINT_SLACK 1e-6 /* as in arm_geometry.py */
#define MOST_BENDS 128   /* for one target, spread over all pitches */

/* An arm and one frame of its gripper: `packed` in ik_closed.py writes it in this order. */
typedef struct {
    double pan_x, pan_y, pan_sign, azimuth, shoulder_x, shoulder_z;
    double a, elevation_a, b, elevation_b;
    double lower[5], upper[5];
    double forward[3], left[3], up[3];
    double longest, on_axis, approach_elevation;
    double R_base_tool[9], R_base_axes[9];
    /* `Bars.constants` of arm_geometry.py. */
    double straight, squares, twice, slack, cos_max, shortest[2]; /* elbow down, elbow up */
} Arm;

/* Target of the hand's end within the plane, from the shoulder, x forward and z up, and the hand. */
typedef struct {
    double x, z, hand, hand_elevation;
} Target;

typedef struct {
    double angles[3];
    bool elbow_up;
} Bend;

static inline double clipped(double value, double low, double high)
{
    value = value > low ? value : low;
    return value < high ? value : high;
}

/* remainder(angle, TAU); libm is slow at it, and within a turn and a half this is exact. */
static inline double wrapped(double angle)
{
    if (fabs(angle) <= 0.5 * TAU)
        return angle;
    if (fabs(angle) < 1.5 * TAU)
        return angle > 0.0 ? angle - TAU : angle + TAU;
    return remainder(angle, TAU);
}

/* The configurations whose pitch is nearest to a given one; returns how many, at most 2. */
int so101_nearest_pitch(const Arm *arm, Target target, double pitch, Bend *found);

/* Configurations at pitches no farther apart than PITCH_STEP; returns how many, at most MOST_BENDS. */
int so101_spread_bends(const Arm *arm, Target target, Bend *found);

/* The configuration nearest to `seed` (lift, elbow, wrist) over all pitches, if its squared
 * distance is below `*ceiling`, which it then becomes. */
bool so101_nearest_bend(const Arm *arm, Target target, const double *seed, double *ceiling,
                        Bend *best);

#endif
