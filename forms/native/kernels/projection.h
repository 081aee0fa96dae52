/* SPDX-License-Identifier: MIT */
/* Nearest positive semi-definite matrix to a cell's tangent. */
#ifndef VARIFORM_PROJECTION_H
#define VARIFORM_PROJECTION_H

#include <float.h>
#include <math.h>

typedef void (*factorize_t)(const char *, const int *, double *, const int *, int *);
typedef void (*eigen_t)(const char *, const char *, const int *, double *, const int *, double *, double *,
                        const int *, int *);
/* LAPACK's dpotrf and dsyev, taken from the library that PETSc is linked to. */
static factorize_t dpotrf = 0;
static eigen_t dsyev = 0;

void projection_set(factorize_t factorize, eigen_t eigen)
{
  dpotrf = factorize;
  dsyev = eigen;
}

/* Symmetric K (n x n) with its negative eigenvalues set to 0. Most cells are positive semi-definite
   with the rigid modes at 0: a Cholesky factorization of K + shift, a tenth of the cost, tells. */
static void project_matrix(int n, double *K)
{
  double L[n * n], values[n], work[34 * n];
  int info, length = 34 * n;
  double largest = 0;
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < n; j++) {
      L[n * i + j] = 0.5 * (K[n * i + j] + K[n * j + i]);
      if (!(fabs(L[n * i + j]) <= DBL_MAX)) return; /* not finite: the caller refuses the state */
    }
    if (fabs(L[n * i + i]) > largest) largest = fabs(L[n * i + i]);
  }
  for (int i = 0; i < n; i++) L[n * i + i] += 1e-12 * n * largest;
  dpotrf("U", &n, L, &n, &info);
  if (info == 0) return;
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) L[n * i + j] = 0.5 * (K[n * i + j] + K[n * j + i]);
  dsyev("V", "U", &n, L, &n, values, work, &length, &info);
  if (info != 0) return;
  /* K - sum of the negative part: the positive part keeps its last digits. */
  for (int m = 0; m < n && values[m] < 0; m++)
    for (int i = 0; i < n; i++)
      for (int j = 0; j < n; j++) K[n * i + j] -= values[m] * L[n * m + i] * L[n * m + j];
}

#endif
