/* Checks many configurations at once, one in each lane of the processor's vectors.
 *
 * For every pair of bodies two bounds on their distance approach each other (Gilbert's iteration):
 * v is a point of the difference of the two hulls, so its length is an upper bound; the plane across
 * v that touches the difference gives a lower one; v then moves towards the point where it touches.
 * A lane is done with a pair as soon as one bound has passed the margin. Pairs still open after a
 * few rounds are settled by convex.c in double precision.
 *
 * Obstacles are the leaves of a tree of boxes. A box is skipped when it is apart along the base's
 * axes, along those of the body's own box, or behind a plane that was found to separate this body
 * from another obstacle: one plane hides a whole wall of cubes.
 *
 * Every comparison is written so that a NaN proves nothing. This file is compiled once for each
 * width of vectors; the verdicts do not depend on it, because only proofs count.
 *
 * Source: E. G. Gilbert, An Iterative Procedure for Computing the Minimum of a Quadratic Form on a
 * Convex Set, SIAM J. Control 1966.
 */
#include "native.h"
#include "vectors.h"

#define ROUNDS 12     /* of the iteration, at most; chosen by time */
#define FEW 2         /* this few open lanes are cheaper one by one */
#define FEW_AFTER 9 /* rounds; with 4 many lanes that touch stay open, and go on through the tree */
#define PLANES 3
#define MOST_OPEN 96
#define LARGEST 8.0   /* coal decides for larger angles [rad] */

static void place(const Scene *s, const V *q, Frame *frame) {
    for (int i = 0; i < 9; i++) frame[0].R[i] = all(i % 4 == 0);
    for (int i = 0; i < 3; i++) frame[0].p[i] = all(0.0f);
    for (int j = 0; j < JOINTS; j++) {
        const Frame *before = &frame[j];
        Frame *here = &frame[j + 1];
        const double *o = s->offset[j];
        V sine, cosine;
        sine_cosine(q[j], &sine, &cosine);
        for (int r = 0; r < 3; r++) {
            const V *b = &before->R[3 * r];
            V x = b[0] * (float)o[0] + b[1] * (float)o[3] + b[2] * (float)o[6];
            V y = b[0] * (float)o[1] + b[1] * (float)o[4] + b[2] * (float)o[7];
            here->R[3 * r] = x * cosine + y * sine;
            here->R[3 * r + 1] = y * cosine - x * sine;
            here->R[3 * r + 2] = b[0] * (float)o[2] + b[1] * (float)o[5] + b[2] * (float)o[8];
            here->p[r] =
                before->p[r] + b[0] * (float)o[9] + b[1] * (float)o[10] + b[2] * (float)o[11];
        }
    }
}

/* The point of a body that lies furthest along a direction of the base frame. */
static inline void body_furthest(const Scene *s, const Body *b, const Frame *f, const V *n, V *out) {
    V own[3], at[3];
    for (int c = 0; c < 3; c++) own[c] = f->R[c] * n[0] + f->R[3 + c] * n[1] + f->R[6 + c] * n[2];
    furthest(s->points_f + 3 * b->first, b->count, own, at);
    for (int r = 0; r < 3; r++)
        out[r] = f->p[r] + f->R[3 * r] * at[0] + f->R[3 * r + 1] * at[1] + f->R[3 * r + 2] * at[2];
}

/* Planes that separate one body from obstacles: everything of the body lies at n.x >= low. */
typedef struct {
    V n[PLANES][3], low[PLANES], needed[PLANES]; /* needed: the square of the margin times |n| */
    int next, known;
} Planes;

/* Moves v to the point nearest to the origin of the triangle of v and two other points. Rounding and
 * divisions by nothing do no harm: only points between the three are taken, and only nearer ones. */
static inline void approach(V *v, const V *w, const V *u) {
    V a[3], b[3], best[3] = {v[0], v[1], v[2]};
    for (int c = 0; c < 3; c++) a[c] = w[c] - v[c], b[c] = u[c] - v[c];
    const V aa = dot(a, a), ab = dot(a, b), bb = dot(b, b), va = -dot(v, a), vb = -dot(v, b);
    V t = va / aa;
    t = pick(t > 0.0f, t, all(0.0f)); /* and if it is not a number */
    t = pick(t < 1.0f, t, all(1.0f));
    for (int c = 0; c < 3; c++) best[c] += t * a[c];
    V least = dot(best, best);
    const V scale = 1.0f / (aa * bb - ab * ab);
    const V s = (va * bb - vb * ab) * scale, r = (vb * aa - va * ab) * scale;
    V inner[3];
    for (int c = 0; c < 3; c++) inner[c] = v[c] + s * a[c] + r * b[c];
    I better = (s >= 0.0f) & (r >= 0.0f) & (s + r <= 1.0f) & (dot(inner, inner) < least);
    for (int c = 0; c < 3; c++) best[c] = pick(better, inner[c], best[c]);
    least = pick(better, dot(inner, inner), least);
    /* the edge between the two others */
    V d[3];
    for (int c = 0; c < 3; c++) d[c] = u[c] - w[c];
    t = -dot(w, d) / dot(d, d);
    t = pick(t > 0.0f, t, all(0.0f));
    t = pick(t < 1.0f, t, all(1.0f));
    for (int c = 0; c < 3; c++) inner[c] = w[c] + t * d[c];
    better = dot(inner, inner) < least;
    for (int c = 0; c < 3; c++) v[c] = pick(better, inner[c], best[c]);
}

/* Gilbert's iteration between body a and body b, or else a shape at a place.
 * It begins across the direction v.
 * Returns the lanes of `need` that are still open; those that touch are added to `hit`. */
static I iterate(const Scene *s, const Body *a, const Frame *fa, const Body *b, const Frame *fb,
                 const Shape *shape, const float *at, V *v, float margin, float slack, I need,
                 I *hit, Planes *planes) {
    const float most = (margin - slack) * (margin - slack);
    const float least = (margin + slack) * (margin + slack);
    const int can_touch = margin > slack;
    V w[3], before[3];
    for (int round = 0; round < ROUNDS; round++) {
        V low[3], high[3], away[3] = {-v[0], -v[1], -v[2]};
        V length = dot(v, v);
        if (round && can_touch) {
            I near = need & (length < most);
            *hit |= near;
            need &= ~near;
        }
        body_furthest(s, a, fa, away, low);
        if (b) {
            body_furthest(s, b, fb, v, high);
        } else {
            furthest(s->shape_points_f + 3 * shape->first, shape->count, v, high);
            for (int c = 0; c < 3; c++) high[c] += at[c];
        }
        for (int c = 0; c < 3; c++) {
            before[c] = round ? w[c] : low[c] - high[c];
            w[c] = low[c] - high[c];
        }
        V along = dot(v, w);
        I far = need & (along > 0.0f) & (along * along > least * length);
        if (planes && bits(far)) {
            const int k = planes->next;
            const int is_new = planes->known == k;
            float kept = margin - (shape ? (float)shape->radius : 0.0f) + slack;
            if (is_new) {
                planes->known++;
                for (int c = 0; c < 3; c++) planes->n[k][c] = all(0.0f);
                planes->low[k] = planes->needed[k] = all(0.0f);
            }
            for (int c = 0; c < 3; c++) planes->n[k][c] = pick(far, v[c], planes->n[k][c]);
            planes->low[k] = pick(far, dot(v, low), planes->low[k]);
            planes->needed[k] = pick(far, length * (kept * kept), planes->needed[k]);
        }
        need &= ~far;
        unsigned open = bits(need);
        if (open == 0) break;
        if (round >= FEW_AFTER && __builtin_popcount(open) <= FEW) break;
        if (round) approach(v, w, before);
        else v[0] = w[0], v[1] = w[1], v[2] = w[2];
    }
    if (planes && planes->known > planes->next) planes->next = (planes->next + 1) % PLANES;
    return need;
}

/* The box of one body in each lane, with what `apart` and `pierced` need. */
typedef struct {
    V middle[3], half[3]; /* along the base's axes, margin included */
    V own[3][3], size[3][3]; /* the body's axes, and their magnitudes */
    float length[3];      /* half the box along them, margin included */
    V spine[3], along[3]; /* where the body's line begins, and to its end */
} Extent;

static void extent_of(const Body *b, const Frame *f, float margin, Extent *e) {
    moved(f, b->box_centre, e->middle);
    moved(f, b->spine[0], e->spine);
    moved(f, b->spine[1], e->along);
    for (int c = 0; c < 3; c++) e->along[c] -= e->spine[c];
    for (int r = 0; r < 3; r++) {
        e->half[r] = all(margin);
        for (int c = 0; c < 3; c++) {
            e->own[c][r] = f->R[3 * r + c];
            e->size[c][r] = magnitude(f->R[3 * r + c]);
            e->half[r] += e->size[c][r] * b->box_half[c];
        }
        e->length[r] = b->box_half[r] + margin;
    }
}

static inline I apart(const Extent *e, const Planes *planes, const float *middle,
                      const float *half, I need) {
    V d[3];
    I far = (I){0};
    for (int c = 0; c < 3; c++) {
        d[c] = middle[c] - e->middle[c];
        far |= magnitude(d[c]) > e->half[c] + half[c];
    }
    if (!bits(need & ~far)) return far;
    for (int c = 0; c < 3; c++) {
        V reach = e->size[c][0] * half[0] + e->size[c][1] * half[1] + e->size[c][2] * half[2];
        far |= magnitude(dot(d, e->own[c])) > reach + e->length[c];
    }
    for (int k = 0; k < planes->known; k++) {
        const V *n = planes->n[k];
        V high = n[0] * middle[0] + n[1] * middle[1] + n[2] * middle[2] +
                 magnitude(n[0]) * half[0] + magnitude(n[1]) * half[1] + magnitude(n[2]) * half[2];
        V gap = planes->low[k] - high;
        far |= (gap > 0.0f) & (gap * gap > planes->needed[k]);
    }
    return far;
}

/* Lanes in which the body's line passes through a box. The point in the box is checked itself, so
 * divisions by zero do no harm. */
static inline I pierced(const Extent *e, const float *middle, const float *core) {
    V enter = all(0.0f), leave = all(1.0f), from[3];
    for (int c = 0; c < 3; c++) {
        from[c] = e->spine[c] - middle[c];
        const V scale = 1.0f / e->along[c];
        const V one = (-core[c] - from[c]) * scale, other = (core[c] - from[c]) * scale;
        const I forward = one < other;
        const V in = pick(forward, one, other), out = pick(forward, other, one);
        enter = pick(in > enter, in, enter);
        leave = pick(out < leave, out, leave);
    }
    const V part = 0.5f * (enter + leave);
    I inside = (part >= 0.0f) & (part <= 1.0f);
    for (int c = 0; c < 3; c++) inside &= magnitude(from[c] + part * e->along[c]) < core[c];
    return inside;
}

/* The pairs that the vectors could not settle. */
typedef struct {
    struct {
        unsigned lanes;
        int what, index, body; /* a pair's index, or a piece's and a body, or a body over the floor */
        V v[3];                /* how far the iteration has come */
    } item[MOST_OPEN];
    int count;
    unsigned lost; /* lanes for which there was no room */
} Open;

enum { PAIR, PIECE, FLOOR };

static void keep(Open *open, unsigned lanes, int what, int index, int body, const V *v) {
    if (open->count == MOST_OPEN) {
        open->lost |= lanes;
        return;
    }
    open->item[open->count].lanes = lanes;
    open->item[open->count].what = what;
    for (int c = 0; c < 3; c++) open->item[open->count].v[c] = v[c];
    open->item[open->count].index = index;
    open->item[open->count++].body = body;
}

static int settle(const Scene *s, const Open *open, int k, int lane, const Pose *pose,
                  const double *margin) {
    const int index = open->item[k].index, body = open->item[k].body;
    const V *v = open->item[k].v;
    const double from[3] = {v[0][lane], v[1][lane], v[2][lane]};
    switch (open->item[k].what) {
    case PAIR: return so101_exact_pair(s, pose, index, margin[s->pair[index].margin], from);
    case PIECE: return so101_exact_piece(s, pose, body, index, margin[1], from);
    default: return so101_exact_floor(s, pose, body, margin[1]);
    }
}

static void against_obstacles(const Scene *s, int index, const Frame *f, const V *centre,
                              float margin, I alive, I *hit, Open *open, int stop) {
    const Body *b = &s->body[index];
    const float wide = margin + (float)b->radius;
    Extent e;
    Planes planes;
    planes.next = planes.known = 0;
    extent_of(b, f, wide + SLACK, &e);
    int stack[128], top = 0;
    stack[top++] = 0;
    while (top) {
        const Node *node = &s->node[stack[--top]];
        I need = alive & ~*hit;
        if (!(node->mask >> index & 1)) continue;
        need &= ~apart(&e, &planes, node->middle, node->half, need);
        if (!bits(need)) continue;
        if (!node->count) {
            /* First the branch that is nearer in most lanes: one that touches is soon done then. */
            V away[2] = {all(0.0f), all(0.0f)};
            for (int k = 0; k < 2; k++)
                for (int c = 0; c < 3; c++) {
                    const V d = s->node[node->first + k].middle[c] - e.middle[c];
                    away[k] += d * d;
                }
            const unsigned nearer = bits(need & (away[0] < away[1]));
            const int last = 2 * __builtin_popcount(nearer) > __builtin_popcount(bits(need));
            stack[top++] = node->first + last;
            stack[top++] = node->first + !last;
            continue;
        }
        for (int i = node->first; i < node->first + node->count; i++) {
            const Piece *piece = &s->piece[i];
            if (!(piece->mask >> index & 1)) continue;
            const Shape *shape = &s->shape[piece->shape];
            float at[3], middle[3], largest = shape->reach;
            for (int c = 0; c < 3; c++) {
                at[c] = (float)piece->at[c];
                middle[c] = at[c] + shape->middle[c];
                float size = __builtin_fabsf(at[c]) + shape->reach;
                if (size > largest) largest = size;
            }
            need = alive & ~*hit;
            need &= ~apart(&e, &planes, middle, shape->half, need);
            if (shape->core[0] > 0.0f && wide > SLACK) {
                const I through = need & pierced(&e, middle, shape->core);
                *hit |= through;
                if (stop && bits(through)) return;
                need &= ~through;
            }
            if (!bits(need)) continue;
            V v[3];
            for (int c = 0; c < 3; c++) {
                /* From the body's middle to the obstacle's box: nearly across the nearest face. */
                V d = e.middle[c] - middle[c], inside = magnitude(d) - shape->half[c];
                V sign = (V)(((I)d & (int32_t)0x80000000) | (I)all(1.0f));
                v[c] = pick(inside > 0.0f, inside * sign, d * 0.01f);
            }
            need = iterate(s, b, f, 0, 0, shape, at, v, wide + (float)shape->radius,
                           SLACK + SLACK_PER_METRE * largest, need, hit, &planes);
            if (stop && bits(*hit)) return;
            unsigned left = bits(need);
            if (left) keep(open, left, PIECE, i, index, v);
        }
    }
}

int NAME(const Scene *s, const double *q, int n, const double *margin, int stop,
         uint8_t *verdict) {
    int found = 0;
    for (int begin = 0; begin < n; begin += W) {
        const int count = n - begin < W ? n - begin : W;
        V angle[JOINTS];
        I alive = (I){0}, hit = (I){0};
        unsigned odd = 0;
        for (int i = 0; i < W; i++) {
            const double *from = q + 6 * (begin + (i < count ? i : 0));
            for (int j = 0; j < JOINTS; j++) {
                angle[j][i] = (float)from[j];
                if (!(__builtin_fabs(from[j]) < LARGEST)) odd |= 1u << i;
            }
            alive[i] = -(i < count && !(odd >> i & 1));
        }
        Frame frame[JOINTS + 1];
        V centre[MOST_BODIES][3];
        Open open; /* large, so only what is read is written */
        open.count = 0, open.lost = odd;
        place(s, angle, frame);
        for (int k = 0; k < s->bodies; k++)
            moved(&frame[s->body[k].joint], s->body[k].centre, centre[k]);

        for (int k = 0; k < s->bodies; k++) {
            if (!(s->with_floor >> k & 1)) continue;
            const Body *b = &s->body[k];
            const V *R = frame[b->joint].R + 6;
            V base = frame[b->joint].p[2] - (float)s->floor_z;
            const float m = (float)(margin[1] + b->radius);
            const float slack =
                SLACK + SLACK_PER_METRE * (1.0f + __builtin_fabsf((float)s->floor_z));
            V low = base + R[0] * b->box_centre[0] + R[1] * b->box_centre[1] +
                    R[2] * b->box_centre[2] - magnitude(R[0]) * b->box_half[0] -
                    magnitude(R[1]) * b->box_half[1] - magnitude(R[2]) * b->box_half[2];
            I need = alive & ~hit & ~(low > m + slack);
            if (!bits(need)) continue;
            V away[3] = {-R[0], -R[1], -R[2]}, at[3];
            furthest(s->points_f + 3 * b->first, b->count, away, at);
            low = base + R[0] * at[0] + R[1] * at[1] + R[2] * at[2];
            hit |= need & (low < m - slack);
            need &= ~(low < m - slack) & ~(low > m + slack);
            if (bits(need)) keep(&open, bits(need), FLOOR, 0, k, away);
        }
        for (int k = 0; k < s->pairs && !(stop && bits(hit)); k++) {
            const Pair *pair = &s->pair[k];
            const Body *a = &s->body[pair->first], *b = &s->body[pair->second];
            const float m = (float)(margin[pair->margin] + a->radius + b->radius);
            const float slack = SLACK + SLACK_PER_METRE;
            V v[3];
            for (int c = 0; c < 3; c++) v[c] = centre[pair->first][c] - centre[pair->second][c];
            const float reach = a->ball + b->ball + m + slack;
            I need = alive & ~hit & ~(dot(v, v) > reach * reach);
            if (!bits(need)) continue;
            need = iterate(s, a, &frame[a->joint], b, &frame[b->joint], 0, 0, v, m, slack, need,
                           &hit, 0);
            if (bits(need)) keep(&open, bits(need), PAIR, k, 0, v);
        }
        if (s->nodes)
            for (int k = 0; k < s->bodies && !(stop && bits(hit)); k++)
                if (s->node[0].mask >> k & 1)
                    against_obstacles(s, k, &frame[s->body[k].joint], centre[k], (float)margin[1],
                                      alive, &hit, &open, stop);

        const unsigned touching = bits(hit);
        if (stop && touching) return 1;
        for (int i = 0; i < count; i++) {
            int result = open.lost >> i & 1 ? UNKNOWN : FREE, known = 0;
            Pose pose[JOINTS + 1];
            if (touching >> i & 1) result = TOUCHING;
            for (int k = 0; k < open.count && result != TOUCHING; k++) {
                if (!(open.item[k].lanes >> i & 1)) continue;
                if (!known) so101_poses(s, q + 6 * (begin + i), 0, pose), known = 1;
                int one = settle(s, &open, k, i, pose, margin);
                if (one != FREE) result = one;
            }
            verdict[begin + i] = (uint8_t)result;
            found |= result == TOUCHING;
            if (stop && found) return 1;
        }
    }
    return found;
}
