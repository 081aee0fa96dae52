/* SPDX-License-Identifier: MIT */
/* Cells and facets into the arrays of a PETSc AIJ matrix, at places found once.

   Rows of cell matrices belong to three arrays: the matrix' diagonal and off-diagonal parts, and a buffer
   of the same kind for rows that other ranks own. Blocks of a node's components have one place. */
#ifndef VARIFORM_INSERTION_H
#define VARIFORM_INSERTION_H

#include <stdint.h>
#include <string.h>

#include "kernel.h"

/* In place of the first place of a cell that no integral of the form meets. */
#define UNKNOWN INT16_MIN

typedef struct {
  int cells;              /* of this rank, ghosts included */
  int owned;              /* nodes of this rank */
  int size;               /* components of a node */
  int nodes;              /* of a cell */
  const int32_t *numbers; /* of a cell's nodes */
  const int16_t *places;  /* block of two nodes in its row; ~place: in the off-diagonal part */
  const int32_t *rows[3]; /* where each row (one component) starts, and the last one ends */
  double *values[3];
  const int8_t *held;     /* components whose rows and columns are left out */
} target_t;

typedef struct {
  tabulate_t kernel;
  int facets;              /* entities are (cell, local facet), else cells */
  int lanes;               /* the kernel computes several cells at once (vectors.h) */
  long count;
  const int32_t *entities;
  int width;               /* coefficients of an entity */
  const double *coefficients;
} part_t;

typedef struct {
  int nodes;
  const int32_t *numbers;
  const double *x;
} geometry_t;

/* Where up to `most` cells of a part, from `first` on, have coefficients and places, which are put into x; how
   many they are. */
static inline int gather_rows(const part_t *p, long first, int most, const geometry_t *g, double *x, const double **w,
                              const double **places)
{
  const int cells = p->count - first < most ? (int)(p->count - first) : most;
  for (int k = 0; k < cells; k++, x += 3 * g->nodes) {
    const int32_t *nodes = g->numbers + (long)g->nodes * p->entities[first + k];
    for (int i = 0; i < g->nodes; i++) memcpy(x + 3 * i, g->x + 3 * (long)nodes[i], 3 * sizeof(double));
    w[k] = p->coefficients + (first + k) * p->width, places[k] = x;
  }
  return cells;
}

/* Rows and columns of a matrix with blocks of a size, sorted, from those of its blocks' rows. */
void insertion_rows(int owned, int size, const int64_t *starts, const int64_t *blocks, int32_t *rows, int32_t *columns)
{
  rows[0] = 0;
  for (long r = 0; r < owned; r++) {
    const int64_t *row = blocks + starts[r];
    const long count = starts[r + 1] - starts[r];
    int32_t *first = columns;
    for (long k = 0; k < count; k++) { /* ghosts are among the others: insert what is out of order */
      long at = k;
      const int32_t column = (int32_t)row[k] * size;
      for (; at > 0 && first[(at - 1) * size] > column; at--) first[at * size] = first[(at - 1) * size];
      first[at * size] = column;
    }
    for (long k = 0; k < count; k++)
      for (int b = 1; b < size; b++) first[k * size + b] = first[k * size] + b;
    columns += count * size;
    for (int a = 1; a < size; a++, columns += count * size)
      memcpy(columns, first, (size_t)(count * size) * sizeof *columns);
    for (int a = 0; a < size; a++) rows[size * r + a + 1] = rows[size * r + a] + (int32_t)(count * size);
  }
}

/* Where column is in the sorted columns of a row; -1: not there. */
static long place_in(const int32_t *columns, long n, int32_t column)
{
  long low = 0, high = n;
  while (low < high) {
    const long middle = (low + high) / 2;
    if (columns[middle] < column)
      low = middle + 1;
    else
      high = middle;
  }
  return low < n && columns[low] == column ? low : -1;
}

/* Find the places of the cells that are marked as met. columns: those of the three arrays; first: each
   node's first column in the part that it belongs to, in the ghosts' buffer always size times its number.
   0: one is missing, or too far from the start of its row. */
int insertion_places(const target_t *t, const int8_t *met, const int32_t *columns[3], const int32_t *first,
                     int16_t *places)
{
  const int n = t->nodes;
  for (long cell = 0; cell < t->cells; cell++) {
    if (!met[cell]) {
      places[cell * n * n] = UNKNOWN;
      continue;
    }
    for (int i = 0; i < n; i++)
      for (int j = 0; j < n; j++) {
        const int32_t r = t->numbers[n * cell + i], c = t->numbers[n * cell + j];
        const int part = r >= t->owned ? 2 : c >= t->owned;
        const int32_t *row = t->rows[part] + (long)t->size * (part == 2 ? r - t->owned : r);
        const int32_t column = part == 2 ? t->size * c : first[c];
        const long place = place_in(columns[part] + row[0], row[1] - row[0], column);
        if (place < 0 || place >= INT16_MAX) return 0; /* ~INT16_MAX is UNKNOWN */
        places[(n * cell + i) * n + j] = (int16_t)(part == 1 ? ~place : place);
      }
  }
  return 1;
}

/* Places of diagonal entries of a part, as numbers in its values; 0: one is missing. */
int insertion_diagonal(const int32_t *rows, const int32_t *columns, long count, const int32_t *held, int32_t *places)
{
  for (long k = 0; k < count; k++) {
    const int32_t *row = rows + held[k];
    const long place = place_in(columns + row[0], row[1] - row[0], held[k]);
    if (place < 0) return 0;
    places[k] = row[0] + (int32_t)place;
  }
  return 1;
}

static inline __attribute__((always_inline)) void add_blocks(const target_t *t, long cell, double *K,
                                                             const int size)
{
  const int n = t->nodes, total = n * size;
  const int32_t *numbers = t->numbers + n * cell;
  const int16_t *place = t->places + cell * n * n;
  for (int i = 0; i < total; i++)
    if (t->held[(long)size * numbers[i / size] + i % size])
      for (int j = 0; j < total; j++) K[i * total + j] = K[j * total + i] = 0;
  for (int i = 0; i < n; i++, place += n, K += size * total) {
    const int32_t r = numbers[i];
    const int usual = r >= t->owned ? 2 : 0; /* where most of the row's blocks are */
    const int32_t *row = t->rows[usual] + (long)size * (usual ? r - t->owned : r);
    double *const start = t->values[usual] + row[0];
    const long length = row[1] - row[0];
    for (int j = 0; j < n; j++) {
      double *to = start + place[j];
      long stride = length;
      if (place[j] < 0) {
        const int32_t *beside = t->rows[1] + (long)size * r;
        to = t->values[1] + beside[0] + ~place[j];
        stride = beside[1] - beside[0];
      }
      for (int a = 0; a < size; a++)
        for (int b = 0; b < size; b++) to[a * stride + b] += K[a * total + size * j + b];
    }
  }
}

static void add_cell(const target_t *t, long cell, double *K)
{
  if (t->size == 3)
    add_blocks(t, cell, K, 3);
  else if (t->size == 2)
    add_blocks(t, cell, K, 2);
  else
    add_blocks(t, cell, K, t->size);
}

/* Add one integral of a bilinear form; K: space for a cell's matrix, x: for its coordinates. The number of
   entities left out because their cells have no places. */
long insertion_add(const target_t *t, const part_t *p, const geometry_t *g, const double *constants, double *K,
                   double *x)
{
  long left_out = 0;
  const uint8_t perm[2] = {0, 0};
  const long total = (long)t->nodes * t->size;
  for (long e = 0; e < p->count; e++) {
    const int32_t *entity = p->entities + (p->facets ? 2 * e : e);
    if (entity[0] < 0 || entity[0] >= t->cells || t->places[(long)entity[0] * t->nodes * t->nodes] == UNKNOWN) {
      left_out++;
      continue;
    }
    const int32_t *nodes = g->numbers + (long)g->nodes * entity[0];
    const int local = p->facets ? entity[1] : 0;
    for (int i = 0; i < g->nodes; i++) memcpy(x + 3 * i, g->x + 3 * (long)nodes[i], 3 * sizeof(double));
    memset(K, 0, (size_t)(total * total) * sizeof(double));
    p->kernel(K, p->coefficients + e * p->width, constants, x, &local, perm VARIFORM_CUSTOM);
    add_cell(t, entity[0], K);
  }
  return left_out;
}

#endif
