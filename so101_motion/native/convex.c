/* Computes the poses of bodies, and the distance of two of them in double precision, as far as needed.
 *
 * Finds the point of the difference of two bodies nearest to the origin (E. G. Gilbert, D. W.
 * Johnson, S. S. Keerthi, 1988). The nearest point of a simplex is searched among all edges and faces
 * that it can be on. As in lanes.c, the length of a combination of points is an upper bound and a
 * plane that touches the difference gives a lower one, so an error in the iteration could cost time,
 * never a wrong verdict.
 */
#include <math.h>
#include <string.h>

#include "native.h"

#define BAND 3e-6 /* nearer to the margin than this coal decides, which is as exact [m] */
#define ROUNDS 64
#define FLAT 1e-18 /* smaller edges and faces are ignored [m^2] */

typedef struct {
    const double *points;
    int count;
    const double *R; /* 0: as the base */
    const double *p;
} Hull;

void so101_poses(const Scene *s, const double *q, const double *placement, Pose *pose) {
    memset(pose, 0, sizeof *pose);
    pose->R[0] = pose->R[4] = pose->R[8] = 1.0;
    if (placement) memcpy(pose, placement, sizeof *pose);
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

/* Finds the point of a simplex nearest to the origin; keeps the corners that it is a combination of,
 * the same ones of `a` if given, and their shares.
 *
 * The last corner is the newest and always one of them, otherwise it would not have come nearer. So
 * the nearest point is the last corner plus shares of the edges from there to the others; the shares
 * are not negative and sum up to at most one. */
static int nearest(double (*w)[3], double (*a)[3], int n, double *v, double *shares) {
    const int m = n - 1;
    const double *last = w[m];
    double e[3][3], G[3][3], b[3], best[3] = {0.0}, most = 0.0;
    for (int i = 0; i < m; i++) {
        for (int c = 0; c < 3; c++) e[i][c] = w[i][c] - last[c];
        b[i] = -dot(e[i], last);
        for (int j = 0; j <= i; j++) G[i][j] = G[j][i] = dot(e[i], e[j]);
    }
    for (int i = 0; i < m; i++) { /* edges */
        const double x = b[i] / G[i][i];
        if (!(G[i][i] > FLAT) || !(x > 0.0 && x <= 1.0) || !(x * b[i] > most)) continue;
        most = x * b[i];
        for (int k = 0; k < 3; k++) best[k] = k == i ? x : 0.0;
    }
    for (int i = 1; i < m; i++)
        for (int j = 0; j < i; j++) { /* faces */
            const double D = G[i][i] * G[j][j] - G[i][j] * G[i][j];
            const double x = b[i] * G[j][j] - b[j] * G[i][j];
            const double y = b[j] * G[i][i] - b[i] * G[i][j];
            if (!(D > FLAT * G[i][i]) || !(x > 0.0 && y > 0.0 && x + y <= D)) continue;
            if (!(x * b[i] + y * b[j] > most * D)) continue;
            most = (x * b[i] + y * b[j]) / D;
            for (int k = 0; k < 3; k++) best[k] = k == i ? x / D : k == j ? y / D : 0.0;
        }
    if (m == 3) { /* the origin is inside */
        double normal[3][3], D = 0.0, x[3], sum = 0.0;
        for (int i = 0; i < 3; i++) {
            const double *f = e[(i + 1) % 3], *g = e[(i + 2) % 3];
            for (int c = 0; c < 3; c++)
                normal[i][c] = f[(c + 1) % 3] * g[(c + 2) % 3] - f[(c + 2) % 3] * g[(c + 1) % 3];
        }
        D = dot(e[0], normal[0]);
        for (int i = 0; i < 3; i++) sum += x[i] = -dot(last, normal[i]) / D;
        const int is_inside = x[0] > 0.0 && x[1] > 0.0 && x[2] > 0.0 && sum <= 1.0;
        if (is_inside && D * D > FLAT * dot(normal[2], normal[2]))
            memcpy(best, x, sizeof best);
    }
    int kept = 0;
    double rest = 1.0;
    memcpy(v, last, 3 * sizeof *v);
    for (int i = 0; i < m; i++) {
        if (!(best[i] > 0.0)) continue;
        for (int c = 0; c < 3; c++) v[c] += best[i] * e[i][c];
        rest -= shares[kept] = best[i];
        if (a) memmove(a[kept], a[i], sizeof a[i]);
        memmove(w[kept++], w[i], sizeof w[i]);
    }
    shares[kept] = rest;
    if (a) memmove(a[kept], a[m], sizeof a[m]);
    memmove(w[kept++], w[m], sizeof w[m]);
    return kept;
}

static int verdict(const Hull *a, const Hull *b, double margin, const double *towards) {
    double w[4][3], share[4], v[3], pa[3], pb[3], last = INFINITY;
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
        n = nearest(w, 0, n + 1, v, share);
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
#define ROUGH 0.1  /* allowed error of a distance, as a share of its excess over the needed one */
#define EXACT 1e-8 /* [m] */

/* Ends as soon as the distance is proven above `enough`, or known to `exact`. */
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

/* Like `furthest`, of a body. Points are compared in single precision, so the point found may be nearer
 * than the furthest, by less than half of ROUNDED. */
#define ROUNDED 1e-6 /* [m] */

static void body_furthest(const Scene *s, const Body *b, const Pose *pose, const double *n,
                          double sign, double *out) {
    const double *R = pose->R;
    float own[3];
    for (int c = 0; c < 3; c++)
        own[c] = (float)(sign * (R[c] * n[0] + R[3 + c] * n[1] + R[6 + c] * n[2]));
    const int found = so101_furthest(b->columns, b->padded, own);
    const int i = found < b->count ? found : b->count - 1;
    for (int r = 0; r < 3; r++)
        out[r] = pose->p[r] + dot(R + 3 * r, s->points + 3 * (b->first + i));
}

/* Like so101_gap; `point`, if given, gets the point of the first nearest to the second. */
static double gap(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                  int body_b, double need, double enough, double *v, double *along, double *point) {
    const Body *first = &a->body[body_a], *second = &b->body[body_b];
    const Pose *pose_a = &at_a[first->joint], *pose_b = &at_b[second->joint];
    const double radii = first->radius + second->radius + ROUNDED;
    double w[4][3], pa[4][3], share[4] = {1.0}, pb[3], low = 0.0, last = INFINITY;
    if (!(dot(v, v) > 1e-18)) /* unknown, or they have touched */
        for (int c = 0; c < 3; c++) v[c] = pose_a->p[c] - pose_b->p[c];
    int n = 0;
    for (int round = 0; round < ROUNDS && n < 4; round++) {
        const double length = sqrt(dot(v, v)); /* from the second round on an upper bound */
        *along = -INFINITY;
        if (!(length > 1e-9) || !(length < last)) break;
        body_furthest(a, first, pose_a, v, -1.0, pa[n]);
        body_furthest(b, second, pose_b, v, 1.0, pb);
        for (int c = 0; c < 3; c++) w[n][c] = pa[n][c] - pb[c];
        const double here = dot(v, w[n]) / length;
        *along = here - radii;
        low = fmax(low, here);
        if (low - radii > enough) break;
        if (n) {
            const double known = fmax(TENTH, ROUGH * (low - radii - need));
            if (!(length - low > known)) break;
            last = length;
        }
        n = nearest(w, point ? pa : 0, n + 1, v, share);
        *along = -INFINITY;
    }
    for (int c = 0; point && c < 3; c++) {
        point[c] = 0.0;
        for (int i = 0; i < n; i++) point[c] += share[i] * pa[i][c];
    }
    return low - radii;
}

double so101_gap(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                 int body_b, double need, double enough, double *v, double *along) {
    return gap(a, at_a, body_a, b, at_b, body_b, need, enough, v, along, 0);
}

double so101_gap_at(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                    int body_b, double enough, double *v, double *point) {
    double along;
    return gap(a, at_a, body_a, b, at_b, body_b, enough, enough, v, &along, point);
}

double so101_gap_along(const Scene *a, const Pose *at_a, int body_a, const Scene *b, const Pose *at_b,
                       int body_b, const double *v) {
    const Body *first = &a->body[body_a], *second = &b->body[body_b];
    double pa[3], pb[3];
    body_furthest(a, first, &at_a[first->joint], v, -1.0, pa);
    body_furthest(b, second, &at_b[second->joint], v, 1.0, pb);
    for (int c = 0; c < 3; c++) pa[c] -= pb[c];
    return dot(v, pa) / sqrt(dot(v, v)) - first->radius - second->radius - ROUNDED;
}

Closest so101_closest_pair(const Scene *s, const Pose *pose, int pair, double enough) {
    const Hull a = hull_of(s, pose, s->pair[pair].first), b = hull_of(s, pose, s->pair[pair].second);
    return closest(&a, &b, enough, EXACT);
}

Closest so101_closest_bodies(const Scene *a, const Pose *at_a, int body_a, const Scene *b,
                             const Pose *at_b, int body_b, double enough) {
    const Hull first = hull_of(a, at_a, body_a), second = hull_of(b, at_b, body_b);
    return closest(&first, &second, enough, EXACT);
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
