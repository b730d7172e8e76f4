/* Tells joints that stand while their setpoints go on; control/following_check.py says how and why. */
#include <math.h>

#include "native.h"

#define MOST 8 /* joints, as in following_check.py */
#define MOST_SPANS 16

typedef struct {
    int joints, kept, lag, before, one_side, windows, stops, window[MOST_SPANS], stop[MOST_SPANS]; /* [tick] */
    double contact_distance, contact_share, nearest, pressed_stray, stands, least_way, most_way;
    double pressed[MOST], in_play[MOST]; /* for how many ticks; as it was at last */
} Watch;

static double sign(double x) { return (x > 0.0) - (x < 0.0); }

/* Whether a joint has moved much less in a window than its setpoints, by whatever lag it is explained best:
 * only then is it no lag. `q` and `wanted` end with the present tick, `n` numbers a tick. */
static int stands(const Watch *w, const double *wanted, const double *seen, int window) {
    const int n = w->joints;
    double low = INFINITY, high = -INFINITY;
    for (int k = 0; k <= w->lag; k++) {
        const double step = wanted[-k * n] - wanted[-(k + window) * n];
        low = fmin(low, step), high = fmax(high, step);
    }
    const double way = low > 0.0 ? low : high < 0.0 ? high : 0.0, moved = seen[0] - seen[-window * n];
    /* One that goes backwards has not met anything, it sags or turns round. One that ran ahead may wait. */
    const double missing = fabs(way) - fmax(sign(way) * moved, 0.0);
    const double less = fmax(w->contact_distance, w->contact_share * fabs(way));
    return missing > less && sign(way) * (wanted[0] - seen[0]) > fmax(0.5 * less, w->nearest);
}

/* Whether a joint followed slowly and evenly until `stop` ticks ago, and stands since. */
static int has_stopped(const Watch *w, const double *wanted, const double *seen, int stop, int i) {
    const int n = w->joints, span = stop + w->before;
    const double side = sign(wanted[0] - wanted[-n]), least = w->pressed_stray;
#define W(k) (side * wanted[-(k) * n])
#define S(k) (side * seen[-(k) * n])
    /* In most ticks no joint has fallen behind since then. */
    if (!(W(0) - S(0) - (W(stop) - S(stop)) > fmin(least, w->in_play[i]))) return 0;
    double farthest = S(0), most = -INFINITY, smallest = INFINITY, slow = INFINITY, fast = -INFINITY;
    for (int k = 1; k <= stop; k++) farthest = fmax(farthest, S(k));
    /* A joint whose load turns round falls back on its motor, which is no farther behind then. */
    if (fmax(farthest - S(stop), farthest - S(0)) > w->stands) return 0;
    for (int k = 0; k < span; k++) {
        const double step = W(k) - W(k + 1);
        slow = fmin(slow, step), fast = fmax(fast, step);
    }
    const double way = W(stop) - W(span), moved = S(stop) - S(span);
    if (!(slow > 0.0 && W(0) - W(1) >= 0.8 * fast)) return 0;
    if (!(way >= w->least_way && way <= w->most_way && moved >= 0.7 * way)) return 0;
    for (int k = stop; k <= span; k++) most = fmax(most, W(k) - S(k)), smallest = fmin(smallest, W(k) - S(k));
    /* One that ran ahead has fallen through its play, whatever the driver knew of its load. */
    const int pressed = w->pressed[i] > stop + w->one_side && !(most - smallest > least);
    return W(0) - farthest - most > (pressed ? least : w->in_play[i]);
}

/* Whether a joint has hardly moved of late; unless one has, all that moved slowly still do. */
static int hardly_moves(const Watch *w, const double *wanted, const double *seen) {
    const int n = w->joints;
    const double side = sign(wanted[0] - wanted[-n]), begun = S(w->stop[0]);
    double farthest = begun;
    for (int k = 0; k < w->stop[0]; k++) farthest = fmax(farthest, S(k));
    return farthest - begun <= w->stands;
}

/* Which joints are held up, as bits. `wanted` and `seen` end before these addresses; `rows` were seen. */
uint32_t so101_held_up(Watch *w, const double *wanted, const double *seen, int rows, const double *in_play) {
    uint32_t held = 0;
    int may_stand = 0;
    wanted -= w->joints, seen -= w->joints;
    if (isfinite(w->pressed_stray) && rows == w->kept)
        for (int i = 0; i < w->joints; i++) may_stand |= hardly_moves(w, wanted + i, seen + i);
    for (int i = 0; i < w->joints; i++, wanted++, seen++) {
        const int presses = in_play[i] == 0.0;
        w->pressed[i] = presses ? w->pressed[i] + 1.0 : 0.0;
        if (!presses) w->in_play[i] = in_play[i];
        int is_held = 0;
        if (fabs(wanted[0] - seen[0]) > w->nearest)
            for (int k = 0; k < w->windows; k++)
                is_held |= rows > w->window[k] && stands(w, wanted, seen, w->window[k]);
        if (may_stand && wanted[0] != wanted[-w->joints])
            for (int k = 0; k < w->stops && !is_held; k++)
                is_held = has_stopped(w, wanted, seen, w->stop[k], i);
        held |= (uint32_t)is_held << i;
    }
    return held;
}
