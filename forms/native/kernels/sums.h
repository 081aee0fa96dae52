/* SPDX-License-Identifier: MIT */
/* Sums over cells by the kernels of energies in singular values, whose points are looked at several cells at a time
   (cell.h); as those of cells.h for all others. */
#ifndef VARIFORM_SUMS_H
#define VARIFORM_SUMS_H

#include "cell.h"
#include "insertion.h"

/* Cells of a part from `first` on into A, each `numbers` long and 0 before; how many they are. */
static int call_together(const part_t *p, long first, const geometry_t *g, const double *constants, int numbers,
                         double *A)
{
  double x[MOST_CELLS * 3 * g->nodes], *to[MOST_CELLS];
  const double *w[MOST_CELLS], *places[MOST_CELLS];
  const int cells = gather_rows(p, first, MOST_CELLS, g, x, w, places);
  memset(A, 0, (size_t)(cells * numbers) * sizeof *A);
  for (int k = 0; k < cells; k++) to[k] = A + k * numbers;
  kernel_together(p->kernel, cells, to, w, constants, places);
  return cells;
}

/* Sum of a functional over a part's cells. */
double cells_sum(const part_t *p, const geometry_t *g, const double *constants)
{
  double sum = 0, A[MOST_CELLS];
  for (long first = 0; first < p->count; first += MOST_CELLS) {
    const int cells = call_together(p, first, g, constants, 1, A);
    for (int k = 0; k < cells; k++) sum += A[k];
  }
  return sum;
}

/* Add a linear form over a part's cells to b; numbers: of the `nodes` nodes of each cell, of `size` components.
   The sum of what the kernels give behind: a functional. */
double cells_add(const part_t *p, const geometry_t *g, const double *constants, const int32_t *numbers, int nodes,
                 int size, double *b)
{
  const int total = nodes * size, length = total + 1;
  double sum = 0, A[MOST_CELLS * length];
  for (long first = 0; first < p->count; first += MOST_CELLS) {
    const int cells = call_together(p, first, g, constants, length, A);
    for (int k = 0; k < cells; k++) {
      const int32_t *n = numbers + nodes * (long)p->entities[first + k];
      for (int i = 0; i < total; i++) b[size * (long)n[i / size] + i % size] += A[k * length + i];
      sum += A[k * length + total];
    }
  }
  return sum;
}

#endif
