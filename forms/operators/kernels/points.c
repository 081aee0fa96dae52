/* SPDX-License-Identifier: MIT */
/* The point kernels over arrays, for tests and for values outside a form. */
#include "point.h"

/* n rows of X (operand, parameters); W, P, A are arrays of n rows, or NULL. */
void points(const operator_t *op, long n, const double *X, int project, double *W, double *P,
            double *A)
{
  points_in_row(op, n, X, project, W, P, A);
}

/* n matrices F; U (rows x rows), s (min(rows, cols); plane: 3), V (cols x cols), each row-major. */
void singular_values(int rows, int cols, int plane, int improper, long n, const double *F,
                     double *U, double *s, double *V)
{
  for (long p = 0; p < n; p++) {
    double u[9], t[3], v[9];
    svd(rows, cols, plane, improper, F + rows * cols * p, u, t, v);
    for (int i = 0; i < rows; i++)
      for (int j = 0; j < rows; j++)
        U[rows * (rows * p + i) + j] = u[3 * i + j];
    for (int i = 0; i < cols; i++) {
      s[cols * p + i] = t[i];
      for (int j = 0; j < cols; j++)
        V[cols * (cols * p + i) + j] = v[3 * i + j];
    }
  }
}
