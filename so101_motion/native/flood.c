/* Shows that no path leads from one end to the other: fills the space around one, cell by cell.
 *
 * A cell is a box of joint angles; one joint takes a step from each to the next. It is open if nothing
 * touches at its middle. The caller's margins are smaller than those of a path, because a path need not
 * pass through middles. If no open cell is left before the other end was met, there is no path.
 *
 * The cells may be those of the first joints only. Then one is open if the last joints can stand
 * somewhere: it is closed if the bodies that the first joints carry touch, or if something touches at
 * each of many places of the last ones.
 *
 * Coal is not asked: what is undecided is open. A body that is at its margin to within micrometres at
 * some angle of its joints is that with any of the others: coal was asked 25,000 times, for 2 s.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

#define AT_ONCE 64 /* cells that are checked together, and a few more */
#define MOST_TOGETHER (AT_ONCE + 2 * ARM_JOINTS)
#define PLACES 16 /* places of the last joints that are checked together */
#define BITS 12   /* of a cell's number along a joint */

typedef struct {
    uint64_t *cell;
    int *place; /* a free place of the last joints */
    int count, room;
} Cells;

typedef struct {
    int joints, last; /* of a cell, and the others */
    double first[ARM_JOINTS], size[ARM_JOINTS], lower[ARM_JOINTS], upper[ARM_JOINTS];
    int least[ARM_JOINTS], most[ARM_JOINTS]; /* numbers of the outermost cells */
    uint64_t *known;                         /* cells that were met: a hash table, 0 for none */
    size_t room, count;
    Cells open, rim; /* whose neighbours were not met yet, a stack; those that are closed */
    uint64_t *end;   /* cells of the other end */
    int ends, met;
    int aim[ARM_JOINTS]; /* the first of them */
    double *place;       /* places of the last joints */
    int places;
    Pair *pair; /* those between bodies that the first joints carry */
    int pairs;
    uint32_t carried; /* these bodies */
    long checked;
} Flood;

static uint64_t packed(const Flood *f, const int *cell) {
    uint64_t key = 0;
    for (int j = 0; j < f->joints; j++)
        key = key << BITS | (uint64_t)(cell[j] - f->least[j] + 1);
    return key;
}

static void unpacked(const Flood *f, uint64_t key, int *cell) {
    for (int j = f->joints - 1; j >= 0; j--, key >>= BITS)
        cell[j] = (int)(key & ((1 << BITS) - 1)) + f->least[j] - 1;
}

static void cell_of(const Flood *f, const double *q, int *cell) {
    for (int j = 0; j < f->joints; j++) {
        const int k = (int)floor((q[j] - f->first[j]) / f->size[j] + 0.5);
        cell[j] = k < f->least[j] ? f->least[j] : k > f->most[j] ? f->most[j] : k;
    }
}

static void middle(const Flood *f, const int *cell, double *q) {
    for (int j = 0; j < f->joints; j++)
        q[j] = fmin(fmax(f->first[j] + f->size[j] * cell[j], f->lower[j]), f->upper[j]);
}

/* Whether a cell is new; it is known then. -1 without memory. */
static int enter(Flood *f, uint64_t key) {
    if (2 * f->count >= f->room) {
        const size_t room = f->room ? 2 * f->room : 4096;
        uint64_t *known = calloc(room, sizeof *known);
        if (!known) return -1;
        for (size_t i = 0; i < f->room; i++) {
            if (!f->known[i]) continue;
            size_t k = f->known[i] * 0x9e3779b97f4a7c15u >> 20 & (room - 1);
            while (known[k]) k = (k + 1) & (room - 1);
            known[k] = f->known[i];
        }
        free(f->known);
        f->known = known, f->room = room;
    }
    size_t k = key * 0x9e3779b97f4a7c15u >> 20 & (f->room - 1);
    while (f->known[k] && f->known[k] != key) k = (k + 1) & (f->room - 1);
    if (f->known[k]) return 0;
    f->known[k] = key;
    f->count++;
    return 1;
}

static int push(Cells *c, uint64_t cell, int place) {
    if (c->count == c->room) {
        const int room = c->room ? 2 * c->room : 1024;
        uint64_t *cells = realloc(c->cell, (size_t)room * sizeof *cells);
        if (cells) c->cell = cells;
        int *places = realloc(c->place, (size_t)room * sizeof *places);
        if (places) c->place = places;
        if (!cells || !places) return -1;
        c->room = room;
    }
    c->place[c->count] = place;
    c->cell[c->count++] = cell;
    return 0;
}

/* Enters a cell; 1 if it was new, -1 without memory. */
static int meet(Flood *f, const int *cell, uint64_t *key) {
    *key = packed(f, cell);
    const int is_new = enter(f, *key);
    for (int k = 0; is_new > 0 && k < f->ends; k++) f->met |= f->end[k] == *key;
    return is_new;
}

void so101_flood_free(Flood *f) {
    if (!f) return;
    free(f->known), free(f->open.cell), free(f->open.place), free(f->rim.cell), free(f->rim.place);
    free(f->end), free(f->place), free(f->pair), free(f);
}

/* `size`, `first`: edges and middle of a cell, the first `joints` of five; `roots`, `ends`: configurations,
 * five each; `place`: places of the other joints, the first ones are those at the roots. */
Flood *so101_flood_new(const Scene *s, int joints, const double *size, const double *first,
                       const double *lower, const double *upper, const double *roots, int n_roots, const double *ends,
                       int n_ends, const double *place, int places) {
    Flood *f = calloc(1, sizeof *f);
    if (!f) return 0;
    const size_t row = (size_t)(ARM_JOINTS - joints) * sizeof *place;
    int cell[ARM_JOINTS];
    uint64_t key;
    f->joints = joints, f->last = ARM_JOINTS - joints, f->places = places;
    for (int j = 0; j < joints; j++) {
        f->first[j] = first[j], f->size[j] = size[j], f->lower[j] = lower[j], f->upper[j] = upper[j];
        f->least[j] = (int)fmin(0.0, -ceil((first[j] - lower[j]) / size[j] - 0.5));
        f->most[j] = (int)fmax(0.0, ceil((upper[j] - first[j]) / size[j] - 0.5));
    }
    f->end = malloc((size_t)n_ends * sizeof *f->end);
    f->place = malloc(places * row + 1);
    f->pair = malloc((size_t)s->pairs * sizeof *f->pair + 1);
    if (!f->end || !f->place || !f->pair) goto failed;
    for (int k = 0; k < s->bodies; k++)
        if (s->body[k].joint <= joints) f->carried |= (uint32_t)1 << k;
    for (int k = 0; k < s->pairs; k++)
        if (f->carried >> s->pair[k].first & f->carried >> s->pair[k].second & 1)
            f->pair[f->pairs++] = s->pair[k];
    if (places) memcpy(f->place, place, places * row);
    for (int k = n_ends - 1; k >= 0; k--) {
        cell_of(f, ends + ARM_JOINTS * k, f->aim);
        f->end[f->ends++] = packed(f, f->aim);
    }
    for (int k = 0; k < n_roots; k++) {
        cell_of(f, roots + ARM_JOINTS * k, cell);
        const int is_new = meet(f, cell, &key);
        if (is_new < 0 || (is_new && push(&f->open, key, k))) goto failed;
    }
    return f;
failed:
    so101_flood_free(f);
    return 0;
}

/* Whether the bodies that the first joints carry touch something. */
static int is_shut(const Flood *f, Scene *s, const Level *level, const double *q) {
    Pair *pair = s->pair;
    const int pairs = s->pairs;
    const uint32_t with_floor = s->with_floor, mask = s->nodes ? s->node->mask : 0;
    uint8_t verdict;
    s->pair = f->pair, s->pairs = f->pairs, s->with_floor &= f->carried;
    if (s->nodes) s->node->mask &= f->carried;
    so101_lanes(s, q, 1, level->margin, 0, &verdict);
    s->pair = pair, s->pairs = pairs, s->with_floor = with_floor;
    if (s->nodes) s->node->mask = mask;
    return verdict == TOUCHING;
}

/* A free place of the last joints, from one on; -1 if there is none. */
static int free_place(Flood *f, const Checker *c, const Level *level, const double *cell, int first) {
    double q[PLACES * JOINTS];
    uint8_t verdict[PLACES];
    for (int i = 0; i < f->places; i += PLACES) {
        const int n = f->places - i < PLACES ? f->places - i : PLACES;
        for (int k = 0; k < n; k++) {
            memcpy(q + JOINTS * k, cell, f->joints * sizeof *q);
            memcpy(q + JOINTS * k + f->joints,
                   f->place + f->last * ((first + i + k) % f->places), f->last * sizeof *q);
            q[JOINTS * k + ARM_JOINTS] = c->q_jaw;
        }
        so101_check(c->scene, level, q, n, 0, verdict);
        f->checked += n;
        for (int k = 0; k < n; k++)
            if (verdict[k] != TOUCHING) return (first + i + k) % f->places;
    }
    return -1;
}

/* Goes on until `most` configurations were checked in all. Returns 0 then or if late, 1 if no open cell is
 * left, 2 if the other end was met, -1 if stopped or without memory. */
int so101_flood_run(Flood *f, const Checker *c, long most) {
    uint64_t key[MOST_TOGETHER];
    int from[MOST_TOGETHER], cell[ARM_JOINTS];
    double q[MOST_TOGETHER * JOINTS];
    uint8_t verdict[MOST_TOGETHER];
    Scene *s = c->scene;
    Level level = *c->levels;
    level.id = -1;
    while (!f->met && f->open.count) {
        if (f->checked >= most || s->late) return 0;
        int n = 0;
        while (f->open.count && n < AT_ONCE) {
            const int place = f->open.place[--f->open.count];
            unpacked(f, f->open.cell[f->open.count], cell);
            for (int k = 0; k < 2 * f->joints; k++) { /* steps towards the other end last */
                const int j = k % f->joints, towards = cell[j] < f->aim[j] ? 1 : -1;
                const int step = k < f->joints ? -towards : towards;
                cell[j] += step;
                if (cell[j] >= f->least[j] && cell[j] <= f->most[j]) {
                    const int is_new = meet(f, cell, key + n);
                    if (is_new < 0) return -1;
                    if (is_new) {
                        middle(f, cell, q + JOINTS * n);
                        memcpy(q + JOINTS * n + f->joints, f->place + f->last * place,
                               f->last * sizeof *q);
                        q[JOINTS * n + ARM_JOINTS] = c->q_jaw;
                        from[n++] = place;
                    }
                }
                cell[j] -= step;
            }
        }
        so101_check(s, &level, q, n, 0, verdict);
        f->checked += n;
        for (int i = 0; i < n; i++) {
            if (verdict[i] == TOUCHING && f->last && !is_shut(f, s, &level, q + JOINTS * i)) {
                from[i] = free_place(f, c, &level, q + JOINTS * i, from[i]);
                verdict[i] = from[i] < 0 ? TOUCHING : FREE;
            }
            if (s->stopped || push(verdict[i] == TOUCHING ? &f->rim : &f->open, key[i], from[i]))
                return -1;
        }
    }
    return f->met ? 2 : 1;
}

/* The middles of up to n closed cells, spread over all of them, with the last joints as at the first root;
 * returns their number. */
int so101_flood_rim(const Flood *f, int n, double *q) {
    const int count = n < f->rim.count ? n : f->rim.count;
    for (int i = 0; i < count; i++) {
        int cell[ARM_JOINTS];
        unpacked(f, f->rim.cell[(size_t)i * f->rim.count / count], cell);
        middle(f, cell, q + ARM_JOINTS * i);
        memcpy(q + ARM_JOINTS * i + f->joints, f->place, f->last * sizeof *q);
    }
    return count;
}
