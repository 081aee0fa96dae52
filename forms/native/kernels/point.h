/* SPDX-License-Identifier: MIT */
/* Energy, stress and tangent of an isotropic energy psi_hat(s), s the operand's singular values.

   With F = U diag(s) V^T: P = U diag(psi_i) V^T, and dP/dF is, in the basis u_a v_b^T, the Hessian
   of psi_hat on the entries (aa) and D/2 [[1, 1], [1, 1]] + T/2 [[1, -1], [-1, 1]] on (ab, ba),
   with the quotients D, T of quotients.h. */
#ifndef VARIFORM_POINT_H
#define VARIFORM_POINT_H

#include "lanes.h"
#include "quotients.h"
#include "svd.h"

#define PARAMETERS 64 /* at most; who builds an operator_t has to refuse more */

/* dP/dF in the basis u_a v_b^T: `stretch` on (aa, bb), `same` on (ab, ab), `mixed` on (ab, ba). */
typedef struct {
  double stretch[3][3], same[3][3], mixed[3][3];
} blocks_t;

/* Whether a symmetric 3x3 matrix is positive definite beyond doubt, by its Cholesky pivots. */
static inline int is_definite(double A[3][3], int n)
{
  const double least = 1e-12 * (fabs(A[0][0]) + fabs(A[1][1]));
  const double l1 = A[1][0] / A[0][0], p1 = A[1][1] - l1 * A[1][0];
  if (!(A[0][0] > least && p1 > least) || n == 2)
    return A[0][0] > least && p1 > least;
  const double b = A[2][1] - l1 * A[2][0];
  return A[2][2] - A[2][0] / A[0][0] * A[2][0] - b * b / p1 > least + 1e-12 * fabs(A[2][2]);
}

/* Raise the negative eigenvalues of a symmetric n x n matrix to 0 (cyclic Jacobi), n = 2 or 3. */
static void clamp_eigenvalues(double A[3][3], int n)
{
  if (is_definite(A, n))
    return;
  double B[3][3], Q[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++)
      B[i][j] = A[i][j];
  for (int sweep = 0; sweep < SWEEPS; sweep++) {
    int again = 0;
    for (int p = 0; p < n - 1; p++)
      for (int q = p + 1; q < n; q++) {
        if (!(fabs(B[p][q]) > 0.1 * DBL_EPSILON * (fabs(B[p][p]) + fabs(B[q][q]))))
          continue;
        const double z = (B[q][q] - B[p][p]) / (2 * B[p][q]);
        const double t = (z < 0 ? -1 : 1) / (fabs(z) + sqrt(1 + z * z));
        const double c = 1 / sqrt(1 + t * t), s = c * t;
        for (int k = 0; k < n; k++) {
          const double x = B[k][p], y = B[k][q];
          B[k][p] = c * x - s * y, B[k][q] = s * x + c * y;
        }
        for (int k = 0; k < n; k++) {
          const double x = B[p][k], y = B[q][k], u = Q[k][p], v = Q[k][q];
          B[p][k] = c * x - s * y, B[q][k] = s * x + c * y;
          Q[k][p] = c * u - s * v, Q[k][q] = s * u + c * v;
        }
        again = 1;
      }
    if (!again)
      break;
  }
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) {
      A[i][j] = 0;
      for (int k = 0; k < n; k++)
        A[i][j] += Q[i][k] * (B[k][k] > 0 ? B[k][k] : 0) * Q[j][k];
    }
}

/* The blocks at s = c[0..n-1]; returns whether they are finite. */
static int fill_blocks(const operator_t *op, double *c, const double jet[JET], int project,
                       blocks_t *M)
{
  const int n = op->stretches, sheet = op->rows > op->cols;
  double size = 0, smax = 0;
  int finite = 1;
  for (int i = 0; i < n; i++) {
    smax = fabs(c[i]) > smax ? fabs(c[i]) : smax;
    for (int j = 0; j < n; j++) {
      M->stretch[i][j] = hessian(op, jet, i, j);
      size = fabs(M->stretch[i][j]) > size ? fabs(M->stretch[i][j]) : size;
    }
  }
  /* 1e-6 of |F| for stretches up to 1, and 1e-6 above: never more than the documents' 1e-6. */
  const double unit = smax > 1 ? 1 : smax;
  const double least = op->clamp * (unit > op->clamp ? unit : op->clamp);
  for (int i = 0; i < 2; i++)
    for (int j = i + 1; j < 3; j++) {
      if (j >= n && !sheet)
        continue;
      /* A sheet's normal has s = psi_3 = 0, so that D = T = psi_i / s_i. */
      const int k = j < n ? j : i;
      const double sum = c[i] + (j < n ? c[j] : 0);
      const double rise = jet[1 + i] + (j < n ? jet[1 + j] : 0);
      const double bounded = fabs(sum) >= least ? sum : sum < 0 ? -least : least;
      double T = op->smooth ? quotient(op, c, jet, size, i, k, -1) : rise / bounded;
      double D = j < n ? quotient(op, c, jet, size, i, j, 1) : T;
      finite &= fabs(D) <= DBL_MAX && fabs(T) <= DBL_MAX;
      D = project && D < 0 ? 0 : D;
      T = project && T < 0 ? 0 : T;
      M->same[i][j] = M->same[j][i] = 0.5 * (D + T);
      M->mixed[i][j] = M->mixed[j][i] = 0.5 * (D - T);
    }
  if (project && finite)
    clamp_eigenvalues(M->stretch, n);
  return finite;
}

/* A[ij][kl] = sum U_ia V_jb M[ab][cd] U_kc V_ld; for constant rows, cols: the loops unroll. */
static inline void rotate_blocks(int rows, int cols, const double U[9], const double V[9],
                                 const blocks_t *M, double *A)
{
  double Q[3][3][9], R[3][3][9]; /* u_a v_b^T, and M times it */
  const int n = rows * cols;
  for (int a = 0; a < rows; a++)
    for (int b = 0; b < cols; b++)
      for (int i = 0; i < rows; i++)
        for (int j = 0; j < cols; j++)
          Q[a][b][cols * i + j] = U[3 * i + a] * V[3 * j + b];
  for (int a = 0; a < rows; a++)
    for (int b = 0; b < cols; b++)
      for (int k = 0; k < n; k++) {
        if (a != b)
          R[a][b][k] = M->same[a][b] * Q[a][b][k] + (a < cols ? M->mixed[a][b] * Q[b][a][k] : 0);
        else {
          R[a][b][k] = M->stretch[a][0] * Q[0][0][k] + M->stretch[a][1] * Q[1][1][k];
          if (cols == 3)
            R[a][b][k] += M->stretch[a][2] * Q[2][2][k];
        }
      }
  for (int i = 0; i < rows; i++) { /* U first, then V: 4 n^2 products instead of 9 n^2 */
    double S[3][9];
    for (int b = 0; b < cols; b++)
      for (int k = 0; k < n; k++) {
        S[b][k] = U[3 * i] * R[0][b][k] + U[3 * i + 1] * R[1][b][k];
        if (rows == 3)
          S[b][k] += U[3 * i + 2] * R[2][b][k];
      }
    for (int j = 0; j < cols; j++)
      for (int k = 0; k < n; k++) {
        double sum = V[3 * j] * S[0][k] + V[3 * j + 1] * S[1][k];
        if (cols == 3)
          sum += V[3 * j + 2] * S[2][k];
        A[n * (cols * i + j) + k] = sum;
      }
  }
}

#ifdef LANES
/* rotate_blocks() of `count` <= LANES points 3x3 at once: the upper half of each A, and the lower. */
static void rotate_lanes_blocks(int count, double (*U)[9], double (*V)[9], const blocks_t *M, double *A)
{
  lanes_t u[3][3], v[3][3], stretch[3][3], same[3][3], mixed[3][3], Q[3][3][9], R[3][3][9];
  for (int i = 0; i < 9; i++)
    for (int k = 0; k < LANES; k++) {
      const int l = k < count ? k : 0, a = i / 3, b = i % 3;
      u[a][b][k] = U[l][i], v[a][b][k] = V[l][i];
      stretch[a][b][k] = M[l].stretch[a][b];
      same[a][b][k] = M[l].same[a][b], mixed[a][b][k] = M[l].mixed[a][b];
    }
  for (int a = 0; a < 3; a++)
    for (int b = 0; b < 3; b++)
      for (int k = 0; k < 9; k++)
        Q[a][b][k] = u[k / 3][a] * v[k % 3][b];
  for (int a = 0; a < 3; a++)
    for (int b = 0; b < 3; b++)
      for (int k = 0; k < 9; k++)
        R[a][b][k] = a != b ? same[a][b] * Q[a][b][k] + mixed[a][b] * Q[b][a][k]
                            : stretch[a][0] * Q[0][0][k] + stretch[a][1] * Q[1][1][k] +
                                stretch[a][2] * Q[2][2][k];
  for (int i = 0; i < 3; i++) {
    lanes_t S[3][9];
    for (int b = 0; b < 3; b++)
      for (int k = 3 * i; k < 9; k++)
        S[b][k] = u[i][0] * R[0][b][k] + u[i][1] * R[1][b][k] + u[i][2] * R[2][b][k];
    for (int j = 0; j < 3; j++)
      for (int k = 3 * i + j; k < 9; k++) {
        const lanes_t sum = v[j][0] * S[0][k] + v[j][1] * S[1][k] + v[j][2] * S[2][k];
        for (int l = 0; l < count; l++)
          A[81 * l + 9 * (3 * i + j) + k] = A[81 * l + 9 * k + 3 * i + j] = sum[l];
      }
  }
}
#endif

static inline void set_all(double *x, int n, double value)
{
  for (int i = 0; x && i < n; i++)
    x[i] = value;
}

/* W, P and the blocks of A, the singular values known; each may be NULL. 1 where all are finite, 0
   where they are not, -1 for an operand that is not. */
static int derive(const operator_t *op, const double *X, const double U[9], const double s[3],
                  const double V[9], int project, double *W, double *P, blocks_t *M)
{
  const int rows = op->rows, cols = op->cols, n = rows * cols;
  double c[3 + PARAMETERS], jet[JET];
  if (!finite_array(X, n) || op->parameters > PARAMETERS)
    return -1;
  for (int i = 0; i < op->stretches; i++)
    c[i] = s[i];
  for (int i = 0; i < op->parameters; i++)
    c[op->stretches + i] = X[n + i];
  evaluate_psi(op, c, jet);
  if (!finite_array(jet, JET))
    return 0;
  for (int i = 0; P && i < rows; i++)
    for (int j = 0; j < cols; j++) {
      double sum = U[3 * i] * jet[1] * V[3 * j] + U[3 * i + 1] * jet[2] * V[3 * j + 1];
      if (cols == 3)
        sum += U[3 * i + 2] * jet[3] * V[3 * j + 2];
      P[cols * i + j] = sum;
    }
  if (W)
    *W = jet[0];
  return !M || fill_blocks(op, c, jet, project, M);
}

/* Replace W, P and A where one of them is not finite; see point(). */
static void settle(int state, int n, double *W, double *P, double *A)
{
  if (state == 1)
    return;
  const double value = state ? NAN : INFINITY;
  set_all(W, 1, value), set_all(P, n, value), set_all(A, n * n, value);
}

/* W (1), P (rows*cols) and A ((rows*cols)^2, A[ij][kl] = dP_ij/dF_kl) at X = operand, parameters;
   each may be NULL. project: make A positive semi-definite.

   An operand that is not finite gives NaN. Where the energy or a derivative of it is not finite (a
   logarithm of a stretch <= 0, an overflow), the energy counts as infinite: W = P = A = inf. */
static void point(const operator_t *op, const double *X, int project, double *W, double *P,
                  double *A)
{
  const int rows = op->rows, cols = op->cols, n = rows * cols;
  double U[9], s[3], V[9];
  blocks_t M;
  svd(rows, cols, op->plane, op->improper, X, U, s, V);
  int state = derive(op, X, U, s, V, project, W, P, A ? &M : 0);
  if (state == 1 && A) {
    if (rows == 2)
      rotate_blocks(2, 2, U, V, &M, A);
    else if (cols == 2)
      rotate_blocks(3, 2, U, V, &M, A);
    else
      rotate_blocks(3, 3, U, V, &M, A);
    state = finite_array(A, n * n);
  }
  settle(state, n, W, P, A);
}

/* point() at `count` rows of X, whose outputs follow each other in W, P and A. */
static void points_in_row(const operator_t *op, long count, const double *X, int project, double *W,
                          double *P, double *A)
{
  const long n = op->rows * op->cols, stride = n + op->parameters;
  long k = 0;
#ifdef LANES
  double U[LANES][9], s[LANES][3], V[LANES][9];
  blocks_t M[LANES] = {{{{0}}, {{0}}, {{0}}}};
  int states[LANES];
  for (; n == 9 && !op->plane && count - k > 1; k += LANES) {
    const int together = count - k < LANES ? (int)(count - k) : LANES;
    svd_lanes(together, stride, op->improper, X + stride * k, U, s, V);
    for (int l = 0; l < together; l++)
      states[l] = derive(op, X + stride * (k + l), U[l], s[l], V[l], project, W ? W + k + l : 0,
                         P ? P + n * (k + l) : 0, A ? &M[l] : 0);
    if (A)
      rotate_lanes_blocks(together, U, V, M, A + n * n * k);
    for (int l = 0; l < together; l++) {
      double *const a = A ? A + n * n * (k + l) : 0;
      states[l] = states[l] == 1 && a ? finite_array(a, 81) : states[l];
      settle(states[l], 9, W ? W + k + l : 0, P ? P + n * (k + l) : 0, a);
    }
  }
#endif
  for (; k < count; k++)
    point(op, X + stride * k, project, W ? W + k : 0, P ? P + n * k : 0, A ? A + n * n * k : 0);
}

#endif
