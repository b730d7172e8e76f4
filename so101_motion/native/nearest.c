/* Finds the pairs of bodies that are near each other, with nearest points and gradients.
 *
 * A pair is two bodies that joints move, or one of them and the floor or an obstacle. Of an obstacle's
 * pieces the nearest counts; it is searched in the tree, the nearer branch first, and boxes further
 * than the nearest piece so far are skipped.
 */
#include <math.h>
#include <string.h>

#include "native.h"

#define TRUSTED 1e-6 /* coal decides for nearer bodies, or if a distance is less exact [m] */
#define DEEP 64

typedef struct {
    const Scene *scene;
    Pose pose[JOINTS + 1];
    double within;
    int unknown;
} Look;

static double dot(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Adds the speed of a point along a direction [m/rad] by each joint that moves it. */
static void add_rates(const Look *l, int joint, const double *p, const double *n, double sign,
                      double *gradient) {
    for (int j = 1; j <= joint && j < JOINTS; j++) {
        const double *R = l->pose[j].R, *o = l->pose[j].p;
        const double z[3] = {R[2], R[5], R[8]}, r[3] = {p[0] - o[0], p[1] - o[1], p[2] - o[2]};
        const double moved[3] = {z[1] * r[2] - z[2] * r[1], z[2] * r[0] - z[0] * r[2],
                                 z[0] * r[1] - z[1] * r[0]};
        gradient[j - 1] += sign * dot(n, moved);
    }
}

/* Writes a row: pair, distance, the two points, the normal from the first to the second, gradient. */
static void write(const Look *l, double *row, int id, double distance, const double *first,
                  const double *second, const double *normal, int joint_a, int joint_b) {
    row[0] = id, row[1] = distance;
    memcpy(row + 2, first, 3 * sizeof *row);
    memcpy(row + 5, second, 3 * sizeof *row);
    memcpy(row + 8, normal, 3 * sizeof *row);
    memset(row + 11, 0, 5 * sizeof *row);
    add_rates(l, joint_b, second, normal, 1.0, row + 11);
    add_rates(l, joint_a, first, normal, -1.0, row + 11);
}

/* Whether two bodies are within a distance of each other; if so, writes their row. */
static int is_near(Look *l, const Closest *c, double within, double ra, double rb, int id,
                   int joint_a, int joint_b, double *row) {
    if (c->low - ra - rb > within) return 0;
    if (!(c->length > TRUSTED) || !(c->length - c->low < TRUSTED)) {
        l->unknown = 1;
        return 0;
    }
    const double distance = c->length - ra - rb;
    if (distance > within) return 0;
    double normal[3], first[3], second[3];
    for (int i = 0; i < 3; i++) {
        normal[i] = (c->second[i] - c->first[i]) / c->length;
        first[i] = c->first[i] + ra * normal[i];
        second[i] = c->second[i] - rb * normal[i];
    }
    write(l, row, id, distance, first, second, normal, joint_a, joint_b);
    return 1;
}

static void centre_of(const Look *l, int body, double *out) {
    const Body *b = &l->scene->body[body];
    const Pose *pose = &l->pose[b->joint];
    for (int r = 0; r < 3; r++) {
        const double *R = pose->R + 3 * r;
        out[r] = pose->p[r] + R[0] * b->centre[0] + R[1] * b->centre[1] + R[2] * b->centre[2];
    }
}

static double away(const Node *node, const double *centre) {
    double square = 0.0;
    for (int c = 0; c < 3; c++) {
        const double off = fmax(fabs(centre[c] - node->middle[c]) - node->half[c], 0.0);
        square += off * off;
    }
    return sqrt(square);
}

/* Writes the rows of the obstacles near a body to the scene's own memory. */
static void look_around(Look *l, int body, const double *centre) {
    const Scene *s = l->scene;
    const Body *b = &s->body[body];
    const int from = s->pairs + s->bodies;
    for (int o = 0; o < s->objects; o++) s->nearest[NEAR_ROW * o + 1] = INFINITY;
    int stack[2 * DEEP], n = 0;
    if (s->nodes) stack[n++] = 0;
    while (n) {
        const Node *node = &s->node[stack[--n]];
        double enough = l->within;
        if (node->object >= 0) enough = fmin(enough, s->nearest[NEAR_ROW * node->object + 1]);
        if (!(node->mask >> body & 1) || away(node, centre) - b->ball - b->radius > enough) continue;
        if (!node->count) {
            const int left = node->first;
            const int right_first = away(&s->node[left], centre) < away(&s->node[left + 1], centre);
            stack[n++] = left + right_first;
            stack[n++] = left + !right_first;
            continue;
        }
        for (int i = node->first; i < node->first + node->count; i++) {
            const Piece *piece = &s->piece[i];
            if (!(piece->mask >> body & 1)) continue;
            double *row = s->nearest + NEAR_ROW * piece->object;
            const double least = fmin(l->within, row[1]), radius = s->shape[piece->shape].radius;
            const Closest c =
                so101_closest_piece(s, l->pose, body, i, least + b->radius + radius);
            is_near(l, &c, least, b->radius, radius, from + piece->object * s->bodies + body,
                    b->joint, 0, row);
        }
    }
}

/* Writes a row of each pair within `within` [m] at a configuration, at most `most`; returns their
 * number, or -1 if coal has to decide. Pairs are numbered: first of movers, then with the floor by
 * body, then with each obstacle by body. */
int so101_nearest(const Scene *s, const double *q, double within, int most, double *out) {
    Look l = {.scene = s, .within = within};
    double centre[MOST_BODIES][3];
    int n = 0;
    so101_poses(s, q, 0, l.pose);
    for (int i = 0; i < s->bodies; i++) centre_of(&l, i, centre[i]);
    for (int k = 0; k < s->pairs && n < most; k++) {
        const int i = s->pair[k].first, j = s->pair[k].second;
        const Body *a = &s->body[i], *b = &s->body[j];
        const double enough = within + a->radius + b->radius, reach = enough + a->ball + b->ball;
        double square = 0.0;
        for (int c = 0; c < 3; c++) square += pow(centre[i][c] - centre[j][c], 2.0);
        if (square > reach * reach) continue;
        const Closest c = so101_closest_pair(s, l.pose, k, enough);
        n += is_near(&l, &c, within, a->radius, b->radius, k, a->joint, b->joint, out + NEAR_ROW * n);
    }
    for (int i = 0; i < s->bodies && n < most; i++) {
        const Body *b = &s->body[i];
        if (!(s->with_floor >> i & 1)) continue;
        if (centre[i][2] - b->ball - b->radius - s->floor_z > within) continue;
        const double down[3] = {0.0, 0.0, -1.0};
        double low[3];
        so101_lowest(s, l.pose, i, low);
        low[2] -= b->radius;
        const double floor[3] = {low[0], low[1], s->floor_z};
        if (low[2] - s->floor_z <= within)
            write(&l, out + NEAR_ROW * n++, s->pairs + i, low[2] - s->floor_z, low, floor, down,
                  b->joint, 0);
    }
    for (int i = 0; i < s->bodies && s->nodes; i++) {
        look_around(&l, i, centre[i]);
        for (int o = 0; o < s->objects && n < most; o++)
            if (s->nearest[NEAR_ROW * o + 1] < INFINITY)
                memcpy(out + NEAR_ROW * n++, s->nearest + NEAR_ROW * o, NEAR_ROW * sizeof *out);
    }
    return l.unknown ? -1 : n;
}

/* Whether at one of n configurations a pair is closer than its margin by more than `may`, -1 if coal has
 * to decide; both by pair, numbered as above, and no margin is above `within`. `near`: memory for `most`
 * rows. */
int so101_lacks_more(const Scene *s, const double *q, int n, const double *margin, const double *may,
                     double within, int most, double *near) {
    for (int i = 0; i < n; i++) {
        const int found = so101_nearest(s, q + 6 * i, within, most, near);
        if (found < 0) return -1;
        for (const double *row = near; row < near + NEAR_ROW * found; row += NEAR_ROW)
            if (margin[(int)row[0]] - row[1] > may[(int)row[0]]) return 1;
    }
    return 0;
}

/* Like so101_nearest, with a bound for each pair: of a step that keeps it `gap` farther apart than its
 * margin. `margin` and `pair_of`: of each pair its margin, and the caller's number of it for the rows. */
int so101_near_bounds(const Scene *s, const double *q, double within, int most, double *near,
                      const double *margin, const double *pair_of, double gap, double *bound) {
    const int n = so101_nearest(s, q, within, most, near);
    for (int k = 0; k < n; k++, near += NEAR_ROW, bound += BOUND) {
        const int pair = (int)near[0];
        const double room = near[1] - margin[pair];
        near[0] = pair_of[pair];
        memcpy(bound, near + 11, ARM_JOINTS * sizeof *bound);
        bound[ARM_JOINTS] = fmin(0.0, gap - room), bound[ARM_JOINTS + 1] = room;
    }
    return n;
}

/* Writes a row for each pair of bodies of two arms within `within` [m]: the bound of a step that keeps
 * them `gap` farther apart than `margin`, and the two bodies. Returns their number. Bodies that may
 * overlap are left out. `low`: lower bounds of the distances, improved here; `lie`: as in Known. */
int so101_near_arm(const Scene *a, const Pose *at_a, const Scene *b, const Pose *at_b,
                   double low[MOST_BODIES][MOST_BODIES], double lie[MOST_BODIES][MOST_BODIES][3],
                   double within, double margin, double gap, double row[MOST_NEAR][NEAR_ARM_ROW]) {
    Look own = {.scene = a};
    int n = 0;
    memcpy(own.pose, at_a, sizeof own.pose);
    for (int i = 0; i < a->bodies; i++)
        for (int j = 0; j < b->bodies && a->body[i].joint && n < MOST_NEAR; j++) {
            if (low[i][j] > within) continue;
            double point[3], *v = lie[i][j];
            const double apart = so101_gap_at(a, at_a, i, b, at_b, j, within, v, point);
            const double length = sqrt(dot(v, v)), room = apart - margin;
            low[i][j] = fmax(low[i][j], apart);
            if (apart > within || !(length > TRUSTED)) continue;
            const double away[3] = {v[0] / length, v[1] / length, v[2] / length};
            double *here = row[n++];
            memset(here, 0, ARM_JOINTS * sizeof *here);
            add_rates(&own, a->body[i].joint, point, away, 1.0, here);
            here[ARM_JOINTS] = fmax(fmin(0.0, gap - room), -room), here[ARM_JOINTS + 1] = room;
            here[BOUND] = i, here[BOUND + 1] = j;
        }
    return n;
}
