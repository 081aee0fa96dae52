/* SPDX-License-Identifier: MIT */
/* Singular values of four 3x3 matrices at once: the rotations of svd.h on vectors of four numbers.

   Pays with AVX2 only (1.6 times as fast as one by one; without it half as fast). A matrix that is
   done waits for the others: rotating it by the angle 0 changes no digit. */
#ifndef VARIFORM_LANES_H
#define VARIFORM_LANES_H

#include <stdint.h>

#include "svd.h"

#ifdef __AVX2__
#define LANES 4

typedef double lanes_t __attribute__((vector_size(8 * LANES)));
typedef int64_t mask_t __attribute__((vector_size(8 * LANES)));

static inline lanes_t choose(mask_t m, lanes_t a, lanes_t b)
{
  return (lanes_t)((m & (mask_t)a) | (~m & (mask_t)b));
}

static inline lanes_t absolute(lanes_t a)
{
  return choose(a < 0, -a, a);
}

static inline lanes_t dot_lanes(const lanes_t a[3], const lanes_t b[3])
{
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* rotate_pair() without branches; the mask says where other pairs have to be looked at again. */
static inline mask_t rotate_lanes(lanes_t a[3], lanes_t b[3], lanes_t va[3], lanes_t vb[3])
{
  const lanes_t zero = {0}, one = zero + 1;
  const lanes_t aa = dot_lanes(a, a), bb = dot_lanes(b, b), ab = dot_lanes(a, b);
  const lanes_t square = ab * ab, size = aa * bb;
  const mask_t apart = square > DBL_EPSILON * DBL_EPSILON * size + 1e-150;
  const mask_t exchange = bb > aa;
  const lanes_t z = absolute(bb - aa), h = 2 * absolute(ab);
  const lanes_t n = h * (z + 0.7413 * h), d = (4 * z + 2.9652 * h) * z + 1.7897 * h * h;
  const lanes_t scale = one / choose(apart, n * n + d * d, one);
  const lanes_t turned = 2 * n * d * scale, s = choose(exchange ^ (ab > 0), -turned, turned);
  const lanes_t c0 = choose(apart, (d * d - n * n) * scale, one), s0 = choose(apart, s, zero);
  const mask_t again = apart & ((square > 1e-17 * size) | (s0 * s0 > 1e-17));
  const lanes_t c1 = choose(exchange, s0, c0), s1 = choose(exchange, -c0, s0);
  for (int i = 0; i < 3; i++) {
    const lanes_t x = a[i], y = b[i], vx = va[i], vy = vb[i];
    a[i] = c1 * x - s1 * y;
    b[i] = s1 * x + c1 * y;
    va[i] = c1 * vx - s1 * vy;
    vb[i] = s1 * vx + c1 * vy;
  }
  return again | exchange;
}

/* svd() of `count` <= LANES matrices 3x3, the k-th at F + k stride. */
static inline void svd_lanes(int count, long stride, int improper, const double *F, double (*U)[9],
                             double (*s)[3], double (*V)[9])
{
  lanes_t w[3][3], v[3][3];
  int exponent[LANES], usual[LANES];
  for (int k = 0; k < LANES; k++) {
    double columns[3][3] = {{0}};
    usual[k] = k < count && load_columns(3, 3, 3, F + k * stride, columns, &exponent[k]) == 1;
    for (int i = 0; i < 9; i++) {
      w[i / 3][i % 3][k] = usual[k] ? columns[i / 3][i % 3] : i % 4 == 0;
      v[i / 3][i % 3][k] = i % 4 == 0;
    }
  }
  for (int sweep = 0; sweep < SWEEPS; sweep++) {
    mask_t again = rotate_lanes(w[0], w[1], v[0], v[1]);
    again |= rotate_lanes(w[0], w[2], v[0], v[2]);
    again |= rotate_lanes(w[1], w[2], v[1], v[2]);
    int64_t any = 0;
    for (int k = 0; k < LANES; k++)
      any |= again[k];
    if (!any)
      break;
  }
  for (int k = 0; k < count; k++) {
    if (!usual[k]) {
      svd(3, 3, 0, improper, F + k * stride, U[k], s[k], V[k]);
      continue;
    }
    double columns[3][3], turned[3][3];
    for (int i = 0; i < 9; i++) {
      columns[i / 3][i % 3] = w[i / 3][i % 3][k];
      turned[i / 3][i % 3] = v[i / 3][i % 3][k];
    }
    finish_columns(3, 3, improper, columns, turned, exponent[k], U[k], s[k], V[k]);
  }
}
#endif

#endif
