/* SPDX-License-Identifier: MIT */
/* The C code at numbers that follow from a rule, for other processors: one line a number.

   Compiled twice: with LIBRARY energies in singular values and sweeps, without it the loops over cells
   of element.c. See the step arm64 of .ci/run, and lanes.py. */
#include <stdio.h>

#ifdef LIBRARY
#include "library.c"
#else
#include "element.c"
#endif

/* Numbers between -1 and 1, the same everywhere. */
static double next(void)
{
  static uint32_t state = 1;
  state = 1664525u * state + 1013904223u;
  return (double)(state >> 8) / (1 << 23) - 1;
}

static void print(const char *name, long count, const double *x)
{
  for (long i = 0; i < count; i++)
    printf("%s %.17g\n", name, x[i]);
}

#ifdef LIBRARY
enum { COUNT = 37, NODES = 25, WIDE = 3 };

/* mu sum (s - 1)^2 + lmbda/2 (J - 1)^2 with mu = 1, lmbda = 2. */
static void fixed_corotated(double *A, const double *w, const double *s, const double *x, const int *entity,
                            const uint8_t *perm
#ifdef VARIFORM_CUSTOM_DATA
                            , void *custom
#endif
)
{
  const double J = s[0] * s[1] * s[2];
  (void)w, (void)x, (void)entity, (void)perm;
  A[0] += (J - 1) * (J - 1);
  for (int i = 0, at = 4; i < 3; i++) {
    const double Ji = s[(i + 1) % 3] * s[(i + 2) % 3];
    A[0] += (s[i] - 1) * (s[i] - 1);
    A[1 + i] += 2 * (s[i] - 1) + 2 * (J - 1) * Ji;
    for (int j = i; j < 3; j++, at++) {
      const double Jj = s[(j + 1) % 3] * s[(j + 2) % 3];
      A[at] += 2 * Ji * Jj + (i == j ? 2 : 2 * (J - 1) * s[3 - i - j]);
    }
  }
}

static void points_of_all_kinds(void)
{
  static double F[COUNT][9], W[COUNT], P[COUNT][9], A[COUNT][81];
  const operator_t op = {fixed_corotated, 3, 3, 3, 0, 0, 0, 0, 1e-6};
  for (int n = 0; n < COUNT; n++)
    for (int i = 0; i < 9; i++)
      F[n][i] = (i % 4 == 0) + (n % 5 ? 0.2 : 1.5) * next(); /* some are inverted */
  for (int project = 0; project < 2; project++) {
    points(&op, COUNT, F[0], project, W, P[0], A[0]);
    print("energy", COUNT, W), print("stress", 9 * COUNT, P[0]), print("tangent", 81 * COUNT, A[0]);
  }
}

static void sweeps_over_a_chain(void)
{
  static int32_t rows[3 * NODES + 1], columns[9 * NODES * (2 * WIDE + 1)];
  static double values[9 * NODES * (2 * WIDE + 1)], b[3 * NODES], x[3 * NODES], r[3 * NODES];
  long at = 0;
  for (int i = 0; i < 3 * NODES; i++) {
    for (int j = i / 3 - WIDE; j <= i / 3 + WIDE; j++)
      for (int c = 0; j >= 0 && j < NODES && c < 3; c++, at++) {
        columns[at] = 3 * j + c;
        values[at] = i == 3 * j + c ? 40 : 1.0 / (1 + i + 3 * j + c);
      }
    rows[i + 1] = (int32_t)at;
  }
  const long blocks = sweeps_count(NODES, rows, columns);
  int32_t starts[NODES + 1], nodes[blocks];
  float kept[12 * blocks], inverse[12 * NODES], room[8 * NODES];
  sweeps_t s = {NODES, starts, nodes, kept, inverse, 0};
  sweeps_fill(&s, rows, columns, values);
  for (int i = 0; i < 3 * NODES; i++)
    b[i] = next();
  sweeps_apply(&s, b, x, 1, r, room);
  print("single swept", 3 * NODES, x), print("single left", 3 * NODES, r);
  sweeps_apply(&s, b, x, 0, 0, room);
  print("single again", 3 * NODES, x);
}

int main(void)
{
  points_of_all_kinds();
  sweeps_over_a_chain();
  return 0;
}
#else
enum { CELLS = 11 };

int main(void)
{
  static double moduli[CELLS][NUMBERS], y[SIZE * (CELLS + 2)], x[SIZE * (CELLS + 2)];
  static lanes_t B[CELLS][NUMBERS], K[CELLS][BLOCKS][SIZE][SIZE];
  int32_t numbers[CELLS][NODES], cells[CELLS];
  for (int e = 0; e < CELLS; e++) {
    cells[e] = e;
    for (int i = 0; i < NODES; i++) numbers[e][i] = e + i;
    for (int m = 0; m < NUMBERS; m++) moduli[e][m] = next();
  }
  for (int i = 0; i < SIZE * (CELLS + 2); i++) x[i] = next();
  const part_t part = {0, 0, 0, CELLS, cells, 0, 0};
  for (int e = 0; e < CELLS; e++)
    for (int m = 0; m < NUMBERS; m++) B[e / WIDTH][m][e % WIDTH] = moduli[e][m];
  moduli_product(&part, numbers[0], (const double *)B, x, y);
  print("product", SIZE * (CELLS + 2), y);
  for (int e = 0; e < CELLS; e++) {
    if (e % WIDTH == 0) cell_matrices(B[e / WIDTH], K[e / WIDTH]);
    const lanes_t *value = &K[e / WIDTH][0][0][0];
    for (int n = 0; n < BLOCKS * SIZE * SIZE; n++) {
      const double one = value[n][e % WIDTH];
      print("matrix", 1, &one);
    }
  }
  return 0;
}
#endif
