/* Copies the bodies of a scene from batch_check.py, builds the tree of obstacles, and chooses the
 * width of the vectors. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

#define LARGE 0.06 /* boxes with a larger sum of edges get a core [m]; chosen */
#define PIECES 4 /* most of a leaf */

Lanes so101_lanes = so101_lanes_base;
Furthest so101_furthest = so101_furthest_base;

#if defined(__x86_64__)
#include <cpuid.h>

/* Whether processor and system support the instructions that lanes.c was compiled for; asked of the
 * processor itself because not every compiler's builtin works. */
static int can_use(void) {
    unsigned a, b, c, d, low, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c >> 27 & 1)) return 0; /* osxsave */
    const unsigned first = 1u << 12 | 1u << 22 | 1u << 28 | 1u << 29; /* fma movbe avx f16c */
    if ((c & first) != first) return 0;
    if (!__get_cpuid(0x80000001, &a, &b, &c, &d) || !(c >> 5 & 1)) return 0; /* lzcnt */
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d)) return 0;
    const unsigned wanted = 1u << 3 | 1u << 5 | 1u << 8, saved = 0x6; /* bmi1 avx2 bmi2 */
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return (b & wanted) == wanted && (low & saved) == saved;
}
#endif

/* Chooses how many configurations are checked at once: 4 or 8, at most `most`; returns it. Sixteen were
 * no quicker among boxes, and slower among points (on a processor of 2023). */
int so101_start(int most) {
    so101_lanes = so101_lanes_base;
    so101_furthest = so101_furthest_base;
#if defined(__x86_64__)
    if (most >= 8 && can_use()) {
        so101_furthest = so101_furthest_avx2;
        so101_lanes = so101_lanes_avx2;
        return 8;
    }
#endif
    return 4;
}

void so101_free(Scene *s) {
    if (!s) return;
    free(s->points), free(s->points_f), free(s->columns), free(s->pair), free(s->shape);
    free(s->shape_points), free(s->shape_points_f), free(s->piece), free(s->node);
    free(s->nearest), free(s);
}

/* A box in single precision that contains the one between low and high. */
static void boxed(const double *low, const double *high, float *middle, float *half) {
    for (int c = 0; c < 3; c++) {
        middle[c] = (float)(0.5 * (low[c] + high[c]));
        const double away = fmax(high[c] - middle[c], middle[c] - low[c]);
        half[c] = (float)(away + 1e-6 + SLACK_PER_METRE * (away + fabs(middle[c])));
    }
}

static float *in_single(const double *points, int n) {
    float *out = malloc((size_t)(n ? n : 1) * sizeof *out);
    if (out)
        for (int i = 0; i < n; i++) out[i] = (float)points[i];
    return out;
}

/* The points of all bodies by columns, for furthest.c; 0 without memory. */
static float *in_columns(Scene *s, const double *points, const int *first) {
    int room = 0;
    for (int k = 0; k < s->bodies; k++) {
        s->body[k].padded = (first[k + 1] - first[k] + LANES - 1) / LANES * LANES;
        room += 3 * s->body[k].padded;
    }
    float *out = malloc((size_t)(room ? room : 1) * sizeof *out), *at = out;
    for (int k = 0; out && k < s->bodies; k++) {
        const int m = s->body[k].padded, n = first[k + 1] - first[k];
        s->body[k].columns = at;
        for (int c = 0; c < 3; c++)
            for (int i = 0; i < m; i++)
                *at++ = (float)points[3 * (first[k] + (i < n ? i : n - 1)) + c];
    }
    return out;
}

static void *copied(const void *from, size_t size) {
    void *out = malloc(size ? size : 1);
    if (out && size) memcpy(out, from, size);
    return out;
}

static void bounds(const double *points, int n, double *low, double *high, double *mean) {
    for (int c = 0; c < 3; c++) {
        low[c] = INFINITY, high[c] = -INFINITY, mean[c] = 0.0;
        for (int i = 0; i < n; i++) {
            const double x = points[3 * i + c];
            low[c] = fmin(low[c], x), high[c] = fmax(high[c], x), mean[c] += x / n;
        }
    }
}

/* The body's line: from the mean of the points near one end to that near the other. */
static void fill_spine(Body *b, const double *points, const double *low, const double *high) {
    int axis = 0;
    for (int c = 1; c < 3; c++)
        if (high[c] - low[c] > high[axis] - low[axis]) axis = c;
    const double near = 0.2 * (high[axis] - low[axis]);
    for (int end = 0; end < 2; end++) {
        double sum[3] = {0.0, 0.0, 0.0};
        int count = 0;
        for (int i = 0; i < b->count; i++) {
            const double x = points[3 * i + axis];
            if (end ? x < high[axis] - near : x > low[axis] + near) continue;
            for (int c = 0; c < 3; c++) sum[c] += points[3 * i + c];
            count++;
        }
        for (int c = 0; c < 3; c++) b->spine[end][c] = (float)(sum[c] / count);
    }
}

static void fill_body(Body *b, const double *points) {
    double low[3], high[3], mean[3];
    bounds(points, b->count, low, high, mean);
    boxed(low, high, b->box_centre, b->box_half);
    fill_spine(b, points, low, high);
    for (int c = 0; c < 3; c++) b->centre[c] = (float)mean[c];
    b->ball = 0.0f;
    for (int i = 0; i < b->count; i++) {
        double square = 0.0;
        for (int c = 0; c < 3; c++) square += pow(points[3 * i + c] - b->centre[c], 2.0);
        b->ball = fmaxf(b->ball, (float)sqrt(square) + SLACK);
    }
}

/* Whether the points are the corners of a box along the base's axes. */
static int is_box(const double *points, int count, const double *low, const double *high) {
    int corners = 0;
    for (int i = 0; i < count; i++) {
        int corner = 0;
        for (int c = 0; c < 3; c++) {
            const double x = points[3 * i + c];
            if (x != low[c] && x != high[c]) return 0;
            corner |= (x == high[c]) << c;
        }
        corners |= 1 << corner;
    }
    return corners == 0xff;
}

/* `largest`: the largest coordinate of this shape's places. */
static void fill_shape(Shape *f, const double *points, double largest) {
    double low[3], high[3], mean[3];
    bounds(points, f->count, low, high, mean);
    f->reach = (float)f->radius;
    const int is_large = high[0] - low[0] + high[1] - low[1] + high[2] - low[2] > LARGE;
    if (is_large && is_box(points, f->count, low, high))
        for (int c = 0; c < 3; c++)
            f->core[c] =
                (float)(0.5 * (high[c] - low[c]) - SLACK - 2.0 * SLACK_PER_METRE * (largest + 1.0));
    for (int c = 0; c < 3; c++) {
        f->inside[c] = (float)mean[c];
        f->reach = fmaxf(f->reach, (float)(fmax(-low[c], high[c]) + f->radius));
        low[c] -= f->radius, high[c] += f->radius;
    }
    boxed(low, high, f->middle, f->half);
    for (int c = 0; c < 3; c++) f->half[c] += SLACK_PER_METRE * (float)largest;
}

/* Partitions pieces along an axis so that the `k`-th is in its place, smaller ones before it. */
static void divide(Piece *p, int n, int k, int axis) {
    int low = 0, high = n - 1;
    while (low < high) {
        const double pivot = p[(low + high) / 2].at[axis];
        int i = low, j = high;
        while (i <= j) {
            while (p[i].at[axis] < pivot) i++;
            while (p[j].at[axis] > pivot) j--;
            if (i <= j) {
                const Piece t = p[i];
                p[i++] = p[j];
                p[j--] = t;
            }
        }
        if (k <= j) high = j;
        else if (k >= i) low = i;
        else return;
    }
}

static void build_tree(Scene *s, int index, int first, int count) {
    Node *node = &s->node[index];
    double low[3], high[3], least[3], most[3];
    node->mask = 0, node->object = s->piece[first].object;
    for (int c = 0; c < 3; c++) low[c] = least[c] = INFINITY, high[c] = most[c] = -INFINITY;
    for (int i = first; i < first + count; i++) {
        const Shape *f = &s->shape[s->piece[i].shape];
        node->mask |= s->piece[i].mask;
        if (s->piece[i].object != node->object) node->object = -1;
        for (int c = 0; c < 3; c++) {
            const double at = s->piece[i].at[c], middle = at + f->middle[c];
            low[c] = fmin(low[c], middle - f->half[c]);
            high[c] = fmax(high[c], middle + f->half[c]);
            least[c] = fmin(least[c], at), most[c] = fmax(most[c], at);
        }
    }
    boxed(low, high, node->middle, node->half);
    if (count <= PIECES) {
        node->first = first, node->count = count;
        return;
    }
    int axis = 0;
    for (int c = 1; c < 3; c++)
        if (most[c] - least[c] > most[axis] - least[axis]) axis = c;
    const int left = count / 2, child = s->nodes;
    divide(s->piece + first, count, left, axis);
    node->first = child, node->count = 0;
    s->nodes += 2;
    build_tree(s, child, first, left);
    build_tree(s, child + 1, first + left, count - left);
}

/* Makes a scene; 0 without memory. All arrays are copied; `first` has one more than bodies or shapes. */
Scene *so101_new(const double *offsets, int bodies, const int *joint, const int *first,
                 const double *points, const double *radius, int pairs, const int *pair,
                 uint32_t with_floor, double floor_z, int shapes, const int *shape_first,
                 const double *shape_points, const double *shape_radius, int pieces,
                 const double *at, const int *shape, const uint32_t *mask, const int *object,
                 int objects, Ask ask) {
    Scene *s = calloc(1, sizeof *s);
    double *largest = calloc((size_t)shapes + 1, sizeof *largest);
    if (!s || !largest || bodies > MOST_BODIES) goto failed;
    memcpy(s->offset, offsets, sizeof s->offset);
    s->bodies = bodies, s->pairs = pairs, s->with_floor = with_floor, s->floor_z = floor_z;
    s->ask = ask, s->next_ask = 1;
    s->points = copied(points, 3 * (size_t)first[bodies] * sizeof *points);
    s->points_f = in_single(points, 3 * first[bodies]);
    s->columns = in_columns(s, points, first);
    s->pair = copied(pair, (size_t)pairs * sizeof *s->pair);
    s->shape = calloc((size_t)shapes + 1, sizeof *s->shape);
    s->shape_points = copied(shape_points, 3 * (size_t)shape_first[shapes] * sizeof *points);
    s->shape_points_f = in_single(shape_points, 3 * shape_first[shapes]);
    s->piece = calloc((size_t)pieces + 1, sizeof *s->piece);
    s->node = calloc(2 * (size_t)pieces + 1, sizeof *s->node);
    s->objects = objects;
    s->nearest = calloc((size_t)objects + 1, NEAR_ROW * sizeof *s->nearest);
    if (!s->points || !s->points_f || !s->columns || !s->pair || !s->shape || !s->shape_points ||
        !s->shape_points_f || !s->piece || !s->node || !s->nearest)
        goto failed;
    for (int k = 0; k < bodies; k++) {
        s->body[k].joint = joint[k], s->body[k].first = first[k];
        s->body[k].count = first[k + 1] - first[k], s->body[k].radius = radius[k];
        fill_body(&s->body[k], points + 3 * first[k]);
    }
    for (int i = 0; i < pieces; i++) {
        memcpy(s->piece[i].at, at + 3 * i, 3 * sizeof *at);
        s->piece[i].shape = shape[i], s->piece[i].mask = mask[i], s->piece[i].object = object[i];
        for (int c = 0; c < 3; c++)
            largest[shape[i]] = fmax(largest[shape[i]], fabs(at[3 * i + c]));
    }
    for (int k = 0; k < shapes; k++) {
        s->shape[k].first = shape_first[k], s->shape[k].count = shape_first[k + 1] - shape_first[k];
        s->shape[k].radius = shape_radius[k];
        fill_shape(&s->shape[k], shape_points + 3 * shape_first[k], largest[k]);
    }
    if (pieces) {
        s->nodes = 1;
        build_tree(s, 0, 0, pieces);
    }
    free(largest);
    return s;
failed:
    free(largest);
    so101_free(s);
    return 0;
}

/* Lets a scene go on after it was stopped or late. */
void so101_resume(Scene *s) { s->late = s->stopped = 0; }

/* Whether it was stopped, whether time was up, configurations checked, and those decided by coal. */
void so101_tally(const Scene *s, long *out) {
    out[0] = s->stopped, out[1] = s->late, out[2] = s->looked_at, out[3] = s->undecided;
}
