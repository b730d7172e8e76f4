/* Finds the point furthest along a direction, LANES points at a time.
 *
 * Compiled once more for processors with wider vectors, see build_native.py; the answer is the same.
 */
#include <math.h>
#include <string.h>

#include "native.h"

#if defined(__AVX2__)
#include <immintrin.h>
#define NAME so101_furthest_avx2
#else
#define NAME so101_furthest_base
#endif

typedef float V __attribute__((vector_size(4 * LANES)));
typedef int32_t I __attribute__((vector_size(4 * LANES)));

static inline V pick(I m, V a, V b) {
#if defined(__AVX2__)
    return (V)_mm256_blendv_ps((__m256)b, (__m256)a, (__m256)m);
#else
    return (V)((m & (I)a) | (~m & (I)b));
#endif
}

typedef struct {
    V value;
    I at, next; /* where the best values and the next ones are */
} Best;

static inline void look(Best *b, const float *columns, int padded, int i, const float *along, int step) {
    V x, y, z;
    memcpy(&x, columns + i, sizeof x);
    memcpy(&y, columns + padded + i, sizeof y);
    memcpy(&z, columns + 2 * padded + i, sizeof z);
    const V value = x * along[0] + y * along[1] + z * along[2];
    const I better = value > b->value;
    b->value = pick(better, value, b->value);
    b->at = (I)pick(better, (V)b->next, (V)b->at);
    b->next += step;
}

/* Two blocks of points take turns, because each comparison has to wait for the one before. */
int NAME(const float *columns, int padded, const float *along) {
    Best even, odd;
    for (int k = 0; k < LANES; k++) {
        even.value[k] = odd.value[k] = -INFINITY;
        even.at[k] = odd.at[k] = 0, even.next[k] = k, odd.next[k] = LANES + k;
    }
    int i = 0;
    for (; i < padded - LANES; i += 2 * LANES) {
        look(&even, columns, padded, i, along, 2 * LANES);
        look(&odd, columns, padded, i + LANES, along, 2 * LANES);
    }
    if (i < padded) look(&even, columns, padded, i, along, 0);
    const I better = odd.value > even.value;
    const V best = pick(better, odd.value, even.value);
    const I at = (I)pick(better, (V)odd.at, (V)even.at);
    int found = 0;
    for (int k = 1; k < LANES; k++)
        if (best[k] > best[found]) found = k;
    return at[found];
}
