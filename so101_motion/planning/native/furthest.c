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

int NAME(const float *columns, int padded, const float *along) {
    V best;
    I at, index;
    for (int k = 0; k < LANES; k++) best[k] = -INFINITY, at[k] = 0, index[k] = k;
    for (int i = 0; i < padded; i += LANES) {
        V x, y, z;
        memcpy(&x, columns + i, sizeof x);
        memcpy(&y, columns + padded + i, sizeof y);
        memcpy(&z, columns + 2 * padded + i, sizeof z);
        const V value = x * along[0] + y * along[1] + z * along[2];
        const I better = value > best;
        best = pick(better, value, best);
        at = (I)pick(better, (V)index, (V)at);
        index += LANES;
    }
    int found = 0;
    for (int k = 1; k < LANES; k++)
        if (best[k] > best[found]) found = k;
    return at[found];
}
