/* SPDX-License-Identifier: MIT */
/* Sums over cells by kernels that compute several at once; the text that includes this file has them. */
#ifndef VARIFORM_CELLS_H
#define VARIFORM_CELLS_H

#include "vectors.h"

/* What Python has to know of this file. */
const long cells_sizes[] = {sizeof(target_t), sizeof(part_t), sizeof(geometry_t)};

/* Sum of a functional over a part's cells. */
double cells_sum(const part_t *p, const geometry_t *g, const double *constants)
{
  const lanes_kernel_t kernel = lanes_kernel(p);
  lanes_t w[p->width + 1], x[3 * g->nodes], sum = {0};
  for (long first = 0; first < p->count; first += WIDTH) {
    lanes_t A = {0};
    gather_cells(p, first, g, w, x);
    kernel(&A, w, constants, x);
    for (int k = 0; k < WIDTH && first + k < p->count; k++) sum[k] += A[k];
  }
  double total = 0;
  for (int k = 0; k < WIDTH; k++) total += sum[k];
  return total;
}

/* Add a linear form over a part's cells to b; numbers: of the `nodes` nodes of each cell, of `size` components.
   The sum of what the kernels give behind: a functional. */
double cells_add(const part_t *p, const geometry_t *g, const double *constants, const int32_t *numbers, int nodes,
                 int size, double *b)
{
  const lanes_kernel_t kernel = lanes_kernel(p);
  lanes_t w[p->width + 1], x[3 * g->nodes], A[nodes * size + 1];
  double sum = 0;
  for (long first = 0; first < p->count; first += WIDTH) {
    memset(A, 0, sizeof A);
    gather_cells(p, first, g, w, x);
    kernel(A, w, constants, x);
    for (int k = 0; k < WIDTH && first + k < p->count; k++) {
      const int32_t *n = numbers + nodes * (long)p->entities[first + k];
      for (int i = 0; i < nodes; i++)
        for (int a = 0; a < size; a++) b[size * (long)n[i] + a] += A[size * i + a][k];
      sum += A[nodes * size][k];
    }
  }
  return sum;
}

#endif
