/* Declarations shared by apart.c and following_apart.c, which prove that two arms keep apart. */
#ifndef SO101_APART_H
#define SO101_APART_H

#include "native.h"

typedef struct {
    const Scene *scene;
    const double *q, *travel; /* configurations; bounds on each body's travel in each step [m] */
    Pose pose[JOINTS + 1];
    double centre[MOST_BODIES][3];
} Arm;

/* State of every pair of bodies; `low` and `lie` are 0 if not known. */
typedef struct {
    double due[MOST_BODIES][MOST_BODIES];    /* when it must be checked, in steps */
    double soon[MOST_BODIES][MOST_BODIES];   /* when it is checked if another pair must be */
    double low[MOST_BODIES][MOST_BODIES];    /* a lower bound on their distance at the start */
    double lie[MOST_BODIES][MOST_BODIES][3]; /* approximate vector from the second to the first */
} Known;

/* The course of an arm: `n` configurations from `t` on, `dt` apart; it rests before and after. */
typedef struct {
    double t, dt;
    int n;
    const double *q;
} Course;

/* Question, answer and memory of so101_following_apart; zeros before the first. The first fields are
 * laid out as in following_apart.py. */
typedef struct {
    const Scene *scene[2]; /* of both arms */
    const double *levers[2];
    double placement[12];
    Course course[2];
    double since, step, margin, skew, pushed, parting, within, gap;
    double told[4];      /* time and distance at which they meet, and the two bodies */
    double gained, near; /* the distance to keep now [m]; the number of rows */
    double row[MOST_NEAR][NEAR_ARM_ROW];
    double q[2][JOINTS]; /* the last configurations of both */
    Known known;
} Beside;

void so101_look(Arm *arm, const double *placement, int n, double t);
/* Like so101_gap, for bodies of two arms. */
double so101_between(const Arm *a, int i, const Arm *b, int j, double need, double enough, double *v,
                      double *along);
void so101_travelled(const Scene *s, const double *levers, int n, const double *q, double *travel);
int so101_known_apart(const Scene *a, const Scene *b, const double *placement,
                      const double *levers_a, const double *levers_b, int n, const double *qa,
                      const double *qb, double margin, double skew, Known *known, double *out);
void so101_course_at(const Course *c, double t, double *q);
double *so101_sampled(const Course *both, double since, double step, int *n);
#endif
