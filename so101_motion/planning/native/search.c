/* RRT-Connect and shortening: what rrt_connect.py and shorten.py do, compiled, with the same names.
 *
 * The same request and seed give the same path on every machine: all arithmetic is in double
 * precision or plain single precision and never contracted, and verdicts do not depend on the
 * processor.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

#define STEP 0.20  /* as in rrt_connect.py */
#define TRIES 16   /* random configurations at a time; chosen, as wide as vectors get */
#define AS_LONG 512 /* nodes that take as long to compare as a configuration to look at */
#define PIECE 0.25 /* as in shorten.py, and what follows */
#define CUTS 60
#define MOST_FAILED_CUTS 14
#define GAIN 0.005

/* How lines are looked at: sampled, or proven with all levels. */
typedef struct {
    const Level *levels;
    int n_levels, proven;
    const double *reach;
    double spacing, q_jaw;
} Checker;

typedef struct {
    double *points; /* of 5 */
    float *weighted[5];
    int *parents;
    int count, room, roots;
} Tree;

typedef struct {
    double lower[5], upper[5], weights[5];
    Tree tree[2]; /* from the start, from the goals */
    uint64_t random;
    double *path;
    int length, goal;
} Search;

/* Sebastiano Vigna's splitmix64, as a number in [0, 1). */
static double drawn(uint64_t *state) {
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

static int is_clear(Scene *s, const Checker *c, const double *a, const double *b, int ends) {
    if (c->proven) {
        double line[10], blocked[5];
        memcpy(line, a, sizeof blocked);
        memcpy(line + 5, b, sizeof blocked);
        return so101_first_blocked(s, c->levels, c->n_levels, c->reach, line, 2, c->q_jaw,
                                   blocked) == FREE;
    }
    return so101_is_clear(s, c->levels, c->reach, c->spacing, a, b, c->q_jaw, ends);
}

static int is_free(Scene *s, const Checker *c, const double *q) {
    double full[6];
    uint8_t verdict;
    memcpy(full, q, 5 * sizeof *q);
    full[5] = c->q_jaw;
    return !so101_check(s, c->levels, full, 1, 0, &verdict);
}

/* The index of a new node, -1 without memory. */
static int add(const Search *h, Tree *t, const double *q, int parent) {
    if (t->count == t->room) {
        const int room = t->room ? 2 * t->room : 256;
        double *points = realloc(t->points, 5 * (size_t)room * sizeof *points);
        if (points) t->points = points;
        int *parents = realloc(t->parents, (size_t)room * sizeof *parents);
        if (parents) t->parents = parents;
        int all = points && parents;
        for (int j = 0; j < 5; j++) {
            float *one = realloc(t->weighted[j], (size_t)room * sizeof *one);
            if (one) t->weighted[j] = one;
            all = all && one;
        }
        if (!all) return -1;
        t->room = room;
    }
    memcpy(t->points + 5 * t->count, q, 5 * sizeof *q);
    for (int j = 0; j < 5; j++) t->weighted[j][t->count] = (float)(q[j] * h->weights[j]);
    t->parents[t->count] = parent;
    return t->count++;
}

static double distance(const Search *h, const double *a, const double *b) {
    double square = 0.0;
    for (int j = 0; j < 5; j++) {
        const double d = (a[j] - b[j]) * h->weights[j];
        square += d * d;
    }
    return sqrt(square);
}

static int nearest(Scene *s, const Search *h, const Tree *t, const double *q) {
    float at[5], least = INFINITY, squares[64];
    int found = 0;
    s->next_ask -= t->count / AS_LONG; /* a search that finds nothing has large trees */
    for (int j = 0; j < 5; j++) at[j] = (float)(q[j] * h->weights[j]);
    for (int i = 0; i < t->count; i += 64) {
        const int m = t->count - i < 64 ? t->count - i : 64;
        for (int k = 0; k < m; k++) squares[k] = 0.0f;
        for (int j = 0; j < 5; j++) {
            const float *w = t->weighted[j] + i;
            for (int k = 0; k < m; k++) squares[k] += (w[k] - at[j]) * (w[k] - at[j]);
        }
        for (int k = 0; k < m; k++)
            if (squares[k] < least) least = squares[k], found = i + k;
    }
    return found;
}

/* Tries some branches towards random configurations; the new node, -1 if none, -2 at an end. */
static int grow(Scene *s, Search *h, Tree *t, const Checker *c) {
    double ends[TRIES * 6];
    int parents[TRIES];
    uint8_t verdict[TRIES];
    for (int i = 0; i < TRIES; i++) {
        double q[5];
        for (int j = 0; j < 5; j++)
            q[j] = h->lower[j] + (h->upper[j] - h->lower[j]) * drawn(&h->random);
        parents[i] = nearest(s, h, t, q);
        const double *origin = t->points + 5 * parents[i];
        const double part = STEP / fmax(distance(h, q, origin), STEP);
        for (int j = 0; j < 5; j++) ends[6 * i + j] = origin[j] + part * (q[j] - origin[j]);
        ends[6 * i + 5] = c->q_jaw;
    }
    so101_check(s, c->levels, ends, TRIES, 0, verdict);
    for (int i = 0; i < TRIES; i++) {
        if (s->stopped) return -2;
        if (verdict[i] != FREE) continue;
        if (is_clear(s, c, t->points + 5 * parents[i], ends + 6 * i, 0)) {
            const int node = add(h, t, ends + 6 * i, parents[i]);
            return node < 0 ? -2 : node;
        }
    }
    return -1;
}

/* Grows towards a configuration: the last node if it was reached, -1 if not, -2 at an end. */
static int follow(Scene *s, Search *h, Tree *t, const Checker *c, const double *target) {
    int parent = nearest(s, h, t, target);
    double q[5], origin[5], left;
    memcpy(origin, t->points + 5 * parent, sizeof origin);
    for (left = distance(h, target, origin); left > STEP; left -= STEP) {
        for (int j = 0; j < 5; j++) q[j] = origin[j] + (target[j] - origin[j]) * (STEP / left);
        if (!is_clear(s, c, origin, q, 1)) return s->stopped ? -2 : -1;
        parent = add(h, t, q, parent);
        if (parent < 0) return -2;
        memcpy(origin, q, sizeof origin);
    }
    return is_clear(s, c, origin, target, 0) ? parent : s->stopped ? -2 : -1;
}

static int joined(Search *h, int first, int second) {
    int n = 0, k;
    const Tree *a = &h->tree[0], *b = &h->tree[1];
    for (k = first; k >= 0; k = a->parents[k]) n++;
    const int before = n;
    for (k = second; k >= 0; k = b->parents[k]) n++, h->goal = k;
    free(h->path);
    h->path = malloc(5 * (size_t)n * sizeof *h->path);
    if (!h->path) return -1;
    h->length = n;
    n = before;
    for (k = first; k >= 0; k = a->parents[k])
        memcpy(h->path + 5 * --n, a->points + 5 * k, 5 * sizeof *h->path);
    n = before;
    for (k = second; k >= 0; k = b->parents[k])
        memcpy(h->path + 5 * n++, b->points + 5 * k, 5 * sizeof *h->path);
    return 1;
}

void so101_search_free(Search *h) {
    if (!h) return;
    for (int k = 0; k < 2; k++) {
        free(h->tree[k].points), free(h->tree[k].parents);
        for (int j = 0; j < 5; j++) free(h->tree[k].weighted[j]);
    }
    free(h->path), free(h);
}

Search *so101_search_new(const double *lower, const double *upper, const double *weights,
                         const double *start, const double *goals, int n, uint64_t seed) {
    Search *h = calloc(1, sizeof *h);
    if (!h) return 0;
    memcpy(h->lower, lower, sizeof h->lower);
    memcpy(h->upper, upper, sizeof h->upper);
    memcpy(h->weights, weights, sizeof h->weights);
    h->random = seed;
    int failed = add(h, &h->tree[0], start, -1) < 0;
    for (int k = 0; k < n; k++) failed |= add(h, &h->tree[1], goals + 5 * k, -1) < 0;
    h->tree[0].roots = 1, h->tree[1].roots = n;
    if (!failed) return h;
    so101_search_free(h);
    return 0;
}

/* At most `most` rounds, endless for 0. The number of waypoints that so101_search_path then gives,
 * 0 if none was found in time, -1 at an end or without memory. */
int so101_search_run(Scene *s, Search *h, const Checker *c, int most) {
    Tree *here = &h->tree[0], *there = &h->tree[1];
    for (int round = 0; most == 0 || round < most; round++) {
        if (s->late || s->stopped) break;
        const int node = grow(s, h, here, c);
        if (node == -2) break;
        if (node < 0) continue;
        const int met = follow(s, h, there, c, here->points + 5 * node);
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
    return s->late && !s->stopped ? 0 : most && !s->stopped ? 0 : -1;
}

/* The waypoints; the index of the goal they lead to. */
int so101_search_path(const Search *h, double *points) {
    memcpy(points, h->path, 5 * (size_t)h->length * sizeof *points);
    return h->goal;
}

/* How many nodes a tree has; copies them if there is room for. */
int so101_search_tree(const Search *h, int which, double *points, int *parents) {
    const Tree *t = &h->tree[which];
    if (points) memcpy(points, t->points, 5 * (size_t)t->count * sizeof *points);
    if (parents) memcpy(parents, t->parents, (size_t)t->count * sizeof *parents);
    return t->count;
}

/* Shortening. A path is an array of points of 5; lengths are those of joint angles. Points that lie
 * on its lines have not been looked at themselves, so ends of lines are here. */

static double apart(const double *a, const double *b) {
    double square = 0.0;
    for (int j = 0; j < 5; j++) square += (a[j] - b[j]) * (a[j] - b[j]);
    return sqrt(square);
}

static void between(const double *a, const double *b, double part, double *out) {
    for (int j = 0; j < 5; j++) out[j] = a[j] + part * (b[j] - a[j]);
}

static int skipped(Scene *s, const Checker *c, double *p, int n) {
    int stride = n - 1;
    while (stride >= 2) {
        for (int k = 0; k + stride < n;) {
            if (is_clear(s, c, p + 5 * k, p + 5 * (k + stride), 2)) {
                memmove(p + 5 * (k + 1), p + 5 * (k + stride),
                        5 * (size_t)(n - k - stride) * sizeof *p);
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
static void measure(const double *p, int n, double *end) {
    end[0] = 0.0;
    for (int i = 1; i < n; i++) end[i] = end[i - 1] + apart(p + 5 * (i - 1), p + 5 * i);
}

static int after(const double *end, int n, double length) {
    int i = 0;
    while (i < n && end[i] <= length) i++;
    return i < n - 1 ? i : n - 1;
}

/* The point after some length, which lies before corner i. */
static void at(const double *p, const double *end, int i, double length, double *out) {
    const double piece = end[i] - end[i - 1];
    between(p + 5 * (i - 1), p + 5 * i, piece > 0.0 ? (length - end[i - 1]) / piece : 0.0, out);
}

/* There must be room for CUTS more points, and for as many ends. */
static int cut(Scene *s, const Checker *c, double *p, int n, double *end, uint64_t *random) {
    measure(p, n, end);
    for (int k = 0, failed = 0; k < CUTS; k++) {
        if (n == 2 || failed == MOST_FAILED_CUTS || s->late || s->stopped) break;
        const double x = drawn(random), y = drawn(random), total = end[n - 1];
        const double first = fmin(x, y) * total, last = fmax(x, y) * total;
        const int i = after(end, n, first), j = after(end, n, last);
        failed++;
        if (i == j) continue;
        double a[5], b[5];
        at(p, end, i, first, a);
        at(p, end, j, last, b);
        if (last - first - apart(a, b) < GAIN * total || !is_clear(s, c, a, b, 2)) continue;
        memmove(p + 5 * (i + 2), p + 5 * j, 5 * (size_t)(n - j) * sizeof *p);
        memcpy(p + 5 * i, a, sizeof a);
        memcpy(p + 5 * (i + 1), b, sizeof b);
        n += i + 2 - j;
        measure(p, n, end);
        failed = 0;
    }
    return n;
}

static int pulled(Scene *s, const Checker *c, double *p, int n) {
    for (int k = 1; k < n - 1;) {
        const double *before = p + 5 * (k - 1), *behind = p + 5 * (k + 1);
        double *corner = p + 5 * k, target[5], nearer[5], along = 0.0, square = 0.0;
        for (int j = 0; j < 5; j++) {
            along += (corner[j] - before[j]) * (behind[j] - before[j]);
            square += (behind[j] - before[j]) * (behind[j] - before[j]);
        }
        between(before, behind, fmin(fmax(along / fmax(square, 1e-12), 0.0), 1.0), target);
        if (is_clear(s, c, before, behind, 0)) {
            memmove(corner, behind, 5 * (size_t)(n - k - 1) * sizeof *p);
            n--;
            continue;
        }
        for (double share = 0.5; share >= 0.25; share *= 0.5) {
            between(corner, target, share, nearer);
            if (is_free(s, c, nearer) && is_clear(s, c, before, nearer, 0) &&
                is_clear(s, c, nearer, behind, 0)) {
                memcpy(corner, nearer, sizeof nearer);
                break;
            }
        }
        k++;
    }
    return n;
}

/* Shortens n points into `out`, which has room for `room` points. Returns how many there are, 0 if
 * that is too little room, -1 at an end or without memory. Without `only_skip`, all three ways. */
int so101_shorten(Scene *s, const Checker *c, const double *points, int n, double *out, int room,
                  uint64_t seed, int only_skip) {
    int m = 0;
    for (int i = 0; i < n; i++) {
        const int pieces =
            i ? (int)fmax(1.0, ceil(apart(points + 5 * (i - 1), points + 5 * i) / PIECE)) : 1;
        if (m + pieces + CUTS > room) return 0;
        for (int k = 1; k < pieces; k++)
            between(points + 5 * (i - 1), points + 5 * i, (double)k / pieces, out + 5 * m++);
        memcpy(out + 5 * m++, points + 5 * i, 5 * sizeof *out);
    }
    double *end = malloc((size_t)room * sizeof *end);
    if (!end) return -1;
    m = skipped(s, c, out, m);
    if (!only_skip) {
        m = cut(s, c, out, m, end, &seed);
        if (!s->late) m = pulled(s, c, out, m);
    }
    free(end);
    return s->stopped ? -1 : m;
}
