/* What is shared by the proofs that two arms keep apart: apart.c and led_apart.c. */
#ifndef SO101_APART_H
#define SO101_APART_H

#include "native.h"

typedef struct {
    const Scene *scene;
    const double *q, *travel; /* configurations; what each body travels in each step at most [m], */
    const double *bend;       /* and how far it leaves the straight line between */
    Pose pose[JOINTS + 1];
    double centre[MOST_BODIES][3];
} Arm;

/* What is known of every two bodies; of `low` and `lie` nothing if they are 0. */
typedef struct {
    double due[MOST_BODIES][MOST_BODIES];    /* when they must be looked at, in steps */
    double soon[MOST_BODIES][MOST_BODIES];   /* when they are if others must be */
    double low[MOST_BODIES][MOST_BODIES];    /* how far apart they are at least in the beginning */
    double lie[MOST_BODIES][MOST_BODIES][3]; /* about how the first lies from the second */
} Known;

/* What an arm will do: `n` configurations from `t` on, `dt` apart; it rests before and after. */
typedef struct {
    double t, dt;
    int n;
    const double *q;
} Course;

/* What is asked of an arm that is led beside another one, what is answered, and what is left of the last
 * proof; zeros before the first. See Beside in led_apart.py, which has the same in front. */
typedef struct {
    const Scene *scene[2]; /* of both arms */
    const double *levers[2];
    double placement[12];
    Course course[2];
    double since, step, margin, skew, pushed, parting, within, gap;
    double told[4];      /* when and how near they meet, and which bodies */
    double gained, near; /* how far they keep apart now [m]; how many rows there are */
    double row[MOST_NEAR][NEAR_ARM_ROW];
    double q[2][JOINTS]; /* where both were */
    Known known;
} Beside;

void so101_look(Arm *arm, const double *placement, int n, double t);
/* As so101_gap, of bodies of two arms. */
double so101_between(const Arm *a, int i, const Arm *b, int j, double need, double enough, double *v,
                      double *along);
void so101_travelled(const Scene *s, const double *levers, int n, const double *q, double *travel,
                     double *bend);
int so101_known_apart(const Scene *a, const Scene *b, const double *placement,
                      const double *levers_a, const double *levers_b, int n, const double *qa,
                      const double *qb, double margin, double skew, Known *known, double *out);
void so101_course_at(const Course *c, double t, double *q);
double *so101_sampled(const Course *both, double since, double step, int *n);
#endif
