/* Declarations shared by all parts of the compiled planning library. Metres, radians, base frame.
 *
 * A configuration is six doubles: five joints and the jaw. "Touching" means that some pair of
 * bodies is within its margin. Verdicts are proofs: a direction along which two bodies are far
 * enough apart, or two points of them that are too near. If neither is found, the verdict is
 * "unknown", and the caller asks coal.
 */
#ifndef SO101_NATIVE_H
#define SO101_NATIVE_H

#include <stdint.h>

#define JOINTS 6
#define ARM_JOINTS 5 /* without the jaw */
#define MOST_ARMS 8  /* of a team */
#define MOST_JOINTS (MOST_ARMS * ARM_JOINTS)
#define MOST_AT_ONCE 64 /* configurations of a team */
#define MOST_BODIES 32  /* bits of a mask */
#define MOST_POINTS 512 /* of one body */
#define LANES 8         /* points that furthest.c compares at once */
#define NEAR_ROW 16     /* numbers of nearest.c for a pair */
#define BOUND 7         /* numbers of a bound of a step: five factors, the smallest value, the room */
#define NEAR_ARM_ROW 9  /* numbers for a body and one of another arm: a bound and the two bodies */
#define MOST_NEAR 24    /* most rows of these */

enum { FREE = 0, TOUCHING = 1, UNKNOWN = 2 };
enum { LATE = 1, STOPPED = 2 };

/* Two bounds must differ by this before they decide [m]: rounding in single precision (measured:
 * below 1e-6 for the arm) and coal's own tolerance of 1e-6. It grows with the coordinates. */
#define SLACK 3e-6f
#define SLACK_PER_METRE 5e-7f

/* A body that may move: the hull of points, widened by a radius. */
typedef struct {
    int joint; /* that carries it, 0 for the base */
    int first, count;
    double radius;
    float centre[3], ball;         /* a ball around a point inside the hull that holds the points */
    float box_centre[3], box_half[3]; /* a box that holds the points, along the joint's axes */
    float spine[2][3];                /* a line inside the hull, from end to end */
    const float *columns; /* the points' x, then y, then z; the last repeated up to `padded` */
    int padded;
} Body;

typedef struct {
    int first, second;
    int margin; /* which of the two margins holds for it: 0 between links, 1 else */
} Pair;

/* The form of obstacles, around an origin of their own but turned as the base. */
typedef struct {
    int first, count;
    double radius;
    float reach; /* the largest coordinate */
    float inside[3];          /* a point of it */
    float middle[3], half[3]; /* the box that holds it, radius and rounding included */
    float core[3];            /* half a box that it holds, 0 if it is no large box itself */
} Shape;

typedef struct {
    double at[3]; /* the shape's origin */
    int shape;
    int object;    /* the obstacle it is part of */
    uint32_t mask; /* the bodies that are checked against it */
} Piece;

/* A box that holds all pieces below; `count` of them from `first`, or two nodes at `first`. */
typedef struct {
    float middle[3], half[3];
    int first, count;
    int object; /* that all of them are part of; -1 if they are of several */
    uint32_t mask;
} Node;

/* Asks coal about one configuration, or (level -1) whether to go on. Returns FREE or TOUCHING;
 * from level -1: 0 go on, 1 the time is up, 2 end at once. */
typedef int (*Ask)(const double *q, int level);

typedef struct {
    double offset[JOINTS][12]; /* each joint in the one before: rotation by rows, translation */
    int bodies, pairs, nodes;
    Body body[MOST_BODIES];
    double *points; /* of bodies, in their joints' frames */
    float *points_f, *columns;
    Pair *pair;
    uint32_t with_floor;
    double floor_z;
    Shape *shape;
    double *shape_points;
    float *shape_points_f;
    Piece *piece;
    Node *node;
    int objects;
    double *nearest; /* room for what nearest.c finds, a row for each object */
    Ask ask;
    int late, stopped; /* the answers of ask(-1) */
    long looked_at, next_ask;
    long undecided; /* how often coal was asked */
} Scene;

/* A check: margins [m] between links and else, and what all pairs keep apart at least. */
typedef struct {
    double margin[2];
    double clearance;
    int id; /* for Ask; below 0 the undecided count as free */
} Level;

typedef struct {
    double R[9], p[3];
} Pose;

/* How an arm's lines are checked in its scene: at samples, or proven with all levels. */
typedef struct {
    Scene *scene;
    const Level *levels;
    int n_levels, proven;
    const double *reach;
    double spacing, q_jaw;
} Checker;

/* Two arms of a team, by number, and the arguments of so101_apart for them. */
typedef struct {
    int first, second;
    const Scene *a, *b;
    const double *levers_a, *levers_b;
    double placement[12];
} Couple;

/* Arms with all joints, five each, in one configuration, and the pairs of arms that must stay `room`
 * [m] apart. A single arm is a team, too. */
typedef struct {
    int arms, couples;
    const Checker *arm;
    const Couple *couple;
    double room;
} Team;

int so101_team_is_over(const Team *m); /* LATE, STOPPED, or 0 */
void so101_team_check(const Team *m, const double *q, int n, uint8_t *verdict);
int so101_team_is_apart(const Team *m, const double *q);
int so101_team_is_free(const Team *m, const double *q);
int so101_team_is_clear(const Team *m, const double *a, const double *b, int ends);

/* JOINTS + 1 poses. `placement`: pose of the base, rotation by rows, then translation; 0 for none. */
void so101_poses(const Scene *s, const double *q, const double *placement, Pose *pose);
/* `v`: approximate vector from the first to the second, as a start. */
int so101_exact_pair(const Scene *s, const Pose *pose, int pair, double margin, const double *v);
int so101_exact_piece(const Scene *s, const Pose *pose, int body, int piece, double margin,
                      const double *v);
int so101_exact_floor(const Scene *s, const Pose *pose, int body, double margin);

/* A lower bound on the distance of two bodies [m]: exact to TENTH below `need`, above it to a tenth of
 * the excess; above `enough` any value above it. `v`: approximate vector from the second to the first,
 * zero if not known; updated for the next time. `along`: a lower bound on their distance along v, minus
 * infinity if not known. */
double so101_gap(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                 int body_b, double need, double enough, double *v, double *along);

/* The same, exact to TENTH up to `enough`, and the point of the first that is nearest to the second,
 * not widened by its radius; v is from the second to the first then. */
double so101_gap_at(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                    int body_b, double enough, double *v, double *point);

/* A lower bound on the distance of two bodies along v, from the second to the first [m]; NaN if v is
 * zero. */
double so101_gap_along(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                       int body_b, const double *v);

/* The distance of two bodies without their radii, as a lower bound and as found [m], and their nearest
 * points; if `low` is above `enough`, only `low` is valid. A length of 0 may be wrong. */
typedef struct {
    double low, length, first[3], second[3];
} Closest;

Closest so101_closest_pair(const Scene *s, const Pose *pose, int pair, double enough);
Closest so101_closest_bodies(const Scene *a, const Pose *at_a, int body_a, const Scene *b,
                             const Pose *at_b, int body_b, double enough);
Closest so101_closest_piece(const Scene *s, const Pose *pose, int body, int piece, double enough);
void so101_lowest(const Scene *s, const Pose *pose, int body, double *at); /* its lowest point */
int so101_near_arm(const Scene *a, const Pose *at_a, const Scene *b, const Pose *at_b,
                   double low[MOST_BODIES][MOST_BODIES], double lie[MOST_BODIES][MOST_BODIES][3],
                   double within, double margin, double gap, double row[MOST_NEAR][NEAR_ARM_ROW]);

/* Checks n configurations. With `stop`, ends soon after the first that touches. Returns whether one
 * touches. There is one for each width of vectors; so101_lanes is the widest usable. */
typedef int (*Lanes)(const Scene *s, const double *q, int n, const double *margin, int stop,
                     uint8_t *verdict);
int so101_lanes_base(const Scene *, const double *, int, const double *, int, uint8_t *);
int so101_lanes_avx2(const Scene *, const double *, int, const double *, int, uint8_t *);
extern Lanes so101_lanes;

/* The number of the point that lies furthest along a direction. `columns`: their x, then y, then z, of
 * each as many as `padded`, a multiple of LANES. so101_furthest is the quickest usable. */
typedef int (*Furthest)(const float *columns, int padded, const float *along);
int so101_furthest_base(const float *, int, const float *);
int so101_furthest_avx2(const float *, int, const float *);
extern Furthest so101_furthest;

double so101_drawn(uint64_t *state); /* a random number from 0 to 1 */
int so101_check(Scene *s, const Level *level, const double *q, int n, int stop, uint8_t *verdict);
int so101_is_clear(Scene *s, const Level *level, const double *reach, double spacing,
                   const double *a, const double *b, double q_jaw, int ends);
int so101_first_blocked(Scene *s, const Level *levels, int n_levels, const double *reach,
                        const double *points, int n, double q_jaw, double *blocked);
int so101_apart(const Scene *a, const Scene *b, const double *placement, const double *levers_a,
                const double *levers_b, int n, const double *qa, const double *qb, double margin,
                double skew, double *out);
void so101_gaps(const Scene *a, const Scene *b, const double *placement, int n, const double *qa,
                const double *qb, double need, double enough, double *out);
#endif
