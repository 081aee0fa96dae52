/* SPDX-License-Identifier: MIT */
/* The point kernels over arrays, for tests and for values outside a form. */
#include "point.h"

/* n rows of X (operand, parameters); W, P, A are arrays of n rows, or NULL. */
void points(const operator_t *op, long n, const double *X, int project, double *W, double *P,
            double *A)
{
  points_in_row(op, n, X, project, W, P, A);
}

/* One result of svd(), 3x3 inside, in arrays of its own shape. */
static void store(int rows, int cols, const double u[9], const double t[3], const double v[9],
                  double *U, double *s, double *V)
{
  for (int i = 0; i < rows; i++)
    for (int j = 0; j < rows; j++)
      U[rows * i + j] = u[3 * i + j];
  for (int i = 0; i < cols; i++) {
    s[i] = t[i];
    for (int j = 0; j < cols; j++)
      V[cols * i + j] = v[3 * i + j];
  }
}

/* n matrices F; U (rows x rows), s (min(rows, cols); plane: 3), V (cols x cols), each row-major.
   Like points(), a lone 3x3 matrix is treated by itself and several in lockstep. */
void singular_values(int rows, int cols, int plane, int improper, long n, const double *F,
                     double *U, double *s, double *V)
{
  const long size = rows * cols;
  long p = 0;
#ifdef LANES
  double u[LANES][9], t[LANES][3], v[LANES][9];
  while (size == 9 && !plane && n - p > 1) {
    const int together = n - p < LANES ? (int)(n - p) : LANES;
    svd_lanes(together, size, improper, F + size * p, u, t, v);
    for (int l = 0; l < together; l++, p++)
      store(3, 3, u[l], t[l], v[l], U + 9 * p, s + 3 * p, V + 9 * p);
  }
#endif
  for (; p < n; p++) {
    double u1[9], t1[3], v1[9];
    svd(rows, cols, plane, improper, F + size * p, u1, t1, v1);
    store(rows, cols, u1, t1, v1, U + rows * rows * p, s + cols * p, V + cols * cols * p);
  }
}
