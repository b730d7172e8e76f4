/* Checks configurations, straight joint lines and whole motions; collision.py explains how.
 *
 * Arithmetic is in double precision and never contracted, so that the verdicts do not depend on the
 * processor.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

#define CUT 4             /* a part that is not clear is cut into so many */
#define AT_ONCE 64        /* configurations in one go */
#define BETWEEN_ASKS 1024 /* configurations between two questions whether to go on; 0.5 ms */

static void ask_on(Scene *s, int n) {
    s->looked_at += n;
    if (s->looked_at < s->next_ask || s->stopped) return;
    s->next_ask = s->looked_at + BETWEEN_ASKS;
    const int said = s->ask(0, -1);
    if (said == 1) s->late = 1;
    if (said == 2) s->stopped = 1;
}

/* Verdicts without UNKNOWN. When the check is interrupted, all others become TOUCHING. */
int so101_check(Scene *s, const Level *level, const double *q, int n, int stop, uint8_t *verdict) {
    int found = 0;
    for (int i = 0; i < n; i += AT_ONCE) {
        const int m = n - i < AT_ONCE ? n - i : AT_ONCE;
        ask_on(s, m);
        if (s->stopped) {
            memset(verdict + i, TOUCHING, (size_t)(n - i));
            return 1;
        }
        found |= so101_lanes(s, q + 6 * i, m, level->margin, stop, verdict + i);
        if (stop && found) return 1;
        for (int k = i; k < i + m; k++) {
            if (verdict[k] != UNKNOWN) continue;
            s->undecided++;
            const int said = level->id < 0 ? FREE : s->ask(q + 6 * k, level->id);
            if (said == 2) s->stopped = 1;
            verdict[k] = said == FREE ? FREE : TOUCHING;
            found |= said != FREE;
            if (stop && found) return 1;
        }
    }
    return found;
}

static int between(Scene *s, const Level *level, const double *a, const double *step, int count,
                   double q_jaw, const int *at, int n) {
    double q[AT_ONCE * 6];
    uint8_t verdict[AT_ONCE];
    for (int i = 0; i < n; i++) {
        const double share = (double)at[i] / (count + 1);
        for (int j = 0; j < 5; j++) q[6 * i + j] = a[j] + share * step[j];
        q[6 * i + 5] = q_jaw;
    }
    return so101_check(s, level, q, n, 1, verdict);
}

/* Checks a line at samples every `spacing` of travel; with 1 `ends` also `b`, with 2 both ends. */
int so101_is_clear(Scene *s, const Level *level, const double *reach, double spacing,
                   const double *a, const double *b, double q_jaw, int ends) {
    double step[5], travel = 0.0;
    for (int j = 0; j < 5; j++) {
        step[j] = b[j] - a[j];
        travel += fabs(step[j]) * reach[j];
    }
    const int count = (int)(travel / spacing), first = ends < 2, last = count + (ends > 0);
    int at[16], n = 0;
    /* Far apart ones first, sixteen at a time; then those between them. */
    const int stride = (last - first + 16) / 16;
    for (int offset = 0; offset < stride; offset++) {
        n = 0;
        for (int k = last - offset; k >= first; k -= stride) at[n++] = k;
        if (n && between(s, level, a, step, count, q_jaw, at, n)) return 0;
    }
    return !s->stopped;
}

/* The configurations after some travel along a polyline. */
static void along(const double *points, const double *travelled, int n, double q_jaw,
                  const double *at, int count, double *q) {
    int k = 1;
    for (int i = 0; i < count; i++) {
        while (k > 1 && travelled[k - 1] > at[i]) k--;
        while (k < n - 1 && travelled[k] <= at[i]) k++;
        const double *from = points + 5 * (n > 1 ? k - 1 : 0), *to = points + 5 * (n > 1 ? k : 0);
        const double length = n > 1 ? travelled[k] - travelled[k - 1] : 0.0;
        const double part = length > 0.0 ? (at[i] - travelled[k - 1]) / length : 0.0;
        for (int j = 0; j < 5; j++) q[6 * i + j] = from[j] + part * (to[j] - from[j]);
        q[6 * i + 5] = q_jaw;
    }
}

/* Like first_blocked of collision.py: FREE is a proof; TOUCHING fills `blocked`, 5 angles;
 * UNKNOWN if it was told to stop, or has no memory. */
int so101_first_blocked(Scene *s, const Level *levels, int n_levels, const double *reach,
                        const double *points, int n, double q_jaw, double *blocked) {
    int result = UNKNOWN, room = AT_ONCE;
    double *travelled = malloc((size_t)n * sizeof *travelled);
    double *middles = malloc(room * sizeof *middles), *q = malloc(room * 6 * sizeof *q);
    uint8_t *verdict = malloc((size_t)room);
    if (!travelled || !middles || !q || !verdict) goto end;
    travelled[0] = 0.0;
    for (int i = 1; i < n; i++) {
        travelled[i] = travelled[i - 1];
        for (int j = 0; j < 5; j++)
            travelled[i] += fabs(points[5 * i + j] - points[5 * (i - 1) + j]) * reach[j];
    }
    const double total = travelled[n - 1], widest = levels[n_levels - 1].clearance;
    double half = ceil(0.5 * total / widest);
    if (!(half < 1e8)) goto end;
    int count = half < 1.0 ? 1 : (int)half;
    half = 0.5 * total / count;
    for (int first = 1;; first = 0) {
        if (count > room) {
            while (room < count) room *= 2;
            double *more = realloc(middles, (size_t)room * sizeof *middles);
            if (more) middles = more;
            double *more_q = realloc(q, (size_t)room * 6 * sizeof *q);
            if (more_q) q = more_q;
            uint8_t *more_verdict = realloc(verdict, (size_t)room);
            if (more_verdict) verdict = more_verdict;
            if (!more || !more_q || !more_verdict) goto end;
        }
        if (first)
            for (int i = 0; i < count; i++) middles[i] = half + 2.0 * half * i;
        int k = 0;
        while (k < n_levels - 1 && levels[k].clearance < half) k++;
        along(points, travelled, n, q_jaw, middles, count, q);
        int failed = 0;
        for (int i = 0; i < count; i += AT_ONCE) {
            const int m = count - i < AT_ONCE ? count - i : AT_ONCE;
            if (!so101_check(s, &levels[k], q + 6 * i, m, 0, verdict + i)) continue;
            if (s->stopped) goto end;
            for (int j = i; j < i + m; j++) {
                if (verdict[j] != TOUCHING) continue;
                if (k == 0) {
                    memcpy(blocked, q + 6 * j, 5 * sizeof *blocked);
                    result = TOUCHING;
                    goto end;
                }
                middles[failed] = middles[j];
                if (failed != j) memcpy(q + 6 * failed, q + 6 * j, 6 * sizeof *q);
                failed++;
            }
        }
        if (s->stopped) goto end;
        if (!failed) {
            result = FREE;
            goto end;
        }
        if (k == n_levels - 1) { /* most of what is blocked is seen here already */
            uint8_t *seen = verdict;
            if (so101_check(s, &levels[0], q, failed, 0, seen)) {
                if (s->stopped) goto end;
                int i = 0;
                while (seen[i] != TOUCHING) i++;
                memcpy(blocked, q + 6 * i, 5 * sizeof *blocked);
                result = TOUCHING;
                goto end;
            }
        }
        half /= CUT;
        if (failed > room / CUT) {
            double *more = realloc(middles, (size_t)failed * CUT * sizeof *middles);
            if (!more) goto end;
            middles = more;
        }
        for (int i = failed - 1; i >= 0; i--) {
            const double middle = middles[i];
            for (int j = CUT - 1; j >= 0; j--)
                middles[CUT * i + j] = middle + half * (1 - CUT + 2 * j);
        }
        count = failed * CUT;
    }
end:
    free(travelled), free(middles), free(q), free(verdict);
    return result;
}
