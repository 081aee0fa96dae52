/* SPDX-License-Identifier: MIT */
/* Symmetric Gauss-Seidel by the 3x3 blocks of nodes, in single precision: a smoother of multigrid.

   A smoother need not be exact, and what a sweep costs is reading the matrix: of a symmetric one
   half is enough, in blocks half of the column numbers and more go, and so does half of each
   number. Where a node is so much stiffer one way than another that single precision would lose the
   latter, the least pivot tells. Blocks are kept by columns of three numbers: a register has the next one,
   too, which meets a 0 or goes where nobody looks. Inverses have columns of four, the last one 0. */
#ifndef VARIFORM_SWEEPS_H
#define VARIFORM_SWEEPS_H

#include <float.h>
#include <math.h>
#include <stdint.h>

typedef float quad_t __attribute__((vector_size(16), aligned(4), may_alias));

/* What is kept of a matrix A / scale: blocks left of the diagonal, inverses of those on it. */
typedef struct {
  int nodes;
  int32_t *starts, *columns; /* of each row of blocks; of each block, by nodes */
  float *blocks, *inverse;   /* 9 numbers each, and one behind them all that is 0; 12 each */
  double scale;
} sweeps_t;

static inline quad_t quad(const float *at)
{
  return *(const quad_t *)at;
}

/* Columns of the inverse of a symmetric block D, 0 for rows that are empty. Returns its least pivot over
   the entry on the diagonal, between 0 and 1: of as much a solve by D loses digits; below 0 where D is
   not positive. */
static inline double invert_block(const double D[9], float inverse[12])
{
  double scale[3], S[9], cofactors[9];
  int negative = 0;
  for (int i = 0; i < 3; i++) {
    scale[i] = D[4 * i] > 0 ? 1 / sqrt(D[4 * i]) : 0;
    negative |= D[4 * i] < 0;
  }
  for (int n = 0; n < 9; n++)
    S[n] = n % 4 ? scale[n / 3] * D[n] * scale[n % 3] : 1;
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 3; c++) {
      const int r1 = (r + 1) % 3, r2 = (r + 2) % 3, c1 = (c + 1) % 3, c2 = (c + 2) % 3;
      cofactors[3 * r + c] = S[3 * r1 + c1] * S[3 * r2 + c2] - S[3 * r1 + c2] * S[3 * r2 + c1];
    }
  const double det = S[0] * cofactors[0] + S[1] * cofactors[1] + S[2] * cofactors[2];
  for (int n = 0; n < 12; n++) {
    const int r = n % 4, c = n / 4;
    const double entry = r == 3 ? 0 : det > DBL_EPSILON ? cofactors[3 * c + r] / det : r == c;
    inverse[n] = r == 3 ? 0 : (float)(scale[r] * entry * scale[c]);
  }
  const double second = cofactors[8]; /* the first is 1 */
  return negative ? -1 : second > 0 ? fmin(second, det / second) : second;
}

/* Number of blocks left of the diagonal of a matrix in compressed rows; -1 where it is not one of
   full 3x3 blocks with those of the diagonal. */
long sweeps_count(int nodes, const int32_t *rows, const int32_t *columns)
{
  long count = 0;
  for (long i = 0; i < nodes; i++) {
    const int32_t *row = rows + 3 * i, length = row[1] - row[0];
    int diagonal = 0;
    if (length % 3 || row[2] - row[1] != length || row[3] - row[2] != length)
      return -1;
    for (int32_t k = 0; k < length; k++) {
      const int32_t column = columns[row[0] + k];
      if (column != columns[row[1] + k] || column != columns[row[2] + k] || column % 3 != k % 3 ||
          column / 3 != columns[row[0] + k - k % 3] / 3)
        return -1;
      diagonal |= column == 3 * i;
      count += column % 3 == 0 && column < 3 * i;
    }
    if (!diagonal)
      return -1;
  }
  return count;
}

/* Take the blocks of a matrix for which sweeps_count() has found their number; the least pivot of those on
   the diagonal. */
double sweeps_fill(sweeps_t *s, const int32_t *rows, const int32_t *columns, const double *values)
{
  long at = 0;
  double least = 1;
  s->scale = 0;
  for (long i = 0; i < 3L * s->nodes; i++)
    for (int32_t k = rows[i]; k < rows[i + 1]; k++)
      if (columns[k] == i)
        s->scale = fmax(s->scale, fabs(values[k]));
  const double factor = s->scale > 0 ? 1 / s->scale : 0;
  for (int i = 0; i < s->nodes; i++) {
    const int32_t *row = rows + 3L * i;
    s->starts[i] = (int32_t)at;
    for (int32_t k = 0; k < row[1] - row[0]; k += 3) {
      const int j = columns[row[0] + k] / 3;
      if (j > i)
        break;
      if (j == i) {
        double D[9];
        for (int n = 0; n < 9; n++)
          D[n] = factor * values[row[n / 3] + k + n % 3];
        least = fmin(least, invert_block(D, s->inverse + 12L * i));
        continue;
      }
      float *block = s->blocks + 9 * at;
      for (int n = 0; n < 9; n++)
        block[n] = (float)(factor * values[row[n % 3] + k + n / 3]);
      s->columns[at++] = j;
    }
  }
  s->starts[s->nodes] = (int32_t)at;
  s->blocks[9 * at] = 0;
  return least;
}

/* B x of an inverse. */
static inline quad_t times(const float *B, quad_t x)
{
  return quad(B) * x[0] + quad(B + 4) * x[1] + quad(B + 8) * x[2];
}

/* B^T x of a block, where the fourth number of x is 0: the sums of three products, by turning them. */
static inline quad_t transposed_times(const float *B, quad_t x)
{
  const quad_t none = {0}, p = quad(B) * x, q = quad(B + 3) * x, r = quad(B + 6) * x;
  const quad_t pq = __builtin_shufflevector(p, q, 0, 4, 1, 5) +
                    __builtin_shufflevector(p, q, 2, 6, 3, 7);
  const quad_t r0 = __builtin_shufflevector(r, none, 0, 4, 1, 5) +
                    __builtin_shufflevector(r, none, 2, 6, 3, 7);
  return __builtin_shufflevector(pq, r0, 0, 1, 4, 5) + __builtin_shufflevector(pq, r0, 2, 3, 6, 7);
}

/* Three numbers, times a factor. */
static inline quad_t rounded(const double *x, double factor)
{
  return (quad_t){(float)(factor * x[0]), (float)(factor * x[1]), (float)(factor * x[2]), 0};
}

/* Row i of L, times y; of the result three numbers are meant. */
static inline quad_t row_times(const sweeps_t *s, long i, const float *y)
{
  quad_t a = {0}, a1 = {0}, a2 = {0};
  for (int32_t k = s->starts[i]; k < s->starts[i + 1]; k++) {
    const float *B = s->blocks + 9L * k, *z = y + 4L * s->columns[k];
    a += quad(B) * z[0];
    a1 += quad(B + 3) * z[1];
    a2 += quad(B + 6) * z[2];
  }
  return a + a1 + a2;
}

/* One sweep forwards from x and one backwards, and the residual r = b - A x after both.

     (D + L) y = b - L^T x,  (D + L^T) z = b - L y,  b - A z = L (y - z)

   z goes into x, from 0 if `from_zero`; r may be NULL. The products with L^T are given to earlier
   nodes from later ones. Numbers are scaled by those of b and A. `room` has 8 numbers a node. */
void sweeps_apply(const sweeps_t *s, const double *b, double *x, int from_zero, double *r,
                  float *room)
{
  const long nodes = s->nodes;
  float *given = room + 4 * nodes;
  double most = 0, finite = 0;
  for (long i = 0; i < 3 * nodes; i++) {
    finite += b[i] * 0;
    most = fmax(most, fabs(b[i]));
  }
  most = finite == 0 ? (most > 0 ? most : 1) : NAN;
  const double factor = 1 / most, back = s->scale > 0 ? most / s->scale : 0;
  const double before = s->scale / most;
  for (long i = 0; i < 4 * nodes; i++)
    given[i] = 0;
  for (long i = 0; !from_zero && i < nodes; i++) {
    const quad_t old = rounded(x + 3 * i, before);
    for (int32_t k = s->starts[i]; k < s->starts[i + 1]; k++)
      *(quad_t *)(given + 4L * s->columns[k]) += transposed_times(s->blocks + 9L * k, old);
  }
  for (long i = 0; i < nodes; i++) {
    const quad_t a = rounded(b + 3 * i, factor) - quad(given + 4 * i) - row_times(s, i, room);
    *(quad_t *)(room + 4 * i) = times(s->inverse + 12 * i, a);
  }
  /* given: L^T x - L^T z. */
  for (long i = nodes - 1; i >= 0; i--) {
    const quad_t more = times(s->inverse + 12 * i, quad(given + 4 * i));
    const quad_t z = quad(room + 4 * i) + more;
    for (int32_t k = s->starts[i]; k < s->starts[i + 1]; k++)
      *(quad_t *)(given + 4L * s->columns[k]) -= transposed_times(s->blocks + 9L * k, z);
    for (int n = 0; n < 3; n++)
      x[3 * i + n] = back * (double)z[n];
    *(quad_t *)(room + 4 * i) = -more;
  }
  for (long i = 0; r && i < nodes; i++) {
    const quad_t left = row_times(s, i, room);
    for (int n = 0; n < 3; n++)
      r[3 * i + n] = most * (double)left[n];
  }
}
#endif
