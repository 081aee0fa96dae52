/* SPDX-License-Identifier: MIT */
/* Products with a tangent, and the tangent itself, from moduli at the points, several cells at a time.

   Moduli are the second derivatives of the energy with respect to the gradients on the reference cell,
   weights and volumes included; their kernel computes them for one cell. What follows from them knows no
   energy but the element alone: the text that includes this file defines NODES, POINTS, SIZE (components
   of a node) and DIM (of the reference cell), and G[POINTS][NODES][DIM], the shape functions' gradients;
   or, for moduli with respect to values, DIM = 1 and their values. SETS is POINTS; or 1 where the moduli
   are the same at all points of a cell, whose weights are then in G.
   A lane is a cell; as many as the CPU's registers hold are computed at once. */
#ifndef VARIFORM_MODULI_H
#define VARIFORM_MODULI_H

#include "vectors.h"

/* Components of a gradient, the upper triangle of a symmetric matrix of them, and what a cell has of these. */
enum { ROWS = SIZE * DIM, HALF = ROWS * (ROWS + 1) / 2, NUMBERS = SETS * HALF, NEXT = SETS > 1 ? HALF : 0 };
enum { TOTAL = SIZE * NODES, BLOCKS = NODES * (NODES + 1) / 2 };

/* kernel_together() of cell.h, in another library: set by Python. */
void (*moduli_together)(tabulate_t, int, double *const *, const double *const *, const double *,
                        const double *const *) = 0;

/* What Python has to know of this file. */
const long moduli_sizes[] = {sizeof(target_t), sizeof(part_t), sizeof(geometry_t)};
const long moduli_shape[] = {WIDTH, NUMBERS};

static inline int upper(int r, int c)
{
  return r < c ? r * ROWS - r * (r - 1) / 2 + c - r : c * ROWS - c * (c - 1) / 2 + r - c;
}

/* Moduli of the cells `first` and those after it in a part; lanes beyond its end mean nothing. */
static void fill_lanes(const part_t *p, long first, const geometry_t *g, const double *constants, lanes_t *B)
{
  if (p->lanes) {
    lanes_t w[p->width + 1], x[3 * CORNERS];
    gather_cells(p, first, g, w, x);
    memset(B, 0, NUMBERS * sizeof *B);
    lanes_kernel(p)(B, w, constants, x);
    return;
  }
  double out[WIDTH][NUMBERS], x[WIDTH][3 * CORNERS], *to[WIDTH];
  const double *w[WIDTH], *places[WIDTH];
  memset(out, 0, sizeof out);
  const int cells = gather_rows(p, first, WIDTH, g, x[0], w, places);
  for (int k = 0; k < cells; k++) to[k] = out[k];
  moduli_together(p->kernel, cells, to, w, constants, places);
  for (int m = 0; m < NUMBERS; m++)
    for (int k = 0; k < WIDTH; k++) B[m][k] = out[k][m];
}

/* Moduli of all cells of a part, whose lanes are kept together. */
void moduli_fill(const part_t *p, const geometry_t *g, const double *constants, double *B)
{
  for (long first = 0; first < p->count; first += WIDTH, B += NUMBERS * WIDTH)
    fill_lanes(p, first, g, constants, (lanes_t *)B);
}

/* Add the product of a part's tangent and x to y; both have room for ghosts. */
void moduli_product(const part_t *p, const int32_t *numbers, const double *moduli, const double *x, double *restrict y)
{
  const lanes_t *B = (const lanes_t *)moduli;
  for (long first = 0; first < p->count; first += WIDTH, B += NUMBERS - POINTS * NEXT) {
    lanes_t w[NODES][SIZE], A[NODES][SIZE];
    for (int k = 0; k < WIDTH; k++) {
      const int32_t *n = numbers + NODES * (long)p->entities[first + k < p->count ? first + k : p->count - 1];
      for (int i = 0; i < NODES; i++)
        for (int a = 0; a < SIZE; a++) w[i][a][k] = x[SIZE * (long)n[i] + a];
    }
    memset(A, 0, sizeof A);
    for (int q = 0; q < POINTS; q++, B += NEXT) {
      lanes_t D[ROWS], S[ROWS];
      for (int a = 0; a < SIZE; a++) {
        lanes_t sum[DIM];
        memset(sum, 0, sizeof sum);
        UNROLLED
        for (int i = 0; i < NODES; i++) {
          UNROLLED
          for (int J = 0; J < DIM; J++) sum[J] += G[q][i][J] * w[i][a];
        }
        UNROLLED
        for (int J = 0; J < DIM; J++) D[DIM * a + J] = sum[J];
      }
      memset(S, 0, sizeof S);
      UNROLLED
      for (int r = 0; r < ROWS; r++) {
        UNROLLED
        for (int c = r; c < ROWS; c++) {
          const lanes_t b = B[upper(r, c)];
          S[r] += b * D[c];
          if (c > r) S[c] += b * D[r];
        }
      }
      for (int a = 0; a < SIZE; a++) {
        UNROLLED
        for (int i = 0; i < NODES; i++) {
          UNROLLED
          for (int J = 0; J < DIM; J++) A[i][a] += G[q][i][J] * S[DIM * a + J];
        }
      }
    }
    for (int k = 0; k < WIDTH && first + k < p->count; k++) {
      const int32_t *n = numbers + NODES * (long)p->entities[first + k];
      for (int i = 0; i < NODES; i++)
        for (int a = 0; a < SIZE; a++) y[SIZE * (long)n[i] + a] += A[i][a][k];
    }
  }
}

/* Blocks of two nodes i <= j of the cells' matrices, at j (j + 1)/2 + i. */
static void cell_matrices(const lanes_t *B, lanes_t K[BLOCKS][SIZE][SIZE])
{
  memset(K, 0, BLOCKS * sizeof *K);
  for (int q = 0; q < POINTS; q++, B += NEXT) {
    lanes_t(*block)[SIZE][SIZE] = K;
    for (int j = 0; j < NODES; j++) {
      lanes_t T[SIZE][DIM][SIZE]; /* force at a gradient of a unit displacement of j */
      UNROLLED
      for (int r = 0; r < ROWS; r++) {
        UNROLLED
        for (int b = 0; b < SIZE; b++) {
          lanes_t sum = B[upper(r, DIM * b)] * G[q][j][0];
          UNROLLED
          for (int L = 1; L < DIM; L++) sum += B[upper(r, DIM * b + L)] * G[q][j][L];
          T[r / DIM][r % DIM][b] = sum;
        }
      }
      for (int i = 0; i <= j; i++, block++) {
        UNROLLED
        for (int a = 0; a < SIZE; a++) {
          UNROLLED
          for (int b = 0; b < SIZE; b++) {
            lanes_t sum = (*block)[a][b];
            UNROLLED
            for (int J = 0; J < DIM; J++) sum += G[q][i][J] * T[a][J][b];
            (*block)[a][b] = sum;
          }
        }
      }
    }
  }
}

/* insertion_add() by moduli: the number of cells left out because they have no places. */
long moduli_add(const target_t *t, const part_t *p, const geometry_t *g, const double *constants)
{
  long left_out = 0;
  lanes_t B[NUMBERS], K[BLOCKS][SIZE][SIZE];
  double one[TOTAL * TOTAL];
  for (long first = 0; first < p->count; first += WIDTH) {
    fill_lanes(p, first, g, constants, B);
    cell_matrices(B, K);
    for (int k = 0; k < WIDTH && first + k < p->count; k++) {
      const int32_t cell = p->entities[first + k];
      if (cell < 0 || cell >= t->cells || t->places[(long)cell * NODES * NODES] == UNKNOWN) {
        left_out++;
        continue;
      }
      const lanes_t *value = &K[0][0][0];
      for (int j = 0; j < NODES; j++)
        for (int i = 0; i <= j; i++)
          for (int a = 0; a < SIZE; a++)
            for (int b = 0; b < SIZE; b++, value++)
              one[(SIZE * i + a) * TOTAL + SIZE * j + b] = one[(SIZE * j + b) * TOTAL + SIZE * i + a] = (*value)[k];
      add_cell(t, cell, one);
    }
  }
  return left_out;
}

#endif
