/* One pair of convex bodies in double precision: how far apart, up to what decides.
 *
 * The nearest point of the difference of two bodies to the origin (Gilbert, Johnson, Keerthi 1988).
 * The nearest point of a simplex is looked for among all its corners, edges and faces: slower than
 * the usual case distinctions and without their traps. As in lanes.c, a length of a combination of
 * points is an upper bound and a plane that touches the difference gives a lower one, so an error
 * in the iteration could cost time, never a wrong verdict.
 */
#include <math.h>
#include <string.h>

#include "native.h"

#define BAND 3e-6 /* nearer to the margin than this coal decides [m]: it is no more exact itself */
#define ROUNDS 64

typedef struct {
    const double *points;
    int count;
    const double *R; /* 0: as the base */
    const double *p;
} Hull;

void so101_poses(const Scene *s, const double *q, Pose *pose) {
    memset(pose, 0, sizeof *pose);
    pose->R[0] = pose->R[4] = pose->R[8] = 1.0;
    for (int j = 0; j < JOINTS; j++) {
        const Pose *b = &pose[j];
        Pose *here = &pose[j + 1];
        const double *o = s->offset[j], sine = sin(q[j]), cosine = cos(q[j]);
        for (int r = 0; r < 3; r++) {
            const double *row = b->R + 3 * r;
            double x = row[0] * o[0] + row[1] * o[3] + row[2] * o[6];
            double y = row[0] * o[1] + row[1] * o[4] + row[2] * o[7];
            here->R[3 * r] = x * cosine + y * sine;
            here->R[3 * r + 1] = y * cosine - x * sine;
            here->R[3 * r + 2] = row[0] * o[2] + row[1] * o[5] + row[2] * o[8];
            here->p[r] = b->p[r] + row[0] * o[9] + row[1] * o[10] + row[2] * o[11];
        }
    }
}

static double dot(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The point of a hull furthest along n, or with a `sign` of -1 against it. */
static void furthest(const Hull *h, const double *n, double sign, double *out) {
    double own[3] = {sign * n[0], sign * n[1], sign * n[2]};
    if (h->R) {
        const double x = own[0], y = own[1], z = own[2];
        for (int c = 0; c < 3; c++) own[c] = h->R[c] * x + h->R[3 + c] * y + h->R[6 + c] * z;
    }
    double best = -INFINITY;
    const double *at = h->points;
    for (int i = 0; i < h->count; i++) {
        double value = dot(h->points + 3 * i, own);
        if (value > best) best = value, at = h->points + 3 * i;
    }
    for (int r = 0; r < 3; r++)
        out[r] = h->p[r] + (h->R ? dot(h->R + 3 * r, at) : at[r]);
}

/* Weights of the point nearest to the origin on the plane through corners; 0 if there is none. */
static int weights(double (*w)[3], const int *corner, int n, double *out) {
    double e[3][3], G[3][4];
    if (n == 1) {
        out[0] = 1.0;
        return 1;
    }
    for (int i = 1; i < n; i++)
        for (int c = 0; c < 3; c++) e[i - 1][c] = w[corner[i]][c] - w[corner[0]][c];
    for (int i = 0; i < n - 1; i++) {
        for (int j = 0; j < n - 1; j++) G[i][j] = dot(e[i], e[j]);
        G[i][n - 1] = -dot(e[i], w[corner[0]]);
    }
    for (int i = 0; i < n - 1; i++) { /* the Gram matrix is symmetric: no pivots are needed */
        if (!(G[i][i] > 1e-18)) return 0;
        for (int k = i + 1; k < n - 1; k++) {
            const double f = G[k][i] / G[i][i];
            for (int j = i; j < n; j++) G[k][j] -= f * G[i][j];
        }
    }
    out[0] = 1.0;
    for (int i = n - 2; i >= 0; i--) {
        double x = G[i][n - 1];
        for (int j = i + 1; j < n - 1; j++) x -= G[i][j] * out[j + 1];
        out[i + 1] = x / G[i][i];
        out[0] -= out[i + 1];
    }
    for (int i = 0; i < n; i++)
        if (!(out[i] >= 0.0)) return 0;
    return 1;
}

/* The point of a simplex nearest to the origin; keeps the corners that carry it, with as many of
 * `a`, and says what share each has in it. */
static int nearest(double (*w)[3], double (*a)[3], int n, double *v, double *shares) {
    double least = INFINITY;
    int kept = 1;
    for (int set = 1; set < 1 << n; set++) {
        int corner[4], m = 0;
        double share[4], at[3] = {0.0, 0.0, 0.0};
        for (int i = 0; i < n; i++)
            if (set >> i & 1) corner[m++] = i;
        if (!weights(w, corner, m, share)) continue;
        for (int i = 0; i < m; i++)
            for (int c = 0; c < 3; c++) at[c] += share[i] * w[corner[i]][c];
        if (dot(at, at) < least) {
            least = dot(at, at);
            kept = set;
            memcpy(v, at, sizeof at);
            memcpy(shares, share, sizeof share);
        }
    }
    int m = 0;
    for (int i = 0; i < n; i++)
        if (kept >> i & 1) {
            memmove(a[m], a[i], sizeof a[i]);
            memmove(w[m++], w[i], sizeof w[i]);
        }
    return m;
}

static int verdict(const Hull *a, const Hull *b, double margin, const double *towards) {
    double w[4][3], on_a[4][3], share[4], v[3], pa[3], pb[3], last = INFINITY;
    furthest(a, towards, -1.0, pa);
    furthest(b, towards, 1.0, pb);
    for (int c = 0; c < 3; c++) v[c] = w[0][c] = pa[c] - pb[c];
    int n = 1;
    for (int round = 0; round < ROUNDS; round++) {
        const double length = sqrt(dot(v, v));
        if (length < margin - BAND) return TOUCHING;
        if (!(length > 1e-12) || n == 4) return UNKNOWN;
        furthest(a, v, -1.0, pa);
        furthest(b, v, 1.0, pb);
        for (int c = 0; c < 3; c++) w[n][c] = pa[c] - pb[c];
        const double low = dot(v, w[n]) / length;
        if (low > margin + BAND) return FREE;
        if (!(length - low > 1e-10) || !(length < last)) return UNKNOWN;
        last = length;
        n = nearest(w, on_a, n + 1, v, share);
    }
    return UNKNOWN;
}

static Hull hull_of(const Scene *s, const Pose *pose, int body) {
    const Body *b = &s->body[body];
    return (Hull){s->points + 3 * b->first, b->count, pose[b->joint].R, pose[b->joint].p};
}

static Hull hull_of_piece(const Scene *s, int piece) {
    const Piece *o = &s->piece[piece];
    const Shape *shape = &s->shape[o->shape];
    return (Hull){s->shape_points + 3 * shape->first, shape->count, 0, o->at};
}

#define TENTH 1e-4 /* [m] */
#define ROUGH 0.1  /* what is so much too little of what is to spare does */
#define EXACT 1e-8 /* [m] */

/* Ends as soon as they are known to be more than `enough` apart, or how far is known to `exact`. */
static Closest closest(const Hull *first, const Hull *second, double enough, double exact) {
    double w[4][3], a[4][3], share[4] = {1.0}, v[3], pa[3], pb[3], last = INFINITY;
    Closest found = {0};
    for (int c = 0; c < 3; c++) v[c] = first->p[c] - second->p[c];
    furthest(first, v, -1.0, a[0]);
    furthest(second, v, 1.0, pb);
    for (int c = 0; c < 3; c++) v[c] = w[0][c] = a[0][c] - pb[c];
    int n = 1;
    for (int round = 0; round < ROUNDS && n < 4; round++) {
        found.length = sqrt(dot(v, v));
        if (!(found.length > 1e-9) || !(found.length < last)) break;
        furthest(first, v, -1.0, pa);
        furthest(second, v, 1.0, pb);
        for (int c = 0; c < 3; c++) w[n][c] = pa[c] - pb[c], a[n][c] = pa[c];
        found.low = fmax(found.low, dot(v, w[n]) / found.length);
        if (found.low > enough || !(found.length - found.low > exact)) break;
        last = found.length;
        n = nearest(w, a, n + 1, v, share);
    }
    if (n == 4) found.length = 0.0;
    for (int c = 0; c < 3; c++) {
        for (int i = 0; i < n; i++) found.first[c] += share[i] * a[i][c];
        found.second[c] = found.first[c] - v[c];
    }
    return found;
}

typedef float V __attribute__((vector_size(4 * LANES)));
typedef int32_t I __attribute__((vector_size(4 * LANES)));

/* As `furthest`, of a body, several points at a time. They are compared in single precision, so the
 * one that is found may be nearer than the furthest, by less than half of ROUNDED. */
#define ROUNDED 1e-6 /* [m] */

static void body_furthest(const Scene *s, const Body *b, const Pose *pose, const double *n,
                          double sign, double *out) {
    const double *R = pose->R;
    float own[3];
    for (int c = 0; c < 3; c++)
        own[c] = (float)(sign * (R[c] * n[0] + R[3 + c] * n[1] + R[6 + c] * n[2]));
    V best;
    I at, index;
    for (int k = 0; k < LANES; k++) best[k] = -INFINITY, at[k] = 0, index[k] = k;
    for (int i = 0; i < b->padded; i += LANES) {
        V x, y, z;
        memcpy(&x, b->columns + i, sizeof x);
        memcpy(&y, b->columns + b->padded + i, sizeof y);
        memcpy(&z, b->columns + 2 * b->padded + i, sizeof z);
        const V value = x * own[0] + y * own[1] + z * own[2];
        const I better = value > best;
        best = (V)((better & (I)value) | (~better & (I)best));
        at = (better & index) | (~better & at);
        index += LANES;
    }
    int found = 0;
    for (int k = 1; k < LANES; k++)
        if (best[k] > best[found]) found = k;
    const int i = at[found] < b->count ? at[found] : b->count - 1;
    for (int r = 0; r < 3; r++)
        out[r] = pose->p[r] + dot(R + 3 * r, s->points + 3 * (b->first + i));
}

double so101_gap(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                 int body_b, double need, double enough, double *v) {
    const Body *first = &a->body[body_a], *second = &b->body[body_b];
    const Pose *pose_a = &at_a[first->joint], *pose_b = &at_b[second->joint];
    const double radii = first->radius + second->radius + ROUNDED;
    double w[4][3], a_of[4][3], share[4], pa[3], pb[3], low = 0.0, last = INFINITY;
    if (!(dot(v, v) > 0.0))
        for (int c = 0; c < 3; c++) v[c] = pose_a->p[c] - pose_b->p[c];
    int n = 0;
    for (int round = 0; round < ROUNDS && n < 4; round++) {
        const double length = sqrt(dot(v, v)); /* from the second round on an upper bound */
        if (!(length > 1e-9) || !(length < last)) break;
        body_furthest(a, first, pose_a, v, -1.0, pa);
        body_furthest(b, second, pose_b, v, 1.0, pb);
        for (int c = 0; c < 3; c++) w[n][c] = pa[c] - pb[c], a_of[n][c] = pa[c];
        low = fmax(low, dot(v, w[n]) / length);
        if (low - radii > enough) break;
        if (n) {
            const double known = fmax(TENTH, ROUGH * (low - radii - need));
            if (!(length - low > known)) break;
            last = length;
        }
        n = nearest(w, a_of, n + 1, v, share);
    }
    return low - radii;
}

Closest so101_closest_pair(const Scene *s, const Pose *pose, int pair, double enough) {
    const Hull a = hull_of(s, pose, s->pair[pair].first), b = hull_of(s, pose, s->pair[pair].second);
    return closest(&a, &b, enough, EXACT);
}

Closest so101_closest_piece(const Scene *s, const Pose *pose, int body, int piece, double enough) {
    const Hull a = hull_of(s, pose, body), b = hull_of_piece(s, piece);
    return closest(&a, &b, enough, EXACT);
}

void so101_lowest(const Scene *s, const Pose *pose, int body, double *at) {
    const Hull a = hull_of(s, pose, body);
    const double up[3] = {0.0, 0.0, 1.0};
    furthest(&a, up, -1.0, at);
}

int so101_exact_pair(const Scene *s, const Pose *pose, int pair, double margin,
                     const double *v) {
    const Pair *p = &s->pair[pair];
    const Hull a = hull_of(s, pose, p->first), b = hull_of(s, pose, p->second);
    margin += s->body[p->first].radius + s->body[p->second].radius;
    return verdict(&a, &b, margin, v);
}

int so101_exact_piece(const Scene *s, const Pose *pose, int body, int piece, double margin,
                      const double *v) {
    const Hull a = hull_of(s, pose, body), b = hull_of_piece(s, piece);
    const double radii = s->body[body].radius + s->shape[s->piece[piece].shape].radius;
    return verdict(&a, &b, margin + radii, v);
}

int so101_exact_floor(const Scene *s, const Pose *pose, int body, double margin) {
    double at[3];
    so101_lowest(s, pose, body, at);
    const double room = at[2] - s->floor_z - s->body[body].radius - margin;
    return room > BAND ? FREE : room < -BAND ? TOUCHING : UNKNOWN;
}
