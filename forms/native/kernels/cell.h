/* SPDX-License-Identifier: MIT */
/* Cell and facet kernels: operand at the points -> operators point by point -> FFCx's kernel of the form.

   DOLFINx calls kernels[k] for the k-th integral of a form. The form's first constant is the number of its
   first integral in the table below, so that nothing but a small whole number travels through DOLFINx;
   the table's entries hold pointers to the kernels that FFCx compiled. Nothing is kept between cells. */
#ifndef VARIFORM_CELL_H
#define VARIFORM_CELL_H

#include <stdlib.h>
#include <string.h>

#include "point.h"
#include "projection.h"

enum { MAX_OPERATORS = 8, MAX_PIECES = 16, MOST_CELLS = 8, MOST_NUMBERS = 1 << 16 /* on the stack */ };

typedef struct {
  operator_t op;
  tabulate_t operand;    /* FFCx expression: operand and parameters at the points */
  int points;
  int constants;         /* where the operand's constants start in c */
  int levels[3];         /* where value, first and second derivative go in w, -1 if not wanted */
  int coefficients;      /* numbers that the operand's kernel reads */
  int pieces;
  int piece[MAX_PIECES][3]; /* destination in the operand's coefficients, source in w, length */
} jet_t;

typedef struct {
  tabulate_t form;       /* FFCx kernel; its coefficients: those DOLFINx packs, then the jets */
  int packed;            /* numbers of the former that it reads */
  int coefficients;      /* numbers of both */
  int jets;
  int project_points;    /* second derivatives made positive semi-definite */
  int project_rows;      /* > 0: so many rows of a cell matrix to be made positive semi-definite */
  jet_t jet[MAX_OPERATORS];
} integral_t;

static integral_t **table = 0;
static long table_size = 0;

/* Copy integrals into the table; the number of the first, or -1 without memory. */
long integrals_add(const integral_t *integrals, int count)
{
  integral_t **larger = realloc(table, (size_t)(table_size + count) * sizeof *table);
  if (!larger) return -1;
  table = larger;
  for (int k = 0; k < count; k++) {
    table[table_size + k] = malloc(sizeof(integral_t));
    if (!table[table_size + k]) return -1;
    *table[table_size + k] = integrals[k];
  }
  table_size += count;
  return table_size - count;
}

/* Numbers are never used twice: a form used after its release finds nothing and gives NaN. */
void integrals_release(long first, int count)
{
  for (int k = 0; k < count; k++) {
    free(table[first + k]);
    table[first + k] = 0;
  }
}

/* Operand and parameters at the points of a cell; whether they are the same at all, bit by bit, as the
   gradient of a linear simplex is. */
static int operands(const jet_t *j, const double *packed, const double *c, const double *x, const int *entity,
                    const uint8_t *perm, double *X)
{
  const int width = j->op.rows * j->op.cols + j->op.parameters;
  double local[j->coefficients + 1];
  for (int k = 0; k < j->pieces; k++)
    memcpy(local + j->piece[k][0], packed + j->piece[k][1], (size_t)j->piece[k][2] * sizeof(double));
  memset(X, 0, (size_t)(width * j->points) * sizeof *X); /* FFCx kernels add */
  j->operand(X, local, c + j->constants, x, entity, perm VARIFORM_CUSTOM);
  return !memcmp(X, X + width, (size_t)((j->points - 1) * width) * sizeof(double));
}

/* Numbers of a point in the value, the first and the second derivative. */
static inline int level_size(const jet_t *j, int level)
{
  const int operand = j->op.rows * j->op.cols;
  return level == 0 ? 1 : level == 1 ? operand : operand * operand;
}

/* Give all points of a cell what the first of them has. */
static void repeat(const jet_t *j, double *w)
{
  for (int l = 0; l < 3; l++)
    for (int k = 1; j->levels[l] >= 0 && k < j->points; k++)
      memcpy(w + j->levels[l] + k * level_size(j, l), w + j->levels[l], (size_t)level_size(j, l) * sizeof *w);
}

/* Put the derivatives of an operator into the coefficients w of up to MOST_CELLS cells. Where each has one
   operand these are looked at side by side, as the points of a cell are elsewhere. */
static void fill(const jet_t *j, int project, int cells, double *const *w, const double *const *packed,
                 const double *c, const double *const *x, const int *entity, const uint8_t *perm)
{
  const int width = j->op.rows * j->op.cols + j->op.parameters;
  double X[cells][width * j->points];
  int constant[MOST_CELLS], all = cells > 1;
  for (int e = 0; e < cells; e++)
    all &= constant[e] = operands(j, packed[e], c, x[e], entity, perm, X[e]);
  for (int e = 0; !all && e < cells; e++) {
    double *out[3];
    for (int l = 0; l < 3; l++)
      out[l] = j->levels[l] < 0 ? 0 : w[e] + j->levels[l];
    points_in_row(&j->op, constant[e] ? 1 : j->points, X[e], project, out[0], out[1], out[2]);
    if (constant[e]) repeat(j, w[e]);
  }
  if (!all) return;
  double first[cells * width], W[cells], P[cells * 9], A[cells * 81];
  for (int e = 0; e < cells; e++) memcpy(first + e * width, X[e], (size_t)width * sizeof *first);
  double *out[3] = {W, P, A};
  for (int l = 0; l < 3; l++)
    if (j->levels[l] < 0) out[l] = 0;
  points_in_row(&j->op, cells, first, project, out[0], out[1], out[2]);
  for (int e = 0; e < cells; e++) {
    for (int l = 0; l < 3; l++)
      if (out[l])
        memcpy(w[e] + j->levels[l], out[l] + e * level_size(j, l), (size_t)level_size(j, l) * sizeof *W);
    repeat(j, w[e]);
  }
}

static void integrate(int k, double *A, const double *w, const double *c, const double *x, const int *entity,
                      const uint8_t *perm)
{
  const long number = (long)c[0] + k;
  const integral_t *t = number >= 0 && number < table_size ? table[number] : 0;
  if (!t) {
    A[0] = NAN;
    return;
  }
  double all[t->coefficients + 1];
  memcpy(all, w, (size_t)t->packed * sizeof(double));
  double *const to = all;
  for (int j = 0; j < t->jets; j++) fill(&t->jet[j], t->project_points, 1, &to, &w, c, &x, entity, perm);
  if (t->project_rows) {
    const int n = t->project_rows;
    double K[n * n];
    memset(K, 0, sizeof K);
    t->form(K, all, c + 1, x, entity, perm VARIFORM_CUSTOM);
    project_matrix(n, K);
    for (int i = 0; i < n * n; i++) A[i] += K[i];
  } else
    t->form(A, all, c + 1, x, entity, perm VARIFORM_CUSTOM);
}

#ifdef VARIFORM_CUSTOM_DATA
#define KERNEL_END , void *custom __attribute__((unused))
#else
#define KERNEL_END
#endif
/* k: two octal digits, so that 0##k is the number. */
#define KERNEL(k)                                                                                   \
  static void kernel_##k(double *A, const double *w, const double *c, const double *x, const int *entity, \
                  const uint8_t *perm KERNEL_END)                                                   \
  {                                                                                                 \
    integrate(0##k, A, w, c, x, entity, perm);                                                      \
  }
#define KERNELS(a)                                                                                  \
  KERNEL(a##0) KERNEL(a##1) KERNEL(a##2) KERNEL(a##3)                                               \
  KERNEL(a##4) KERNEL(a##5) KERNEL(a##6) KERNEL(a##7)

KERNELS(0) KERNELS(1) KERNELS(2) KERNELS(3) KERNELS(4) KERNELS(5) KERNELS(6) KERNELS(7)

#define NAMES(a) \
  kernel_##a##0, kernel_##a##1, kernel_##a##2, kernel_##a##3, kernel_##a##4, kernel_##a##5, kernel_##a##6, kernel_##a##7
const tabulate_t kernels[] = {NAMES(0), NAMES(1), NAMES(2), NAMES(3), NAMES(4), NAMES(5), NAMES(6), NAMES(7)};

/* Call a kernel of ours, or one of FFCx, for up to MOST_CELLS cells. */
void kernel_together(tabulate_t kernel, int cells, double *const *A, const double *const *w, const double *c,
                     const double *const *x)
{
  const int entity = 0;
  const uint8_t perm[2] = {0, 0};
  long number = -1;
  for (long k = 0; k < (long)(sizeof kernels / sizeof *kernels); k++)
    if (kernels[k] == kernel) number = (long)c[0] + k;
  const integral_t *t = number >= 0 && number < table_size ? table[number] : 0;
  if (!t || t->project_rows || (long)cells * t->coefficients > MOST_NUMBERS) {
    for (int e = 0; e < cells; e++) kernel(A[e], w[e], c, x[e], &entity, perm VARIFORM_CUSTOM);
    return;
  }
  double all[cells][t->coefficients + 1], *to[MOST_CELLS];
  for (int e = 0; e < cells; e++) {
    to[e] = all[e];
    memcpy(all[e], w[e], (size_t)t->packed * sizeof(double));
  }
  for (int j = 0; j < t->jets; j++) fill(&t->jet[j], t->project_points, cells, to, w, c, x, &entity, perm);
  for (int e = 0; e < cells; e++) t->form(A[e], all[e], c + 1, x[e], &entity, perm VARIFORM_CUSTOM);
}

#endif
