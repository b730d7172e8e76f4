/* Searches for a collision-free path, and shortens it.
 *
 * RRT-Connect: one tree has its root at the start, the other one root at each goal. A tree grows by a
 * branch of limited length from its nearest node towards a random configuration; the other tree then
 * follows greedily to the new node, as far as it gets. The smaller tree goes next until it has caught
 * up: if one end is deep in a narrow place, nearly all tries on its side fail, and they are needed.
 *
 * Shortening has three methods. Skipping: the path is cut into short pieces, and straight lines past
 * many of them are tried, then past half as many, and so on; that removes the zigzag of a random
 * search. Cutting from one random point of the path to another removes wide curves. Pulling moves each
 * corner towards the line between its neighbours, like pulling a rope tight.
 *
 * Sources: J. J. Kuffner, S. M. LaValle, RRT-Connect: An Efficient Approach to Single-Query Path
 * Planning, ICRA 2000. R. Geraerts, M. H. Overmars, Creating High-quality Paths for Motion Planning,
 * IJRR 2007, for cuts between random points.
 *
 * The same request and seed give the same path on every machine: all arithmetic is in double
 * precision or plain single precision and never contracted, and verdicts do not depend on the
 * processor.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

#define STEP 0.20  /* longest branch of a tree, as weighted distance [m]; chosen by bench_plan */
#define TRIES 16   /* random configurations at a time; chosen, as wide as vectors get */
#define AS_LONG 512 /* nodes that take as long to compare as a configuration to check */
/* Chosen by resulting length and time in bench_plan: */
#define PIECE 0.25 /* longest piece that is skipped or kept as a whole [rad] */
#define CUTS 60    /* random cuts that are tried; fewer after so many in a row without gain: */
#define MOST_FAILED_CUTS 14
#define GAIN 0.005 /* a cut that saves less than this share of the path is not checked */

typedef struct {
    double *points; /* each has `joints` numbers */
    float *weighted[MOST_JOINTS];
    int *parents;
    int count, room, roots;
} Tree;

typedef struct {
    int joints;
    double lower[MOST_JOINTS], upper[MOST_JOINTS], weights[MOST_JOINTS];
    Tree tree[2]; /* from the start, from the goals */
    uint64_t random;
    double *path;
    int length, goal;
} Search;

/* Sebastiano Vigna's splitmix64, as a number in [0, 1). */
double so101_drawn(uint64_t *state) {
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

/* The index of a new node, -1 without memory. */
static int add(const Search *h, Tree *t, const double *q, int parent) {
    if (t->count == t->room) {
        const int room = t->room ? 2 * t->room : 256;
        double *points = realloc(t->points, h->joints * (size_t)room * sizeof *points);
        if (points) t->points = points;
        int *parents = realloc(t->parents, (size_t)room * sizeof *parents);
        if (parents) t->parents = parents;
        int all = points && parents;
        for (int j = 0; j < h->joints; j++) {
            float *one = realloc(t->weighted[j], (size_t)room * sizeof *one);
            if (one) t->weighted[j] = one;
            all = all && one;
        }
        if (!all) return -1;
        t->room = room;
    }
    memcpy(t->points + h->joints * t->count, q, h->joints * sizeof *q);
    for (int j = 0; j < h->joints; j++) t->weighted[j][t->count] = (float)(q[j] * h->weights[j]);
    t->parents[t->count] = parent;
    return t->count++;
}

static double distance(const Search *h, const double *a, const double *b) {
    double square = 0.0;
    for (int j = 0; j < h->joints; j++) {
        const double d = (a[j] - b[j]) * h->weights[j];
        square += d * d;
    }
    return sqrt(square);
}

static int nearest(const Team *m, const Search *h, const Tree *t, const double *q) {
    float at[MOST_JOINTS], least = INFINITY, squares[64];
    int found = 0;
    m->arm->scene->next_ask -= t->count / AS_LONG; /* a search that finds nothing has large trees */
    for (int j = 0; j < h->joints; j++) at[j] = (float)(q[j] * h->weights[j]);
    for (int i = 0; i < t->count; i += 64) {
        const int n = t->count - i < 64 ? t->count - i : 64;
        for (int k = 0; k < n; k++) squares[k] = 0.0f;
        for (int j = 0; j < h->joints; j++) {
            const float *w = t->weighted[j] + i;
            for (int k = 0; k < n; k++) squares[k] += (w[k] - at[j]) * (w[k] - at[j]);
        }
        for (int k = 0; k < n; k++)
            if (squares[k] < least) least = squares[k], found = i + k;
    }
    return found;
}

/* Tries some branches towards random configurations; the new node, -1 if none, -2 if stopped. */
static int grow(const Team *m, Search *h, Tree *t) {
    double ends[TRIES * MOST_JOINTS];
    int parents[TRIES];
    uint8_t verdict[TRIES];
    for (int i = 0; i < TRIES; i++) {
        double q[MOST_JOINTS];
        for (int j = 0; j < h->joints; j++)
            q[j] = h->lower[j] + (h->upper[j] - h->lower[j]) * so101_drawn(&h->random);
        parents[i] = nearest(m, h, t, q);
        const double *origin = t->points + h->joints * parents[i];
        const double part = STEP / fmax(distance(h, q, origin), STEP);
        for (int j = 0; j < h->joints; j++)
            ends[h->joints * i + j] = origin[j] + part * (q[j] - origin[j]);
    }
    so101_team_check(m, ends, TRIES, verdict);
    for (int i = 0; i < TRIES; i++) {
        const double *end = ends + h->joints * i;
        if (so101_team_is_over(m) == STOPPED) return -2;
        if (verdict[i] != FREE || !so101_team_is_apart(m, end)) continue;
        if (so101_team_is_clear(m, t->points + h->joints * parents[i], end, 0)) {
            const int node = add(h, t, end, parents[i]);
            return node < 0 ? -2 : node;
        }
    }
    return -1;
}

/* Grows towards a configuration: the last node if it was reached, -1 if not, -2 if stopped. */
static int follow(const Team *m, Search *h, Tree *t, const double *target) {
    int parent = nearest(m, h, t, target), is_clear = 1;
    const size_t size = h->joints * sizeof *target;
    double q[MOST_JOINTS], origin[MOST_JOINTS], left;
    memcpy(origin, t->points + h->joints * parent, size);
    for (left = distance(h, target, origin); is_clear && left > STEP; left -= STEP) {
        for (int j = 0; j < h->joints; j++)
            q[j] = origin[j] + (target[j] - origin[j]) * (STEP / left);
        is_clear = so101_team_is_clear(m, origin, q, 1);
        if (is_clear && (parent = add(h, t, q, parent)) < 0) return -2;
        memcpy(origin, q, size);
    }
    if (is_clear && so101_team_is_clear(m, origin, target, 0)) return parent;
    return so101_team_is_over(m) == STOPPED ? -2 : -1;
}

static int joined(Search *h, int first, int second) {
    int n = 0, k;
    const Tree *a = &h->tree[0], *b = &h->tree[1];
    for (k = first; k >= 0; k = a->parents[k]) n++;
    const int before = n;
    for (k = second; k >= 0; k = b->parents[k]) n++, h->goal = k;
    free(h->path);
    h->path = malloc(h->joints * (size_t)n * sizeof *h->path);
    if (!h->path) return -1;
    h->length = n;
    n = before;
    for (k = first; k >= 0; k = a->parents[k])
        memcpy(h->path + h->joints * --n, a->points + h->joints * k, h->joints * sizeof *h->path);
    n = before;
    for (k = second; k >= 0; k = b->parents[k])
        memcpy(h->path + h->joints * n++, b->points + h->joints * k, h->joints * sizeof *h->path);
    return 1;
}

void so101_search_free(Search *h) {
    if (!h) return;
    for (int k = 0; k < 2; k++) {
        free(h->tree[k].points), free(h->tree[k].parents);
        for (int j = 0; j < h->joints; j++) free(h->tree[k].weighted[j]);
    }
    free(h->path), free(h);
}

/* `joints`: the number of joints of all arms of a team. */
Search *so101_search_new(int joints, const double *lower, const double *upper,
                         const double *weights, const double *start, const double *goals, int n,
                         uint64_t seed) {
    Search *h = calloc(1, sizeof *h);
    if (!h) return 0;
    h->joints = joints;
    memcpy(h->lower, lower, joints * sizeof *lower);
    memcpy(h->upper, upper, joints * sizeof *upper);
    memcpy(h->weights, weights, joints * sizeof *weights);
    h->random = seed;
    int failed = add(h, &h->tree[0], start, -1) < 0;
    for (int k = 0; k < n; k++) failed |= add(h, &h->tree[1], goals + joints * k, -1) < 0;
    h->tree[0].roots = 1, h->tree[1].roots = n;
    if (!failed) return h;
    so101_search_free(h);
    return 0;
}

/* At most `most` rounds, any number for 0. Returns the number of waypoints for so101_search_path, 0 if
 * no path was found in time, -1 if stopped or without memory. */
int so101_search_run(const Team *m, Search *h, int most) {
    Tree *here = &h->tree[0], *there = &h->tree[1];
    for (int round = 0; most == 0 || round < most; round++) {
        if (so101_team_is_over(m)) break;
        const int node = grow(m, h, here);
        if (node == -2) break;
        if (node < 0) continue;
        const int met = follow(m, h, there, here->points + h->joints * node);
        if (met == -2) break;
        if (met >= 0) {
            const int is_first = here == &h->tree[0];
            return joined(h, is_first ? node : met, is_first ? met : node) < 0 ? -1 : h->length;
        }
        if (here->count - here->roots > there->count - there->roots) {
            Tree *t = here;
            here = there, there = t;
        }
    }
    const int over = so101_team_is_over(m);
    return over == LATE || (most && over != STOPPED) ? 0 : -1;
}

/* Copies the waypoints; returns the index of the goal they lead to. */
int so101_search_path(const Search *h, double *points) {
    memcpy(points, h->path, h->joints * (size_t)h->length * sizeof *points);
    return h->goal;
}

/* Returns the number of nodes of a tree; copies them if arrays are given. */
int so101_search_tree(const Search *h, int which, double *points, int *parents) {
    const Tree *t = &h->tree[which];
    if (points) memcpy(points, t->points, h->joints * (size_t)t->count * sizeof *points);
    if (parents) memcpy(parents, t->parents, (size_t)t->count * sizeof *parents);
    return t->count;
}

/* Shortening. A path is an array of points of d joints; lengths are in joint angles. Points on its lines
 * have not been checked themselves, so the ends of lines are checked here. */

static double apart(const double *a, const double *b, int d) {
    double square = 0.0;
    for (int j = 0; j < d; j++) square += (a[j] - b[j]) * (a[j] - b[j]);
    return sqrt(square);
}

static void between(const double *a, const double *b, int d, double part, double *out) {
    for (int j = 0; j < d; j++) out[j] = a[j] + part * (b[j] - a[j]);
}

static int skipped(const Team *m, double *p, int n) {
    const int d = ARM_JOINTS * m->arms;
    int stride = n - 1;
    while (stride >= 2) {
        for (int k = 0; k + stride < n;) {
            if (so101_team_is_clear(m, p + d * k, p + d * (k + stride), 2)) {
                memmove(p + d * (k + 1), p + d * (k + stride),
                        d * (size_t)(n - k - stride) * sizeof *p);
                n -= stride - 1;
                k++;
            } else {
                k += stride / 2 > 1 ? stride / 2 : 1;
            }
        }
        stride = (stride < n - 1 ? stride : n - 1) / 2;
    }
    return n;
}

/* `end[i]`: the length of the path up to corner i. */
static void measure(const double *p, int n, int d, double *end) {
    end[0] = 0.0;
    for (int i = 1; i < n; i++) end[i] = end[i - 1] + apart(p + d * (i - 1), p + d * i, d);
}

static int after(const double *end, int n, double length) {
    int i = 0;
    while (i < n && end[i] <= length) i++;
    return i < n - 1 ? i : n - 1;
}

/* The point after some length, which lies before corner i. */
static void at(const double *p, const double *end, int i, int d, double length,
               double *out) {
    const double piece = end[i] - end[i - 1];
    const double part = piece > 0.0 ? (length - end[i - 1]) / piece : 0.0;
    between(p + d * (i - 1), p + d * i, d, part, out);
}

/* `p` and `end` must have room for CUTS more points. */
static int cut(const Team *m, double *p, int n, double *end, uint64_t *random) {
    const int d = ARM_JOINTS * m->arms;
    measure(p, n, d, end);
    for (int k = 0, failed = 0; k < CUTS; k++) {
        if (n == 2 || failed == MOST_FAILED_CUTS || so101_team_is_over(m)) break;
        const double x = so101_drawn(random), y = so101_drawn(random), total = end[n - 1];
        const double first = fmin(x, y) * total, last = fmax(x, y) * total;
        const int i = after(end, n, first), j = after(end, n, last);
        failed++;
        if (i == j) continue;
        double a[MOST_JOINTS], b[MOST_JOINTS];
        at(p, end, i, d, first, a);
        at(p, end, j, d, last, b);
        if (last - first - apart(a, b, d) < GAIN * total) continue;
        if (!so101_team_is_clear(m, a, b, 2)) continue;
        memmove(p + d * (i + 2), p + d * j, d * (size_t)(n - j) * sizeof *p);
        memcpy(p + d * i, a, d * sizeof *a);
        memcpy(p + d * (i + 1), b, d * sizeof *b);
        n += i + 2 - j;
        measure(p, n, d, end);
        failed = 0;
    }
    return n;
}

static int pulled(const Team *m, double *p, int n) {
    const int d = ARM_JOINTS * m->arms;
    for (int k = 1; k < n - 1;) {
        const double *before = p + d * (k - 1), *behind = p + d * (k + 1);
        double *corner = p + d * k, target[MOST_JOINTS], nearer[MOST_JOINTS];
        double along = 0.0, square = 0.0;
        for (int j = 0; j < d; j++) {
            along += (corner[j] - before[j]) * (behind[j] - before[j]);
            square += (behind[j] - before[j]) * (behind[j] - before[j]);
        }
        between(before, behind, d, fmin(fmax(along / fmax(square, 1e-12), 0.0), 1.0), target);
        if (so101_team_is_clear(m, before, behind, 0)) {
            memmove(corner, behind, d * (size_t)(n - k - 1) * sizeof *p);
            n--;
            continue;
        }
        for (double share = 0.5; share >= 0.25; share *= 0.5) {
            between(corner, target, d, share, nearer);
            if (so101_team_is_free(m, nearer) && so101_team_is_clear(m, before, nearer, 0) &&
                so101_team_is_clear(m, nearer, behind, 0)) {
                memcpy(corner, nearer, d * sizeof *nearer);
                break;
            }
        }
        k++;
    }
    return n;
}

/* Shortens n points into `out`, which has room for `room` points. Returns their number, 0 if that is too
 * little room, -1 if stopped or without memory. With `only_skip`, only by skipping points. */
int so101_shorten(const Team *m, const double *points, int n, double *out, int room, uint64_t seed,
                  int only_skip) {
    const int d = ARM_JOINTS * m->arms;
    int count = 0;
    for (int i = 0; i < n; i++) {
        const double *before = points + d * (i ? i - 1 : 0), *here = points + d * i;
        const int pieces = (int)fmax(1.0, ceil(apart(before, here, d) / PIECE));
        if (count + pieces + CUTS > room) return 0;
        for (int k = 1; k < pieces; k++)
            between(before, here, d, (double)k / pieces, out + d * count++);
        memcpy(out + d * count++, here, d * sizeof *out);
    }
    double *end = malloc((size_t)room * sizeof *end);
    if (!end) return -1;
    count = skipped(m, out, count);
    if (!only_skip) {
        count = cut(m, out, count, end, &seed);
        if (so101_team_is_over(m) != LATE) count = pulled(m, out, count);
    }
    free(end);
    return so101_team_is_over(m) == STOPPED ? -1 : count;
}
