/* SPDX-License-Identifier: MIT */
/* P^T A P by blocks, for the coarse operators of multigrid by aggregation.

   A has R x R blocks in PETSc's compressed rows, by numbers and not by blocks, P has R x MODES blocks; R
   is 3 on the finest level (displacements) and MODES below (rigid motions). A row of A P is made, added
   to the rows of the result that it belongs to, and forgotten: A P is never stored, and where a block
   goes is looked up once for its 36 numbers. Rows of A and of P are those of this rank; columns of A
   are its own nodes and then, in the second part, those of others, whose rows of P follow its own. */
#ifndef VARIFORM_PRODUCTS_H
#define VARIFORM_PRODUCTS_H

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MODES 6

/* A matrix in compressed rows. */
typedef struct {
  const int32_t *rows, *columns;
  const double *values;
} rows_t;

/* Rows of blocks: where each begins, the node of each block, its numbers row by row. */
typedef struct {
  int nodes;
  const int32_t *starts, *columns;
  const double *values;
} block_rows_t;

/* Whether two parts are of full R x K blocks, their rows coming R by R. */
int blocks_full(const rows_t *p, int nodes, int R, int K)
{
  for (int half = 0; half < 2; half++)
    for (long i = 0; i < nodes; i++) {
      const int32_t *row = p[half].rows + R * i, length = row[1] - row[0];
      const int32_t *first = p[half].columns + row[0];
      if (length % K)
        return 0;
      for (int32_t k = 0; k < length; k++)
        if (first[k] % K != k % K || first[k] / K != first[k - k % K] / K)
          return 0;
      for (int r = 1; r < R; r++)
        if (row[r + 1] - row[r] != length ||
            memcmp(first, p[half].columns + row[r], (size_t)length * sizeof *first))
          return 0;
    }
  return 1;
}

/* The blocks of two parts that have as many rows; names are the nodes of their columns. */
void blocks_take(const rows_t *p, const int32_t *const *names, int nodes, int R, int K,
                 int32_t *starts, int32_t *columns, double *values)
{
  int32_t at = 0;
  for (long i = 0; i < nodes; i++) {
    starts[i] = at;
    for (int half = 0; half < 2; half++) {
      const int32_t *row = p[half].rows + R * i;
      for (int32_t k = 0; k < row[1] - row[0]; k += K, at++) {
        columns[at] = names[half][p[half].columns[row[0] + k] / K];
        for (int r = 0; r < R; r++)
          memcpy(values + ((long)at * R + r) * K, p[half].values + row[r] + k,
                 (size_t)K * sizeof *values);
      }
    }
  }
  starts[nodes] = at;
}

/* The coarse nodes in each row of A P; mark has a number for each of these, -1. Without columns they
   are only counted. Returns the most in a row. */
int products_reach(const rows_t *A, const block_rows_t *P, int nodes, int R, int32_t *mark,
                   int32_t *starts, int32_t *columns)
{
  int32_t at = 0, most = 0;
  for (long i = 0; i < nodes; i++) {
    starts[i] = at;
    for (int half = 0; half < 2; half++)
      for (int32_t k = A[half].rows[R * i]; k < A[half].rows[R * i + 1]; k += R) {
        const int32_t node = A[half].columns[k] / R + half * nodes;
        for (int32_t n = P->starts[node]; n < P->starts[node + 1]; n++)
          if (mark[P->columns[n]] != i) {
            mark[P->columns[n]] = (int32_t)i;
            if (columns)
              columns[at] = P->columns[n];
            at++;
          }
      }
    most = at - starts[i] > most ? at - starts[i] : most;
  }
  starts[nodes] = at;
  return most;
}

static int compare_nodes(const void *a, const void *b)
{
  const int32_t x = *(const int32_t *)a, y = *(const int32_t *)b;
  return (x > y) - (x < y);
}

/* The nodes in each row of the result, ascending: those that the rows of A P in its column of P reach,
   and more that are given. mark as above; without columns they are only counted. */
void products_rows(int coarse, const int32_t *of_column[2], const int32_t *reach[2],
                   const int32_t *more[2], int32_t *mark, int32_t *starts, int32_t *columns)
{
  int32_t at = 0;
  for (int32_t I = 0; I < coarse; I++) {
    starts[I] = at;
    for (int given = 0; given < 2; given++) {
      const int32_t *const *lists = given ? more : reach;
      const int32_t first = given ? I : of_column[0][I], last = given ? I + 1 : of_column[0][I + 1];
      for (int32_t n = first; n < last; n++) {
        const int32_t i = given ? n : of_column[1][n];
        for (int32_t k = lists[0][i]; k < lists[0][i + 1]; k++)
          if (mark[lists[1][k]] != I) {
            mark[lists[1][k]] = I;
            if (columns)
              columns[at] = lists[1][k];
            at++;
          }
      }
    }
    if (columns)
      qsort(columns + starts[I], (size_t)(at - starts[I]), sizeof *columns, compare_nodes);
  }
  starts[coarse] = at;
}

/* Place of a node in an ascending row that has it. */
static inline int32_t place_in_row(const int32_t *row, int32_t length, int32_t node)
{
  int32_t low = 0;
  while (length > 1) {
    const int32_t half = length / 2;
    low += row[low + half] <= node ? half : 0;
    length -= half;
  }
  return low;
}

/* One row of A P into room, and from there into the result. */
static inline __attribute__((always_inline)) void product_row(
    const rows_t *A, const block_rows_t *P, int own, int R, long i, const int32_t *reached, int count,
    int32_t *mark, const int32_t *starts, const int32_t *columns, double *values, double *room)
{
  const int size = R * MODES;
  for (int n = 0; n < count; n++)
    mark[reached[n]] = n;
  memset(room, 0, (size_t)count * (size_t)size * sizeof *room);
  for (int half = 0; half < 2; half++)
    for (int32_t k = A[half].rows[R * i]; k < A[half].rows[R * i + 1]; k += R) {
      const int32_t node = A[half].columns[k] / R + half * own, offset = k - A[half].rows[R * i];
      const double *a[MODES];
      for (int r = 0; r < R; r++)
        a[r] = A[half].values + A[half].rows[R * i + r] + offset;
      for (int32_t n = P->starts[node]; n < P->starts[node + 1]; n++) {
        const double *p = P->values + (long)n * size;
        double *w = room + (long)mark[P->columns[n]] * size;
        for (int r = 0; r < R; r++)
          for (int s = 0; s < R; s++)
            for (int c = 0; c < MODES; c++)
              w[MODES * r + c] += a[r][s] * p[MODES * s + c];
      }
    }
  for (int32_t n = P->starts[i]; n < P->starts[i + 1]; n++) {
    const int32_t I = P->columns[n], *row = columns + starts[I], length = starts[I + 1] - starts[I];
    const double *p = P->values + (long)n * size;
    for (int m = 0; m < count; m++) {
      const double *w = room + (long)m * size;
      double *to = values + (long)starts[I] * MODES * MODES +
                   (long)place_in_row(row, length, reached[m]) * MODES;
      for (int r = 0; r < MODES; r++)
        for (int c = 0; c < MODES; c++) {
          double sum = 0;
          for (int s = 0; s < R; s++)
            sum += p[MODES * s + r] * w[MODES * s + c];
          to[(long)r * length * MODES + c] += sum;
        }
    }
  }
}

/* Add P^T A P to values, which lie row by row as PETSc has them: MODES rows of numbers for a row of
   blocks. reach is that of products_reach(), room has R * MODES numbers for the most in a row. */
void products_add(const rows_t *A, const block_rows_t *P, int nodes, int R, const int32_t *reach[2],
                  int32_t *mark, const int32_t *starts, const int32_t *columns, double *values,
                  double *room)
{
  for (long i = 0; i < nodes; i++) {
    const int32_t *reached = reach[1] + reach[0][i], count = reach[0][i + 1] - reach[0][i];
    if (R == 3)
      product_row(A, P, nodes, 3, i, reached, count, mark, starts, columns, values, room);
    else
      product_row(A, P, nodes, MODES, i, reached, count, mark, starts, columns, values, room);
  }
}

/* Add rows that others made: of each its row here, its nodes, its numbers as above. */
void products_add_rows(int count, const int32_t *rows, const int32_t *given_starts, const int32_t *given,
                       const double *numbers, const int32_t *starts, const int32_t *columns,
                       double *values)
{
  for (int n = 0; n < count; n++) {
    const int32_t I = rows[n], length = starts[I + 1] - starts[I];
    const int32_t from = given_starts[n], width = given_starts[n + 1] - from;
    for (int32_t k = 0; k < width; k++) {
      const int32_t place = place_in_row(columns + starts[I], length, given[from + k]);
      for (long r = 0; r < MODES; r++)
        for (int c = 0; c < MODES; c++)
          values[((long)starts[I] * MODES + r * length + place) * MODES + c] +=
              numbers[((long)from * MODES + r * width + k) * MODES + c];
    }
  }
}

/* The compressed rows of numbers of rows of blocks; names are the nodes of the columns in the whole. */
void products_numbers(int count, const int32_t *starts, const int32_t *columns, const int32_t *names,
                      int32_t *rows, int32_t *out)
{
  for (long I = 0; I < count; I++) {
    const int32_t length = starts[I + 1] - starts[I];
    for (long r = 0; r < MODES; r++) {
      const long at = ((long)starts[I] * MODES + r * length) * MODES;
      rows[I * MODES + r] = (int32_t)at;
      for (int32_t k = 0; k < length; k++)
        for (int c = 0; c < MODES; c++)
          out[at + k * MODES + c] = names[columns[starts[I] + k]] * MODES + c;
    }
  }
  rows[(long)count * MODES] = (int32_t)((long)starts[count] * MODES * MODES);
}

#endif
