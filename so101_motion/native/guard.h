/* Declarations of guard.c. */
#ifndef SO101_GUARD_H
#define SO101_GUARD_H

#include "native.h"

#define ROUNDING 1e-9 /* of a bound, as in within.c */

enum { BORNE = 1, CLEAR = 2 };

/* As _Seen in guard.py. */
typedef struct {
    const Scene *scene;
    const double *margin, *pair_of, *load; /* as in nearest.c; as in guard.c, or 0 */
    double *near, *bound, *room; /* what was found: rows and bounds of nearest.c, at most `most`; room for rows */
    double within, widest, bend, nearly, fast, inexact, ahead, share, step, closer, reach[ARM_JOINTS];
    double q[JOINTS], target[ARM_JOINTS];  /* where it looks; where a step is to lead */
    double free, extra;                    /* how far everything may travel from there [m]; of the last path */
    int most, places, sees_enough, seen, is_heavy, is_kept, is_undecided;
} Guard;

int so101_guard_look(Guard *g, double gap, int given);
int so101_guard_proves(Guard *g, const double *q, const double *path, int n, int ahead);
int so101_nearest(const Scene *s, const double *q, double within, int most, double *out);
int so101_near_bounds(const Scene *s, const double *q, double within, int most, double *near,
                      const double *margin, const double *pair_of, double gap, double *bound);
#endif
