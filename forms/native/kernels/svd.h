/* SPDX-License-Identifier: MIT */
/* Signed singular values of 3x3, 2x2 and 3x2 matrices: F = U diag(s) V^T.

   One-sided Jacobi: the columns of F are rotated in pairs until they are orthogonal, which needs
   no F^T F and therefore keeps small singular values. A smaller matrix is a 3x3 one whose last
   row or column is zero; U and V are always 3x3, with 1 in the last corner where it is unused. */
#ifndef VARIFORM_SVD_H
#define VARIFORM_SVD_H

#include <float.h>
#include <math.h>

#define SWEEPS 30 /* 4 to 6 suffice, 9 where F is singular; a bound: no input can hang */

static inline double dot(const double a[3], const double b[3])
{
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline int finite_array(const double *x, int n)
{
  int finite = 1;
  for (int i = 0; i < n; i++)
    finite &= fabs(x[i]) <= DBL_MAX;
  return finite;
}

/* Orthogonalize the columns a and b (of F V), the longer one first; va, vb are those of V.
   Returns whether the pair was far enough from done that others may have to be looked at again. */
static inline int rotate_pair(double a[3], double b[3], double va[3], double vb[3])
{
  const double aa = dot(a, a), bb = dot(b, b), ab = dot(a, b);
  double c = 1, s = 0;
  int again = 0;
  /* The floor keeps d^4 > 0, far below what matters beside entries of 1e-3 (see svd_columns). */
  if (ab * ab > DBL_EPSILON * DBL_EPSILON * aa * bb + 1e-150) {
    const double z = fabs(bb - aa), h = 2 * fabs(ab);
    /* tan(angle/2) = tan(atan(h/z)/4) = n/d to 3 % and, for small h/z, to third order: an angle
       without a root, by a matrix that is a rotation to the last digit all the same. */
    const double n = h * (z + 0.7413 * h), d = (4 * z + 2.9652 * h) * z + 1.7897 * h * h;
    const double scale = 1 / (n * n + d * d);
    c = (d * d - n * n) * scale;
    s = 2 * n * d * scale;
    s = (bb > aa) == (ab > 0) ? s : -s;
    /* Convergence is quadratic: angles below 1e-8, between vectors and of rotation, leave 1e-16. */
    again = ab * ab > 1e-17 * aa * bb || s * s > 1e-17;
  } else if (!(bb > aa))
    return 0;
  if (bb > aa) { /* exchange; the sign keeps det V. No iteration ends so: the pairs are new */
    const double old = c;
    c = s;
    s = -old;
    again = 1;
  }
  for (int i = 0; i < 3; i++) {
    const double x = a[i], y = b[i], vx = va[i], vy = vb[i];
    a[i] = c * x - s * y;
    b[i] = s * x + c * y;
    va[i] = c * vx - s * vy;
    vb[i] = s * vx + c * vy;
  }
  return again;
}

/* Unit vector normal to the unit vector u, along w where w leaves a choice worth the name. */
static inline void second_vector(const double u[3], const double w[3], double length, double e[3])
{
  const double scale = 1 / length;
  double norm = 0;
  for (int i = 0; i < 3; i++)
    e[i] = scale * w[i];
  for (int attempt = 0; attempt < 2; attempt++) {
    const double along = dot(e, u);
    for (int i = 0; i < 3; i++)
      e[i] -= along * u[i];
    norm = dot(e, e);
    if (norm > 0.25) /* not so for a zero column (NaN) and a rounding remnant along u: */
      break;         /* there any normal will do */
    const int k = fabs(u[0]) < fabs(u[1]) ? 0 : 1, l = fabs(u[2]) < fabs(u[k]) ? 2 : k;
    e[0] = e[1] = e[2] = 0;
    e[l] = 1;
  }
  norm = 1 / sqrt(norm);
  for (int i = 0; i < 3; i++)
    e[i] *= norm;
}

/* Columns w of the leading rows x cols of a matrix with the given row stride, divided by a power of
   two that changes no digit if they are far from 1. 0 for a zero matrix, -1 if not finite. */
static inline int load_columns(int rows, int cols, int stride, const double *F, double w[3][3],
                               int *exponent)
{
  double largest = 0;
  int finite = 1;
  for (int i = 0; i < rows; i++)
    for (int k = 0; k < cols; k++) {
      const double x = F[stride * i + k];
      w[k][i] = x;
      finite &= fabs(x) <= DBL_MAX;
      largest = fabs(x) > largest ? fabs(x) : largest;
    }
  *exponent = 0;
  if (finite && (largest > 1e3 || largest < 1e-3) && largest > 0) {
    frexp(largest, exponent);
    for (int i = 0; i < 9; i++)
      w[i / 3][i % 3] = ldexp(w[i / 3][i % 3], -*exponent);
  }
  return finite ? largest > 0 : -1;
}

/* U, s and V from orthogonal columns w = F V, the longest first, and the columns v of V. */
static inline void finish_columns(int rows, int cols, int improper, double w[3][3], double v[3][3],
                                  int exponent, double U[9], double s[3], double V[9])
{
  double u[3][3];
  const double s0 = sqrt(dot(w[0], w[0])), inverse = 1 / s0;
  double s1, s2 = 0;
  for (int i = 0; i < 3; i++)
    u[0][i] = inverse * w[0][i];
  if (rows == 2) {
    u[1][0] = -u[0][1], u[1][1] = u[0][0], u[1][2] = 0;
    u[2][0] = u[2][1] = 0, u[2][2] = 1;
    s1 = dot(u[1], w[1]);
    if (improper && s1 < 0) {
      s1 = -s1;
      u[1][0] = -u[1][0], u[1][1] = -u[1][1];
    }
    s1 = fabs(s1) > s0 ? copysign(s0, s1) : s1; /* sorted to the last digit */
  } else {
    s1 = sqrt(dot(w[1], w[1]));
    second_vector(u[0], w[1], s1, u[1]);
    u[2][0] = u[0][1] * u[1][2] - u[0][2] * u[1][1];
    u[2][1] = u[0][2] * u[1][0] - u[0][0] * u[1][2];
    u[2][2] = u[0][0] * u[1][1] - u[0][1] * u[1][0];
    s1 = s1 > s0 ? s0 : s1;
    if (cols == 3) {
      s2 = sqrt(dot(w[2], w[2]));
      s2 = s2 > s1 ? s1 : s2;
      if (dot(u[2], w[2]) < 0) {
        if (improper)
          u[2][0] = -u[2][0], u[2][1] = -u[2][1], u[2][2] = -u[2][2];
        else
          s2 = -s2;
      }
    }
  }
  s[0] = s0, s[1] = s1, s[2] = s2;
  if (exponent)
    for (int i = 0; i < 3; i++)
      s[i] = ldexp(s[i], exponent);
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++) {
      U[3 * i + k] = u[k][i];
      V[3 * i + k] = v[k][i];
    }
}

/* The work of svd() for the leading rows x cols (2 or 3) of a matrix with the given row stride. */
static inline void svd_columns(int rows, int cols, int stride, int improper, const double *F,
                               double U[9], double s[3], double V[9])
{
  double w[3][3] = {{0}}, v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  int exponent;
  const int usual = load_columns(rows, cols, stride, F, w, &exponent);
  if (usual != 1) {
    for (int i = 0; i < 9; i++)
      U[i] = V[i] = usual == 0 ? i % 4 == 0 : NAN;
    s[0] = s[1] = s[2] = usual == 0 ? 0 : NAN;
    return;
  }
  for (int sweep = 0; sweep < SWEEPS; sweep++) {
    int again = rotate_pair(w[0], w[1], v[0], v[1]);
    if (cols == 3) {
      again |= rotate_pair(w[0], w[2], v[0], v[2]);
      again |= rotate_pair(w[1], w[2], v[1], v[2]);
    }
    if (!again)
      break;
  }
  finish_columns(rows, cols, improper, w, v, exponent, U, s, V);
}

/* F = U diag(s) V^T, |s_1| >= |s_2| >= |s_3|, F row-major of shape rows x cols.

   3x3, 2x2: det U = det V = 1, only the last s may be negative (the sign of det F); improper: all
   s >= 0, the last column of U changes sign instead. 3x2: s_1, s_2 >= 0, s_3 = 0, the third column
   of U is the normal. plane, F = [[F2, 0], [0, f]]: the 2x2 case of F2, then s_3 = f (improper:
   |f|). What is not finite gives NaN. */
static inline void svd(int rows, int cols, int plane, int improper, const double *F, double U[9],
                       double s[3], double V[9])
{
  if (plane) {
    svd_columns(2, 2, 3, improper, F, U, s, V);
    s[2] = improper ? fabs(F[8]) : F[8];
    U[8] = improper && F[8] < 0 ? -1 : 1;
    if (!finite_array(s, 3))
      for (int i = 0; i < 9; i++)
        U[i] = V[i] = s[i % 3] = NAN;
  } else if (rows == 2)
    svd_columns(2, 2, 2, improper, F, U, s, V);
  else if (cols == 2)
    svd_columns(3, 2, 2, improper, F, U, s, V);
  else
    svd_columns(3, 3, 3, improper, F, U, s, V);
}

#endif
