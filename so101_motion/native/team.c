/* Checks configurations and lines of several arms, each against its own scene and the other arms.
 * Quick checks come first: an arm against its scene, then arms against each other at single places
 * of a line, then the proof that they keep apart all along it.
 */
#include <string.h>

#include "native.h"

#define AS_LONG 200 /* configurations take as long to check as the line of two arms; measured */

static const double SHARES[] = {0.5, 0.25, 0.75};

int so101_team_is_over(const Team *m) {
    int late = 0;
    for (int i = 0; i < m->arms; i++) {
        if (m->arm[i].scene->stopped) return STOPPED;
        late |= m->arm[i].scene->late;
    }
    return late ? LATE : 0;
}

/* Whether arms keep apart that go straight from `a` to `b`, or stand at `a` if `b` is 0. */
static int are_apart(const Team *m, const double *a, const double *b) {
    for (int k = 0; k < m->couples; k++) {
        const Couple *c = &m->couple[k];
        double q[2][2][JOINTS], out[4];
        for (int which = 0; which < 2; which++) {
            const int arm = which ? c->second : c->first;
            for (int end = 0; end < 2; end++) {
                const double *from = (end && b ? b : a) + ARM_JOINTS * arm;
                memcpy(q[which][end], from, ARM_JOINTS * sizeof *from);
                q[which][end][ARM_JOINTS] = m->arm[arm].q_jaw;
            }
        }
        m->arm->scene->next_ask -= b ? AS_LONG : AS_LONG / 8;
        if (so101_apart(c->a, c->b, c->placement, c->levers_a, c->levers_b, b ? 2 : 1, q[0][0],
                        q[1][0], m->room, 0.0, out) != FREE)
            return 0;
    }
    return 1;
}

/* Whether all arms keep apart at a configuration. */
int so101_team_is_apart(const Team *m, const double *q) { return are_apart(m, q, 0); }

/* Verdicts of n configurations, at most MOST_AT_ONCE, of each arm alone in its scene. */
void so101_team_check(const Team *m, const double *q, int n, uint8_t *verdict) {
    double full[MOST_AT_ONCE * JOINTS];
    uint8_t own[MOST_AT_ONCE];
    memset(verdict, FREE, (size_t)n);
    for (int k = 0; k < m->arms; k++) {
        const Checker *c = &m->arm[k];
        for (int i = 0; i < n; i++) {
            memcpy(full + JOINTS * i, q + ARM_JOINTS * (m->arms * i + k), ARM_JOINTS * sizeof *q);
            full[JOINTS * i + ARM_JOINTS] = c->q_jaw;
        }
        so101_check(c->scene, c->levels, full, n, 0, own);
        for (int i = 0; i < n; i++) verdict[i] |= own[i];
    }
}

int so101_team_is_free(const Team *m, const double *q) {
    uint8_t verdict;
    so101_team_check(m, q, 1, &verdict);
    return verdict == FREE && are_apart(m, q, 0);
}

static int is_clear(const Checker *c, const double *a, const double *b, int ends) {
    if (c->proven) {
        double line[2 * ARM_JOINTS], blocked[ARM_JOINTS];
        memcpy(line, a, sizeof blocked);
        memcpy(line + ARM_JOINTS, b, sizeof blocked);
        return so101_first_blocked(c->scene, c->levels, c->n_levels, c->reach, line, 2, c->q_jaw,
                                   blocked) == FREE;
    }
    return so101_is_clear(c->scene, c->levels, c->reach, c->spacing, a, b, c->q_jaw, ends);
}

/* Whether a line is clear; with 1 `ends` `b` has not been checked, with 2 neither end has. */
int so101_team_is_clear(const Team *m, const double *a, const double *b, int ends) {
    for (int k = 0; k < m->arms; k++)
        if (!is_clear(&m->arm[k], a + ARM_JOINTS * k, b + ARM_JOINTS * k, ends)) return 0;
    if (m->couples == 0) return 1;
    if (ends == 1 && !are_apart(m, b, 0)) return 0;
    for (int i = 0; ends == 2 && i < (int)(sizeof SHARES / sizeof *SHARES); i++) {
        double q[MOST_JOINTS];
        for (int j = 0; j < ARM_JOINTS * m->arms; j++) q[j] = a[j] + SHARES[i] * (b[j] - a[j]);
        if (!are_apart(m, q, 0)) return 0;
    }
    return are_apart(m, a, b);
}
