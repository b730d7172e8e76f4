/* Vectors of single-precision numbers, one configuration in each lane, and functions on them for
 * lanes.c. The compiler flags of the including file set their width. */
#ifndef SO101_VECTORS_H
#define SO101_VECTORS_H

#include <stdint.h>

#if defined(__AVX2__)
#include <immintrin.h>
#define W 8
#define NAME so101_lanes_avx2
#else
#if defined(__SSE2__)
#include <emmintrin.h>
#endif
#define W 4
#define NAME so101_lanes_base
#endif

typedef float V __attribute__((vector_size(4 * W)));
typedef int32_t I __attribute__((vector_size(4 * W)));

typedef struct {
    V R[9], p[3];
} Frame;

/* The lanes of a mask as bits. */
static inline unsigned bits(I m) {
#if W == 8
    return (unsigned)_mm256_movemask_ps((__m256)m);
#elif defined(__SSE2__)
    return (unsigned)_mm_movemask_ps((__m128)m);
#else
    return (m[0] & 1) | (m[1] & 2) | (m[2] & 4) | (m[3] & 8);
#endif
}

static inline V pick(I m, V a, V b) {
#if W == 8
    return (V)_mm256_blendv_ps((__m256)b, (__m256)a, (__m256)m);
#else
    return (V)((m & (I)a) | (~m & (I)b));
#endif
}
static inline V all(float x) { return x - (V){0}; }
static inline V magnitude(V a) { return (V)((I)a & 0x7fffffff); }

/* Sine and cosine after Cody and Waite, with the polynomials of Cephes; error below 2e-7. */
static inline void sine_cosine(V q, V *sine, V *cosine) {
    const float big = 12582912.0f; /* adding it rounds to whole numbers */
    V k = (q * 0.63661977f + big) - big;
    V r = q - k * 1.5703125f;
    r -= k * 4.83751297e-4f;
    r -= k * 7.54978995e-8f;
    V z = r * r;
    V s = r + r * z * (-1.6666654611e-1f + z * (8.3321608736e-3f - z * 1.9515295891e-4f));
    V c = 1.0f - 0.5f * z +
          z * z * (4.166664568298827e-2f + z * (-1.388731625493765e-3f + z * 2.443315711809948e-5f));
    I quarter = __builtin_convertvector(k, I);
    I odd = -(quarter & 1);
    V sa = pick(odd, c, s), ca = pick(odd, s, c);
    *sine = (V)((I)sa ^ ((quarter & 2) << 30));
    *cosine = (V)((I)ca ^ (((quarter + 1) & 2) << 30));
}

static inline void moved(const Frame *f, const float *point, V *out) {
    for (int r = 0; r < 3; r++)
        out[r] = f->p[r] + f->R[3 * r] * point[0] + f->R[3 * r + 1] * point[1] +
                 f->R[3 * r + 2] * point[2];
}

static inline V dot(const V *a, const V *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* The point that lies furthest along a direction, in each lane. */
static inline void furthest(const float *points, int count, const V *n, V *out) {
    V x = all(points[0]), y = all(points[1]), z = all(points[2]);
    V best = n[0] * points[0] + n[1] * points[1] + n[2] * points[2];
    for (int i = 1; i < count; i++) {
        const float *p = points + 3 * i;
        V value = n[0] * p[0] + n[1] * p[1] + n[2] * p[2];
        I better = value > best;
        best = pick(better, value, best);
        x = pick(better, all(p[0]), x);
        y = pick(better, all(p[1]), y);
        z = pick(better, all(p[2]), z);
    }
    out[0] = x, out[1] = y, out[2] = z;
}

#endif
