/* SPDX-License-Identifier: MIT */
/* Numbers of several cells at once, a cell in each lane of the CPU's registers. */
#ifndef VARIFORM_VECTORS_H
#define VARIFORM_VECTORS_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "insertion.h"

#if defined(WIDTH) /* chosen */
#elif defined(__AVX512F__)
#define WIDTH 8
#elif defined(__AVX__)
#define WIDTH 4
#else
#define WIDTH 2
#endif

#ifdef __clang__
#define UNROLLED _Pragma("clang loop unroll(full)")
#else
#define UNROLLED _Pragma("GCC unroll 32")
#endif

typedef double lanes_t __attribute__((vector_size(8 * WIDTH)));
typedef int64_t mask_t __attribute__((vector_size(8 * WIDTH)));

static const lanes_t zero = {0};

static inline lanes_t lanes_choose(mask_t m, lanes_t a, lanes_t b)
{
  return (lanes_t)((m & (mask_t)a) | (~m & (mask_t)b));
}

/* Functions of <math.h>, lane by lane; exponents that are the same in all lanes stay one number. */
#define LANES_OF(f)                                   \
  static inline lanes_t lanes_##f(lanes_t x)          \
  {                                                   \
    for (int k = 0; k < WIDTH; k++) x[k] = f(x[k]);   \
    return x;                                         \
  }
#define LANES_OF_TWO(f)                                        \
  static inline lanes_t lanes_##f(lanes_t x, lanes_t y)        \
  {                                                            \
    for (int k = 0; k < WIDTH; k++) x[k] = f(x[k], y[k]);      \
    return x;                                                  \
  }
LANES_OF(sqrt) LANES_OF(fabs) LANES_OF(cos) LANES_OF(sin) LANES_OF(tan) LANES_OF(acos) LANES_OF(asin)
LANES_OF(atan) LANES_OF(cosh) LANES_OF(sinh) LANES_OF(tanh) LANES_OF(acosh) LANES_OF(asinh) LANES_OF(atanh)
LANES_OF(exp) LANES_OF(log) LANES_OF(erf)
LANES_OF_TWO(pow) LANES_OF_TWO(atan2) LANES_OF_TWO(fmin) LANES_OF_TWO(fmax)

static inline __attribute__((always_inline)) lanes_t lanes_power(lanes_t x, double y)
{
  for (int k = 0; k < WIDTH; k++) x[k] = pow(x[k], y);
  return x;
}

typedef void (*lanes_kernel_t)(lanes_t *, const lanes_t *, const double *, const lanes_t *);

/* The kernel of a part whose kernel computes several cells at once. */
static inline lanes_kernel_t lanes_kernel(const part_t *p) { return (lanes_kernel_t)(void (*)(void))p->kernel; }

/* Coefficients and places of the cells from `first` on in a part; lanes beyond its end repeat the last. */
static inline void gather_cells(const part_t *p, long first, const geometry_t *g, lanes_t *w, lanes_t *x)
{
  for (int k = 0; k < WIDTH; k++) {
    const long e = first + k < p->count ? first + k : p->count - 1;
    const double *from = p->coefficients + e * p->width;
    for (int i = 0; i < p->width; i++) w[i][k] = from[i];
    const int32_t *nodes = g->numbers + (long)g->nodes * p->entities[e];
    for (int i = 0; i < g->nodes; i++)
      for (int a = 0; a < 3; a++) x[3 * i + a][k] = g->x[3 * (long)nodes[i] + a];
  }
}

#endif
