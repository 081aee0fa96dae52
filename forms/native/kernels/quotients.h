/* SPDX-License-Identifier: MIT */
/* Divided differences of the derivatives of psi_hat, without loss of digits where they are 0/0.

   D = (psi_i - psi_j) / (s_i - s_j) and T = (psi_i + psi_j) / (s_i + s_j): with sigma = 1 for D and
   -1 for T both are the mean over -1 <= t <= 1 of psi_ii - sigma psi_ij at
   (m + t h, sigma (m - t h)), m = (s_i + sigma s_j) / 2, h = (s_i - sigma s_j) / 2: D by the
   symmetry psi_hat(s_i, s_j) = psi_hat(s_j, s_i), T by psi_hat(-s_i, -s_j) = psi_hat(s_i, s_j).
   The same symmetry makes g(t) = (psi_ii + psi_jj) / 2 - sigma psi_ij even, with the same mean. */
#ifndef VARIFORM_QUOTIENTS_H
#define VARIFORM_QUOTIENTS_H

#include <float.h>
#include <math.h>

#include "kernel.h"

typedef struct {
  tabulate_t psi; /* of (s_1..s_n, parameters); adds value, gradient, Hessian (upper triangle) */
  int rows, cols; /* of the operand: 3x3, 2x2 or 3x2, row-major */
  int stretches;  /* n: 3 for 3x3, 2 for 2x2 and 3x2 */
  int plane;      /* 3x3 operand [[F2, 0], [0, f]]: s = those of F2, then f with its sign */
  int improper;   /* singular values >= 0, U in O(n) instead of SO(n) */
  int smooth;     /* psi_hat(-s_i, -s_j) = psi_hat(s_i, s_j); 3x2: psi_hat is even in each s */
  int parameters; /* numbers that follow the operand */
  double clamp;   /* relative floor of |s_i + s_j| for energies that are not smooth */
} operator_t;

#define JET 10 /* value, 3 derivatives, 6 second derivatives */

static const int second_derivative[2][3][3] = {{{3, 4, 4}, {4, 5, 5}, {4, 5, 5}},
                                               {{4, 5, 6}, {5, 7, 8}, {6, 8, 9}}};

static inline double hessian(const operator_t *op, const double *jet, int i, int j)
{
  return jet[second_derivative[op->stretches == 3][i][j]];
}

static inline void evaluate_psi(const operator_t *op, const double *c, double jet[JET])
{
  for (int k = 0; k < JET; k++)
    jet[k] = 0;
  op->psi(jet, 0, c, 0, 0, 0 VARIFORM_CUSTOM);
}

/* The segment of a pair; i = j stands for psi_i / s_i, the mean of psi_ii between -s_i and s_i. */
typedef struct {
  const operator_t *op;
  double *c; /* s, then the parameters */
  int i, j;
  double sigma, m, h;
} segment_t;

/* g at the state of a jet. */
static double integrand(const segment_t *q, const double *jet)
{
  if (q->i == q->j)
    return hessian(q->op, jet, q->i, q->i);
  return 0.5 * (hessian(q->op, jet, q->i, q->i) + hessian(q->op, jet, q->j, q->j)) -
         q->sigma * hessian(q->op, jet, q->i, q->j);
}

static double integrand_at(const segment_t *q, double t)
{
  const double si = q->c[q->i], sj = q->c[q->j];
  double jet[JET];
  q->c[q->i] = q->m + t * q->h;
  if (q->j != q->i)
    q->c[q->j] = q->sigma * (q->m - t * q->h);
  evaluate_psi(q->op, q->c, jet);
  q->c[q->j] = sj;
  q->c[q->i] = si;
  return integrand(q, jet);
}

/* Mean of g over [0, 1] by bisection, for energies whose third derivative jumps: Lobatto's 4 points
   and their 7-point Kronrod extension in each part, down to 2^-30 around the jump. A jump can make
   two rules agree by chance, but hardly twice: a part's whole has to have been close, too. */
static double bisect(const segment_t *q, double g0, double g1, double before, double tolerance,
                     double *error)
{
  typedef struct { double a, width, ga, gb, before; } part_t;
  part_t stack[32];
  int top = 0, budget = 80; /* halvings; used up only where g is rough everywhere */
  double mean = 0;
  stack[0] = (part_t){0, 1, g0, g1, before};
  *error = 0;
  while (top >= 0) {
    const part_t p = stack[top--];
    const double half = 0.5 * p.width, mid = p.a + half;
    const double far = 0.81649658092772603 * half, near = 0.44721359549995794 * half;
    const double f1 = integrand_at(q, mid - far), f2 = integrand_at(q, mid - near);
    const double f3 = integrand_at(q, mid), f4 = integrand_at(q, mid + near);
    const double f5 = integrand_at(q, mid + far);
    const double fine = (77 * (p.ga + p.gb) + 432 * (f1 + f5) + 625 * (f2 + f4) + 672 * f3) / 2940;
    const double coarse = (p.ga + p.gb + 5 * (f2 + f4)) / 12;
    const double difference = p.width * fabs(fine - coarse);
    const int close = difference <= tolerance && p.before <= 16 * tolerance;
    if (!close && difference >= 0 && top < 29 && --budget > 0) {
      stack[++top] = (part_t){mid, half, f3, p.gb, difference};
      stack[++top] = (part_t){p.a, half, p.ga, f3, difference};
    } else {
      mean += p.width * fine;
      *error += difference;
    }
  }
  return mean;
}

/* D (sigma = 1), T of a smooth energy (sigma = -1), or psi_i / s_i of an even one (i = j), to
   rounding of `size`, the largest second derivative at the state of `jet`. */
static double quotient(const operator_t *op, double *c, const double *jet, double size, int i,
                       int j, double sigma)
{
  const int alone = i == j;
  const double si = c[i], sj = alone ? 0 : c[j], pi = jet[1 + i], pj = alone ? 0 : jet[1 + j];
  const double gap = si - sigma * sj, rise = pi - sigma * pj;
  const double loss = DBL_EPSILON * (fabs(pi) + fabs(pj) + size * (fabs(si) + fabs(sj)));
  if (loss < 1e-14 * size * fabs(gap))
    return rise / gap;

  const double m = alone ? 0 : 0.5 * (si + sigma * sj), h = alone ? si : 0.5 * gap;
  const segment_t q = {op, c, i, j, sigma, m, h};
  const double g1 = integrand(&q, jet), tight = 5e-14 * size;
  if (fabs(gap) <= 2 * DBL_EPSILON * (fabs(si) + fabs(sj)))
    return g1;
  /* Simpson, Lobatto's 5 points, Gauss's 8, with even g in mind: each is accepted when it repeats
     the rule before. Trusting the digits an analytic g gains from rule to rule instead would save
     a call, but not see a third derivative that jumps close to an end of the segment. A jump makes
     d1 fall like h; where d1 is more than h^2 explains, or h^2 can hide it, equality is chance. */
  const double g0 = integrand_at(&q, 0), d1 = fabs(g0 - g1), curve = h / m * (h / m) * size;
  const double simpson = (2 * g0 + g1) / 3;
  if (d1 <= tight && 64 * curve <= tight)
    return simpson;
  const double lobatto = (32 * g0 + 49 * integrand_at(&q, 0.65465367070797714) + 9 * g1) / 90;
  const double d2 = fabs(lobatto - simpson), gain = d2 / d1;
  if (d2 <= tight && (d1 <= tight || d1 <= 1e3 * curve))
    return lobatto;
  if (gain < 0.03) { /* a jump leaves about 0.1, whatever the gap */
    const double gauss = 0.36268378337836198 * integrand_at(&q, 0.18343464249564980) +
                         0.31370664587788729 * integrand_at(&q, 0.52553240991632899) +
                         0.22238103445337447 * integrand_at(&q, 0.79666647741362674) +
                         0.10122853629037626 * integrand_at(&q, 0.96028985649753623);
    const double d3 = fabs(gauss - lobatto);
    if (d3 <= tight || (d3 <= 50 * tight && d3 <= 10 * gain * gain * d2))
      return gauss;
  }
  double error;
  const double mean = bisect(&q, g0, g1, d2, 0.4 * tight, &error);
  /* The comparison also refuses an integral that is not finite. */
  return error * fabs(gap) <= loss ? mean : rise / gap;
}

#endif
